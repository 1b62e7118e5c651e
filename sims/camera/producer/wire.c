/* The Unix socket to the process that plays the camera. Each opened device has a connection of its own, so that
 * the device is free again as soon as this process ends, however it ends. */
#define _GNU_SOURCE
#include "producer.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

/* A camera that does not answer within this time is reported as a time-out, as a USB control transfer would be. */
#define ANSWER_S 3

_Static_assert(sizeof(Request) == 24 && sizeof(Reply) == 24, "records of the wire have no holes");
_Static_assert(sizeof(DeviceRecord) == 392 && sizeof(OpenRecord) == 88 && sizeof(FrameRecord) == 80,
               "records of the wire have no holes");

const char *library_path(void) {
    static char path[PATH_MAX];
    Dl_info info;
    if (path[0] == 0 && (dladdr((const void *)library_path, &info) == 0 || realpath(info.dli_fname, path) == NULL))
        path[0] = 0;
    return path;
}

/* The socket lies beside this file: <file>.sock. A path may be longer than a socket's address can hold, therefore
 * the way leads through a descriptor of the folder. */
int wire_connect(void) {
    char folder[PATH_MAX];
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    struct timeval patience = {.tv_sec = ANSWER_S};

    snprintf(folder, sizeof folder, "%s", library_path());
    char *slash = strrchr(folder, '/');
    if (slash == NULL)
        return -1;
    *slash = 0;
    int at = open(folder, O_PATH | O_DIRECTORY | O_CLOEXEC);
    if (at < 0)
        return -1;
    int written = snprintf(address.sun_path, sizeof address.sun_path, "/proc/self/fd/%d/%s.sock", at, slash + 1);
    int fd = -1;
    if (written > 0 && (size_t)written < sizeof address.sun_path)
        fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (fd >= 0) {
        setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
        if (connect(fd, (struct sockaddr *)&address, sizeof address) != 0) {
            close(fd);
            fd = -1;
        }
    }
    close(at);
    return fd;
}

bool wire_send(int fd, const void *data, size_t size) {
    const char *next = data;
    while (size > 0) {
        ssize_t sent = send(fd, next, size, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent <= 0)
            return false;
        next += sent;
        size -= (size_t)sent;
    }
    return true;
}

/* Bytes received: `size`, or fewer at the end of the connection, an error or a time-out (errno then is EAGAIN). */
static size_t receive(int fd, void *data, size_t size) {
    size_t got = 0;
    while (got < size) {
        ssize_t count = recv(fd, (char *)data + got, size - got, 0);
        if (count < 0 && errno == EINTR)
            continue;
        if (count == 0)
            errno = EPIPE;
        if (count <= 0)
            break;
        got += (size_t)count;
    }
    return got;
}

bool wire_receive(int fd, void *data, size_t size) {
    return receive(fd, data, size) == size;
}

bool wire_receive_with_descriptor(int fd, void *data, size_t size, int *descriptor) {
    union {
        struct cmsghdr header;
        char space[CMSG_SPACE(sizeof(int))];
    } control;
    struct iovec part = {.iov_base = data, .iov_len = size};
    struct msghdr message = {
        .msg_iov = &part, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof control};
    ssize_t count;

    *descriptor = -1;
    do
        count = recvmsg(fd, &message, MSG_CMSG_CLOEXEC);
    while (count < 0 && errno == EINTR);
    if (count <= 0)
        return false;
    struct cmsghdr *header = CMSG_FIRSTHDR(&message);
    if (header != NULL && header->cmsg_level == SOL_SOCKET && header->cmsg_type == SCM_RIGHTS)
        memcpy(descriptor, CMSG_DATA(header), sizeof *descriptor);
    return wire_receive(fd, (char *)data + count, size - (size_t)count);
}

static GC_ERROR lose(Connection *connection) {
    connection->lost = true;
    return fail(GC_ERR_IO, "the connection to the camera is lost");
}

static bool skip(int fd, size_t size) {
    char scrap[4096];
    while (size > 0) {
        size_t part = size < sizeof scrap ? size : sizeof scrap;
        if (!wire_receive(fd, scrap, part))
            return false;
        size -= part;
    }
    return true;
}

static GC_ERROR call(Connection *connection, Request request, const void *out, void *in, size_t *in_size,
                     uint64_t *value) {
    Reply reply;

    if (connection->lost)
        return lose(connection);
    request.sequence = ++connection->sequence;
    if (!wire_send(connection->fd, &request, sizeof request) ||
        (request.payload > 0 && !wire_send(connection->fd, out, request.payload)))
        return lose(connection);
    for (;;) {
        size_t got = receive(connection->fd, &reply, sizeof reply);
        if (got == 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
            return fail(GC_ERR_TIMEOUT, "the camera did not answer within %d s", ANSWER_S);
        if (got != sizeof reply)
            return lose(connection);
        if (reply.sequence == request.sequence)
            break;
        /* The late answer to a request that was given up. */
        if (!skip(connection->fd, reply.payload))
            return lose(connection);
    }
    size_t wanted = in_size != NULL ? *in_size : 0;
    size_t taken = reply.payload < wanted ? reply.payload : wanted;
    if ((taken > 0 && !wire_receive(connection->fd, in, taken)) || !skip(connection->fd, reply.payload - taken))
        return lose(connection);
    if (in_size != NULL)
        *in_size = taken;
    if (value != NULL)
        *value = reply.value;
    return reply.status == GC_ERR_SUCCESS ? GC_ERR_SUCCESS : fail(reply.status, "the camera refused the request");
}

GC_ERROR wire_call(Connection *connection, Request request, const void *out, void *in, size_t *in_size,
                   uint64_t *value) {
    pthread_mutex_lock(&connection->lock);
    GC_ERROR error = call(connection, request, out, in, in_size, value);
    pthread_mutex_unlock(&connection->lock);
    return error;
}
