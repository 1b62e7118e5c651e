/* Announced buffers, their queues, what is known of each, and the event that tells of a filled one. */
#define _GNU_SOURCE
#include "producer.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* ---- announcing and queueing ---- */

static GC_ERROR announce(Stream *stream, void *data, size_t size, void *user, bool ours, void **handle) {
    Buffer *buffer = calloc(1, sizeof *buffer);
    if (buffer == NULL)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory");
    *buffer = (Buffer){.data = data, .size = size, .user = user, .ours = ours};
    pthread_mutex_lock(&stream->lock);
    Buffer **link = &stream->announced;
    while (*link != NULL)
        link = &(*link)->next;
    *link = buffer;
    stream->num_announced++;
    pthread_mutex_unlock(&stream->lock);
    *handle = buffer;
    return GC_ERR_SUCCESS;
}

GC_API DSAnnounceBuffer(void *handle, void *data, size_t size, void *user, void **buffer) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = data == NULL || size == 0 || buffer == NULL
                         ? fail(GC_ERR_INVALID_PARAMETER, "a buffer needs memory, a size and a place for its handle")
                         : announce(stream, data, size, user, false, buffer);
    release(stream->device);
    return error;
}

GC_API DSAllocAndAnnounceBuffer(void *handle, size_t size, void *user, void **buffer) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    void *data = size > 0 && buffer != NULL ? malloc(size) : NULL;
    GC_ERROR error = data == NULL ? fail(GC_ERR_OUT_OF_MEMORY, "no memory for a buffer of %zu bytes", size)
                                  : announce(stream, data, size, user, true, buffer);
    if (error != GC_ERR_SUCCESS)
        free(data);
    release(stream->device);
    return error;
}

/* Under the stream's lock. */
static Buffer *find(Stream *stream, const void *handle) {
    Buffer *buffer = stream->announced;
    while (buffer != NULL && buffer != handle)
        buffer = buffer->next;
    if (buffer == NULL)
        fail(GC_ERR_INVALID_HANDLE, "not an announced buffer");
    return buffer;
}

GC_API DSRevokeBuffer(void *handle, void *buffer_handle, void **data, void **user) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    Buffer *buffer = find(stream, buffer_handle);
    if (buffer == NULL) {
        error = GC_ERR_INVALID_HANDLE;
    } else if (buffer->state != BUFFER_IDLE) {
        error = fail(GC_ERR_BUSY, "the buffer is queued");
    } else {
        Buffer **link = &stream->announced;
        while (*link != buffer)
            link = &(*link)->next;
        *link = buffer->next;
        stream->num_announced--;
        if (data != NULL)
            *data = buffer->ours ? NULL : buffer->data;
        if (user != NULL)
            *user = buffer->user;
        if (buffer->ours)
            free(buffer->data);
        free(buffer);
    }
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}

GC_API DSQueueBuffer(void *handle, void *buffer_handle) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    Buffer *buffer = find(stream, buffer_handle);
    if (buffer == NULL) {
        error = GC_ERR_INVALID_HANDLE;
    } else if (buffer->state != BUFFER_IDLE) {
        error = fail(GC_ERR_RESOURCE_IN_USE, "the buffer is queued already");
    } else {
        buffer->new_data = false;
        buffer->state = BUFFER_INPUT;
        queue_push(&stream->input, buffer);
        pthread_cond_signal(&stream->refilled);
    }
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}

static void move_all(Queue *from, Queue *to, int state) {
    for (Buffer *buffer = queue_pop(from); buffer != NULL; buffer = queue_pop(from)) {
        buffer->state = state;
        if (to != NULL)
            queue_push(to, buffer);
    }
}

static void queue_idle(Stream *stream) {
    for (Buffer *buffer = stream->announced; buffer != NULL; buffer = buffer->next)
        if (buffer->state == BUFFER_IDLE) {
            buffer->state = BUFFER_INPUT;
            queue_push(&stream->input, buffer);
        }
}

GC_API DSFlushQueue(void *handle, int32_t operation) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = GC_ERR_SUCCESS;
    pthread_mutex_lock(&stream->lock);
    switch (operation) {
    case ACQ_QUEUE_INPUT_TO_OUTPUT:
        for (Buffer *buffer = stream->input.first; buffer != NULL; buffer = buffer->following)
            buffer->frame = (FrameRecord){0};
        move_all(&stream->input, &stream->output, BUFFER_OUTPUT);
        pthread_cond_broadcast(&stream->filled);
        break;
    case ACQ_QUEUE_OUTPUT_DISCARD:
        move_all(&stream->output, NULL, BUFFER_IDLE);
        break;
    case ACQ_QUEUE_ALL_TO_INPUT:
        move_all(&stream->output, NULL, BUFFER_IDLE);
        queue_idle(stream);
        break;
    case ACQ_QUEUE_UNQUEUED_TO_INPUT:
        queue_idle(stream);
        break;
    case ACQ_QUEUE_ALL_DISCARD:
        move_all(&stream->input, NULL, BUFFER_IDLE);
        move_all(&stream->output, NULL, BUFFER_IDLE);
        break;
    default:
        error = fail(GC_ERR_INVALID_PARAMETER, "no flush operation %d", (int)operation);
    }
    pthread_cond_broadcast(&stream->refilled);
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}

/* ---- information ---- */

static GC_ERROR stream_info(Stream *stream, int32_t command, int32_t *type, void *out, size_t *size) {
    switch (command) {
    case STREAM_INFO_ID:
        return put_string(type, out, size, "Stream0");
    case STREAM_INFO_NUM_DELIVERED:
        return put_uint64(type, out, size, stream->delivered);
    case STREAM_INFO_NUM_UNDERRUN:
        return put_uint64(type, out, size, stream->underruns);
    case STREAM_INFO_NUM_ANNOUNCED:
        return put_size(type, out, size, stream->num_announced);
    case STREAM_INFO_NUM_QUEUED:
        return put_size(type, out, size, stream->input.length);
    case STREAM_INFO_NUM_AWAIT_DELIVERY:
        return put_size(type, out, size, stream->output.length);
    case STREAM_INFO_NUM_STARTED:
        return put_size(type, out, size, stream->started);
    case STREAM_INFO_IS_GRABBING:
        return put_bool(type, out, size, stream->grabbing);
    case STREAM_INFO_DEFINES_PAYLOADSIZE:
        return put_bool(type, out, size, false);
    case STREAM_INFO_TLTYPE:
        return put_string(type, out, size, TL_TYPE);
    case STREAM_INFO_NUM_CHUNKS_MAX:
        return put_size(type, out, size, 0);
    case STREAM_INFO_BUF_ANNOUNCE_MIN:
    case STREAM_INFO_BUF_ALIGNMENT:
        return put_size(type, out, size, 1);
    default:
        return unknown_command(command);
    }
}

GC_API DSGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&stream->lock);
    GC_ERROR error = stream_info(stream, command, type, out, size);
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}

GC_API DSGetBufferID(void *handle, uint32_t index, void **buffer_handle) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&stream->lock);
    Buffer *buffer = stream->announced;
    while (buffer != NULL && index-- > 0)
        buffer = buffer->next;
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    if (buffer == NULL || buffer_handle == NULL)
        return fail(GC_ERR_INVALID_INDEX, "no such buffer");
    *buffer_handle = buffer;
    return GC_ERR_SUCCESS;
}

GC_API DSGetParentDev(void *handle, void **parent) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    if (parent != NULL)
        *parent = &stream->device->handle;
    release(stream->device);
    return parent != NULL ? GC_ERR_SUCCESS : fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
}

static size_t filled(const Buffer *buffer) {
    return buffer->frame.delivered < buffer->size ? buffer->frame.delivered : buffer->size;
}

static GC_ERROR frame_info(const Buffer *buffer, int32_t command, int32_t *type, void *out, size_t *size) {
    const FrameRecord *frame = &buffer->frame;
    if (!buffer->new_data)
        return fail(GC_ERR_NOT_AVAILABLE, "the buffer holds no frame");
    switch (command) {
    case BUFFER_INFO_TIMESTAMP:
    case BUFFER_INFO_TIMESTAMP_NS:
        return put_uint64(type, out, size, frame->timestamp_ns);
    case BUFFER_INFO_IS_INCOMPLETE:
        return put_bool(type, out, size, filled(buffer) < frame->size);
    case BUFFER_INFO_WIDTH:
        return put_size(type, out, size, frame->width);
    case BUFFER_INFO_HEIGHT:
        return put_size(type, out, size, frame->height);
    case BUFFER_INFO_XOFFSET:
        return put_size(type, out, size, frame->offset_x);
    case BUFFER_INFO_YOFFSET:
        return put_size(type, out, size, frame->offset_y);
    case BUFFER_INFO_XPADDING:
        return put_size(type, out, size, frame->padding_x);
    case BUFFER_INFO_YPADDING:
    case BUFFER_INFO_IMAGEOFFSET:
        return put_size(type, out, size, 0);
    case BUFFER_INFO_FRAMEID:
        return put_uint64(type, out, size, frame->frame_id);
    case BUFFER_INFO_IMAGEPRESENT:
        return put_bool(type, out, size, true);
    case BUFFER_INFO_PAYLOADTYPE:
        return put_size(type, out, size, PAYLOAD_TYPE_IMAGE);
    case BUFFER_INFO_PIXELFORMAT:
        return put_uint64(type, out, size, frame->pixel_format);
    case BUFFER_INFO_PIXELFORMAT_NAMESPACE:
        return put_uint64(type, out, size, PIXELFORMAT_NAMESPACE_PFNC_32BIT);
    case BUFFER_INFO_DELIVERED_IMAGEHEIGHT:
        return put_size(type, out, size, frame->size > 0 ? filled(buffer) * frame->height / frame->size : 0);
    case BUFFER_INFO_PIXEL_ENDIANNESS:
        return put_int32(type, out, size, PIXELENDIANNESS_LITTLE);
    case BUFFER_INFO_DATA_SIZE:
        return put_size(type, out, size, frame->delivered);
    case BUFFER_INFO_DATA_LARGER_THAN_BUFFER:
        return put_bool(type, out, size, frame->size > buffer->size);
    case BUFFER_INFO_CONTAINS_CHUNKDATA:
    case BUFFER_INFO_IS_COMPOSITE:
        return put_bool(type, out, size, false);
    default:
        return unknown_command(command);
    }
}

static GC_ERROR buffer_info(const Buffer *buffer, int32_t command, int32_t *type, void *out, size_t *size) {
    switch (command) {
    case BUFFER_INFO_BASE:
        return put_pointer(type, out, size, buffer->data);
    case BUFFER_INFO_SIZE:
        return put_size(type, out, size, buffer->size);
    case BUFFER_INFO_USER_PTR:
        return put_pointer(type, out, size, buffer->user);
    case BUFFER_INFO_NEW_DATA:
        return put_bool(type, out, size, buffer->new_data);
    case BUFFER_INFO_IS_QUEUED:
        return put_bool(type, out, size, buffer->state != BUFFER_IDLE);
    case BUFFER_INFO_IS_ACQUIRING:
        return put_bool(type, out, size, buffer->state == BUFFER_FILLING);
    case BUFFER_INFO_TLTYPE:
        return put_string(type, out, size, TL_TYPE);
    case BUFFER_INFO_SIZE_FILLED:
        return put_size(type, out, size, buffer->new_data ? filled(buffer) : 0);
    default:
        return frame_info(buffer, command, type, out, size);
    }
}

GC_API DSGetBufferInfo(void *handle, void *buffer_handle, int32_t command, int32_t *type, void *out, size_t *size) {
    Stream *stream = hold_stream(handle, KIND_STREAM);
    if (stream == NULL)
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&stream->lock);
    Buffer *buffer = find(stream, buffer_handle);
    GC_ERROR error = buffer != NULL ? buffer_info(buffer, command, type, out, size) : GC_ERR_INVALID_HANDLE;
    pthread_mutex_unlock(&stream->lock);
    release(stream->device);
    return error;
}
