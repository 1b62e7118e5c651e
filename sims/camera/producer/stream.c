/* The data stream: a thread copies frames from the ring that the simulated camera shares into announced buffers. */
#define _GNU_SOURCE
#include "producer.h"

#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

void queue_push(Queue *queue, Buffer *buffer) {
    buffer->following = NULL;
    if (queue->last != NULL)
        queue->last->following = buffer;
    else
        queue->first = buffer;
    queue->last = buffer;
    queue->length++;
}

Buffer *queue_pop(Queue *queue) {
    Buffer *buffer = queue->first;
    if (buffer == NULL)
        return NULL;
    queue->first = buffer->following;
    if (queue->first == NULL)
        queue->last = NULL;
    queue->length--;
    return buffer;
}

/* ---- opening and closing ---- */

static GC_ERROR attach(Device *device, Stream *stream) {
    Request request = {.operation = OP_STREAM, .argument = device->opened.session};
    stream->connection.fd = wire_connect();
    if (stream->connection.fd < 0)
        return fail(GC_ERR_IO, "the camera is gone");
    return wire_call(&stream->connection, request, NULL, NULL, NULL, NULL);
}

GC_ERROR stream_open(Device *device) {
    pthread_condattr_t monotonic;
    if (device->stream != NULL)
        return fail(GC_ERR_RESOURCE_IN_USE, "the stream is open already");
    Stream *stream = calloc(1, sizeof *stream);
    if (stream == NULL)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory");
    *stream = (Stream){.handle = {KIND_STREAM}, .event = {KIND_EVENT}, .device = device, .connection = {.fd = -1}};
    pthread_mutex_init(&stream->connection.lock, NULL);
    pthread_mutex_init(&stream->lock, NULL);
    pthread_mutex_init(&stream->control, NULL);
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&stream->filled, &monotonic);
    pthread_cond_init(&stream->refilled, &monotonic);
    pthread_condattr_destroy(&monotonic);
    stream->wake = eventfd(0, EFD_CLOEXEC);
    GC_ERROR error = attach(device, stream);
    if (error != GC_ERR_SUCCESS) {
        stream_free(stream);
        return error;
    }
    pthread_mutex_lock(&library.lock);
    device->stream = stream;
    pthread_mutex_unlock(&library.lock);
    return GC_ERR_SUCCESS;
}

static GC_ERROR stop(Stream *stream);

void stream_shut(Stream *stream) {
    stop(stream);
    pthread_mutex_lock(&stream->lock);
    stream->closing = true;
    pthread_cond_broadcast(&stream->filled);
    pthread_mutex_unlock(&stream->lock);
}

void stream_free(Stream *stream) {
    while (stream->announced != NULL) {
        Buffer *buffer = stream->announced;
        stream->announced = buffer->next;
        if (buffer->ours)
            free(buffer->data);
        free(buffer);
    }
    if (stream->connection.fd >= 0)
        close(stream->connection.fd);
    close(stream->wake);
    pthread_cond_destroy(&stream->filled);
    pthread_cond_destroy(&stream->refilled);
    pthread_mutex_destroy(&stream->lock);
    pthread_mutex_destroy(&stream->control);
    pthread_mutex_destroy(&stream->connection.lock);
    free(stream);
}

GC_API DSClose(void *handle) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    Device *device = stream->device;
    pthread_mutex_lock(&library.lock);
    bool mine = device->stream == stream;
    if (mine)
        device->stream = NULL;
    pthread_mutex_unlock(&library.lock);
    if (mine) {
        stream_shut(stream);
        pthread_mutex_lock(&library.lock);
        while (device->users > 1)
            pthread_cond_wait(&library.released, &library.lock);
        pthread_mutex_unlock(&library.lock);
        stream_free(stream);
    }
    release(device);
    return GC_ERR_SUCCESS;
}

/* ---- the thread ---- */

/* Under the stream's lock. NULL: this frame is lost, or none is wanted any more. */
static Buffer *next_buffer(Stream *stream, const FrameRecord *frame) {
    stream->lost_frames += frame->frame_id - stream->next_frame_id;
    stream->next_frame_id = frame->frame_id + 1;
    if (stream->started >= stream->to_acquire)
        return NULL;
    while (frame->lossless && stream->input.first == NULL && !stream->stopping)
        pthread_cond_wait(&stream->refilled, &stream->lock);
    Buffer *buffer = stream->stopping ? NULL : queue_pop(&stream->input);
    if (buffer == NULL) {
        if (!stream->stopping) {
            stream->underruns++;
            stream->lost_frames++;
        }
        return NULL;
    }
    stream->started++;
    buffer->state = BUFFER_FILLING;
    return buffer;
}

static void deliver(Stream *stream, const FrameRecord *frame) {
    pthread_mutex_lock(&stream->lock);
    Buffer *buffer = next_buffer(stream, frame);
    pthread_mutex_unlock(&stream->lock);
    if (buffer == NULL)
        return;
    memcpy(buffer->data, stream->ring + frame->offset, frame->delivered < buffer->size ? frame->delivered : buffer->size);
    pthread_mutex_lock(&stream->lock);
    buffer->frame = *frame;
    buffer->new_data = true;
    buffer->state = BUFFER_OUTPUT;
    queue_push(&stream->output, buffer);
    stream->delivered++;
    stream->fired++;
    pthread_cond_signal(&stream->filled);
    pthread_mutex_unlock(&stream->lock);
}

static void *receive_frames(void *argument) {
    Stream *stream = argument;
    struct pollfd ready[2] = {{.fd = stream->connection.fd, .events = POLLIN}, {.fd = stream->wake, .events = POLLIN}};
    FrameRecord frame;
    for (;;) {
        if (poll(ready, 2, -1) < 0)
            continue;
        if (ready[1].revents != 0)
            return NULL;
        if (!wire_receive(stream->connection.fd, &frame, sizeof frame) || frame.kind != FRAME_IMAGE ||
            frame.offset > stream->ring_size || frame.delivered > stream->ring_size - frame.offset)
            break;
        deliver(stream, &frame);
        Request request = {.operation = OP_ACKNOWLEDGE, .argument = frame.slot};
        if (!wire_send(stream->connection.fd, &request, sizeof request))
            break;
    }
    /* Unplugged: no frame comes any more, which a client learns by a time-out and by reading a node. */
    pthread_mutex_lock(&stream->lock);
    stream->lost = true;
    pthread_mutex_unlock(&stream->lock);
    return NULL;
}

/* ---- starting and stopping ---- */

static void set_grabbing(Stream *stream, bool grabbing) {
    pthread_mutex_lock(&stream->lock);
    stream->grabbing = grabbing;
    pthread_mutex_unlock(&stream->lock);
}

static GC_ERROR start(Stream *stream, uint64_t count) {
    FrameRecord frame;
    int memory;
    Request request = {.operation = OP_START};
    if (stream->grabbing)
        return fail(GC_ERR_RESOURCE_IN_USE, "the acquisition runs already");
    if (stream->lost)
        return fail(GC_ERR_IO, "the camera is gone");
    /* The camera acknowledges before this returns: a trigger that follows at once finds the stream ready. */
    if (!wire_send(stream->connection.fd, &request, sizeof request) ||
        !wire_receive_with_descriptor(stream->connection.fd, &frame, sizeof frame, &memory)) {
        stream->lost = true;
        return fail(GC_ERR_IO, "the camera is gone");
    }
    if (frame.kind != FRAME_STARTED || memory < 0) {
        if (memory >= 0)
            close(memory);
        return fail(GC_ERR_IO, "the camera did not start the stream");
    }
    /* Not populated: most of the ring is touched only by a client that lags behind. */
    void *ring = mmap(NULL, frame.offset, PROT_READ, MAP_SHARED, memory, 0);
    close(memory);
    if (ring == MAP_FAILED)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory for the frames");
    stream->ring = ring;
    stream->ring_size = frame.offset;
    pthread_mutex_lock(&stream->lock);
    stream->stopping = false;
    stream->kills = 0;
    stream->delivered = stream->underruns = stream->lost_frames = stream->started = stream->next_frame_id = 0;
    stream->to_acquire = count;
    stream->grabbing = true;
    pthread_mutex_unlock(&stream->lock);
    if (pthread_create(&stream->thread, NULL, receive_frames, stream) != 0) {
        munmap(ring, frame.offset);
        set_grabbing(stream, false);
        return fail(GC_ERR_OUT_OF_MEMORY, "no thread for the stream");
    }
    return GC_ERR_SUCCESS;
}

static void end_on_wire(Stream *stream) {
    FrameRecord frame = {.kind = FRAME_IMAGE};
    Request request = {.operation = OP_STOP};
    bool alive = !stream->lost && wire_send(stream->connection.fd, &request, sizeof request);
    while (alive && frame.kind != FRAME_STOPPED)
        alive = wire_receive(stream->connection.fd, &frame, sizeof frame);
    stream->lost = !alive;
}

static GC_ERROR stop(Stream *stream) {
    uint64_t one = 1;
    pthread_mutex_lock(&stream->control);
    if (!stream->grabbing) {
        pthread_mutex_unlock(&stream->control);
        return fail(GC_ERR_RESOURCE_IN_USE, "the acquisition does not run");
    }
    pthread_mutex_lock(&stream->lock);
    stream->stopping = true;
    pthread_cond_broadcast(&stream->refilled);
    pthread_mutex_unlock(&stream->lock);
    while (write(stream->wake, &one, sizeof one) != sizeof one)
        ;
    pthread_join(stream->thread, NULL);
    while (read(stream->wake, &one, sizeof one) != sizeof one)
        ;
    end_on_wire(stream);
    munmap((void *)(uintptr_t)stream->ring, stream->ring_size);
    set_grabbing(stream, false);
    pthread_mutex_unlock(&stream->control);
    return GC_ERR_SUCCESS;
}

GC_API DSStartAcquisition(void *handle, int32_t flags, uint64_t count) {
    (void)flags;
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&stream->control);
    GC_ERROR error = start(stream, count);
    pthread_mutex_unlock(&stream->control);
    release(stream->device);
    return error;
}

GC_API DSStopAcquisition(void *handle, int32_t flags) {
    (void)flags;
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = stop(stream);
    release(stream->device);
    return error;
}
