/* The one event there is: a stream's NEW_BUFFER. Waiting uses the monotonic clock. */
#define _GNU_SOURCE
#include "producer.h"

#include <string.h>
#include <time.h>

GC_API GCRegisterEvent(void *source, int32_t event, void **handle) {
    Stream *stream = hold_stream(source, KIND_STREAM);
    if (stream == NULL || event != EVENT_NEW_BUFFER) {
        if (stream != NULL)
            release(stream->device);
        return fail(GC_ERR_NOT_IMPLEMENTED, "only a stream's NEW_BUFFER event is offered");
    }
    GC_ERROR error = GC_ERR_SUCCESS;
    if (stream->registered)
        error = fail(GC_ERR_RESOURCE_IN_USE, "the event is registered already");
    else if (handle == NULL)
        error = fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    if (error == GC_ERR_SUCCESS) {
        stream->registered = true;
        stream->fired = 0;
        *handle = &stream->event;
    }
    release(stream->device);
    return error;
}

GC_API GCUnregisterEvent(void *source, int32_t event) {
    Stream *stream = hold_stream(source, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    if (event == EVENT_NEW_BUFFER && stream->registered) {
        stream->registered = false;
        stream->kills = stream->waiting;
        pthread_cond_broadcast(&stream->filled);
    } else {
        error = fail(GC_ERR_INVALID_PARAMETER, "the event is not registered");
    }
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}

static struct timespec deadline_after(uint64_t milliseconds) {
    struct timespec when;
    clock_gettime(CLOCK_MONOTONIC, &when);
    if (milliseconds > UINT64_C(1000) * 60 * 60 * 24 * 365)
        milliseconds = UINT64_C(1000) * 60 * 60 * 24 * 365;
    when.tv_sec += (time_t)(milliseconds / 1000);
    when.tv_nsec += (long)(milliseconds % 1000) * 1000000;
    if (when.tv_nsec >= 1000000000) {
        when.tv_sec++;
        when.tv_nsec -= 1000000000;
    }
    return when;
}

/* Under the stream's lock: the oldest filled buffer, taken out of its queue. */
static GC_ERROR wait_for_buffer(Stream *stream, uint64_t timeout, Buffer **buffer) {
    struct timespec deadline = deadline_after(timeout);
    int late = 0;
    stream->waiting++;
    while (stream->output.first == NULL && stream->kills == 0 && !stream->closing && late == 0)
        late = pthread_cond_timedwait(&stream->filled, &stream->lock, &deadline);
    stream->waiting--;
    if (stream->closing)
        return fail(GC_ERR_ABORT, "the stream is being closed");
    if (stream->kills > 0) {
        stream->kills--;
        return fail(GC_ERR_ABORT, "the wait was killed");
    }
    *buffer = queue_pop(&stream->output);
    if (*buffer == NULL)
        return fail(GC_ERR_TIMEOUT, "no new buffer within %llu ms", (unsigned long long)timeout);
    (*buffer)->state = BUFFER_IDLE;
    return GC_ERR_SUCCESS;
}

GC_API EventGetData(void *handle, void *out, size_t *size, uint64_t timeout) {
    Stream *stream = hold_stream(handle, KIND_EVENT);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    Buffer *buffer = NULL;
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    if (size == NULL || (out != NULL && *size < sizeof(EVENT_NEW_BUFFER_DATA)))
        error = fail(GC_ERR_BUFFER_TOO_SMALL, "%zu bytes are needed", sizeof(EVENT_NEW_BUFFER_DATA));
    else
        error = wait_for_buffer(stream, timeout, &buffer);
    if (error == GC_ERR_SUCCESS) {
        EVENT_NEW_BUFFER_DATA data = {.BufferHandle = buffer, .pUserPointer = buffer->user};
        if (out != NULL)
            memcpy(out, &data, sizeof data);
        *size = sizeof data;
    }
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}

GC_API EventGetDataInfo(void *handle, const void *in, size_t in_size, int32_t command, int32_t *type, void *out,
                        size_t *size) {
    EVENT_NEW_BUFFER_DATA data;
    Stream *stream = hold_stream(handle, KIND_EVENT);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    release(stream->device);
    if (in == NULL || in_size < sizeof data)
        return fail(GC_ERR_INVALID_PARAMETER, "not the data of a NEW_BUFFER event");
    memcpy(&data, in, sizeof data);
    switch (command) {
    case EVENT_DATA_ID:
        return put_pointer(type, out, size, data.BufferHandle);
    case EVENT_DATA_VALUE:
        return put_pointer(type, out, size, data.pUserPointer);
    default:
        return unknown_command(command);
    }
}

GC_API EventGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    Stream *stream = hold_stream(handle, KIND_EVENT);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&stream->lock);
    size_t waiting = stream->output.length;
    uint64_t fired = stream->fired;
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    switch (command) {
    case EVENT_EVENT_TYPE:
        return put_int32(type, out, size, EVENT_NEW_BUFFER);
    case EVENT_NUM_IN_QUEUE:
        return put_size(type, out, size, waiting);
    case EVENT_NUM_FIRED:
        return put_uint64(type, out, size, fired);
    case EVENT_SIZE_MAX:
    case EVENT_INFO_DATA_SIZE_MAX:
        return put_size(type, out, size, sizeof(EVENT_NEW_BUFFER_DATA));
    default:
        return unknown_command(command);
    }
}

GC_API EventFlush(void *handle) {
    Stream *stream = hold_stream(handle, KIND_EVENT);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    /* A flushed event leaves its buffer with the client, as if it had been fetched. */
    pthread_mutex_lock(&stream->lock);
    for (Buffer *buffer = queue_pop(&stream->output); buffer != NULL; buffer = queue_pop(&stream->output))
        buffer->state = BUFFER_IDLE;
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return GC_ERR_SUCCESS;
}

GC_API EventKill(void *handle) {
    Stream *stream = hold_stream(handle, KIND_EVENT);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&stream->lock);
    if (stream->kills < (stream->waiting > 0 ? stream->waiting : 1))
        stream->kills++;
    pthread_cond_broadcast(&stream->filled);
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return GC_ERR_SUCCESS;
}

/* ---- what these cameras do not have ---- */

#define NOT_OFFERED(name, ...)                                                                                         \
    GC_API name(__VA_ARGS__) {                                                                                         \
        return fail(GC_ERR_NOT_IMPLEMENTED, #name " is not offered: frames are plain images");                        \
    }

NOT_OFFERED(DSGetBufferChunkData, void *stream __attribute__((unused)), void *buffer __attribute__((unused)),
            void *chunks __attribute__((unused)), size_t *count __attribute__((unused)))
NOT_OFFERED(DSGetNumBufferParts, void *stream __attribute__((unused)), void *buffer __attribute__((unused)),
            uint32_t *count __attribute__((unused)))
NOT_OFFERED(DSGetBufferPartInfo, void *stream __attribute__((unused)), void *buffer __attribute__((unused)),
            uint32_t part __attribute__((unused)), int32_t command __attribute__((unused)),
            int32_t *type __attribute__((unused)), void *out __attribute__((unused)),
            size_t *size __attribute__((unused)))
NOT_OFFERED(DSAnnounceCompositeBuffer, void *stream __attribute__((unused)), size_t count __attribute__((unused)),
            void **segments __attribute__((unused)), size_t *sizes __attribute__((unused)),
            void *user __attribute__((unused)), void **buffer __attribute__((unused)))
NOT_OFFERED(DSGetNumFlows, void *stream __attribute__((unused)), uint32_t *count __attribute__((unused)))
NOT_OFFERED(DSGetFlowInfo, void *stream __attribute__((unused)), uint32_t flow __attribute__((unused)),
            int32_t command __attribute__((unused)), int32_t *type __attribute__((unused)),
            void *out __attribute__((unused)), size_t *size __attribute__((unused)))
NOT_OFFERED(DSGetNumBufferSegments, void *stream __attribute__((unused)), void *buffer __attribute__((unused)),
            uint32_t *count __attribute__((unused)))
NOT_OFFERED(DSGetBufferSegmentInfo, void *stream __attribute__((unused)), void *buffer __attribute__((unused)),
            uint32_t segment __attribute__((unused)), int32_t command __attribute__((unused)),
            int32_t *type __attribute__((unused)), void *out __attribute__((unused)),
            size_t *size __attribute__((unused)))
