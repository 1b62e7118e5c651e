/* One camera: opening is the interface's business (modules.c), here are its information, its stream and its end. */
#define _GNU_SOURCE
#include "producer.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

GC_ERROR close_device(Device *device) {
    pthread_mutex_lock(&library.lock);
    Device **link = &library.devices;
    while (*link != NULL && *link != device)
        link = &(*link)->next;
    if (*link == NULL) {
        pthread_mutex_unlock(&library.lock);
        return fail(GC_ERR_INVALID_HANDLE, "not an open device");
    }
    *link = device->next;
    Stream *stream = device->stream;
    pthread_mutex_unlock(&library.lock);
    /* Whoever still uses the device looked it up before it left the list; nobody new can. */
    if (stream != NULL)
        stream_shut(stream);
    pthread_mutex_lock(&library.lock);
    while (device->users > 0)
        pthread_cond_wait(&library.released, &library.lock);
    stream = device->stream;
    pthread_mutex_unlock(&library.lock);
    if (stream != NULL)
        stream_free(stream);
    close(device->connection.fd);
    pthread_mutex_destroy(&device->connection.lock);
    free(device);
    return GC_ERR_SUCCESS;
}

GC_API DevClose(void *handle) {
    return close_device((Device *)handle);
}

GC_ERROR device_info(const DeviceRecord *record, bool open, int32_t command, int32_t *type, void *out, size_t *size) {
    char display[160];
    switch (command) {
    case DEVICE_INFO_ID:
        return put_string(type, out, size, record->id);
    case DEVICE_INFO_VENDOR:
        return put_string(type, out, size, record->vendor);
    case DEVICE_INFO_MODEL:
        return put_string(type, out, size, record->model);
    case DEVICE_INFO_TLTYPE:
        return put_string(type, out, size, TL_TYPE);
    case DEVICE_INFO_DISPLAYNAME:
        snprintf(display, sizeof display, "%s (%s)", record->model, record->serial);
        return put_string(type, out, size, display);
    case DEVICE_INFO_ACCESS_STATUS:
        return put_int32(type, out, size, open ? DEVICE_ACCESS_STATUS_OPEN_READWRITE : (int32_t)record->access_status);
    case DEVICE_INFO_USER_DEFINED_NAME:
        return put_string(type, out, size, record->name);
    case DEVICE_INFO_SERIAL_NUMBER:
        return put_string(type, out, size, record->serial);
    case DEVICE_INFO_VERSION:
        return put_string(type, out, size, record->version);
    case DEVICE_INFO_TIMESTAMP_FREQUENCY:
        return put_uint64(type, out, size, UINT64_C(1000000000));
    default:
        return unknown_command(command);
    }
}

GC_API DevGetInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    Device *device = hold(handle, KIND_DEVICE);
    if (device == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = device_info(&device->record, true, command, type, out, size);
    release(device);
    return error;
}

GC_API DevGetPort(void *handle, void **port) {
    Device *device = hold(handle, KIND_DEVICE);
    if (device == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error = port != NULL ? GC_ERR_SUCCESS : fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    if (port != NULL)
        *port = &device->remote;
    release(device);
    return error;
}

GC_API DevGetParentIF(void *handle, void **interface) {
    Device *device = hold(handle, KIND_DEVICE);
    if (device == NULL)
        return GC_ERR_INVALID_HANDLE;
    release(device);
    if (interface == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    *interface = &library.interface;
    return GC_ERR_SUCCESS;
}

GC_API DevGetNumDataStreams(void *handle, uint32_t *count) {
    Device *device = hold(handle, KIND_DEVICE);
    if (device == NULL)
        return GC_ERR_INVALID_HANDLE;
    release(device);
    if (count == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the number");
    *count = 1;
    return GC_ERR_SUCCESS;
}

GC_API DevGetDataStreamID(void *handle, uint32_t index, char *id, size_t *size) {
    Device *device = hold(handle, KIND_DEVICE);
    if (device == NULL)
        return GC_ERR_INVALID_HANDLE;
    release(device);
    return index == 0 ? put_string(NULL, id, size, "Stream0") : fail(GC_ERR_INVALID_INDEX, "one stream only");
}

GC_API DevOpenDataStream(void *handle, const char *id, void **stream) {
    Device *device = hold(handle, KIND_DEVICE);
    if (device == NULL)
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error;
    if (id == NULL || strcmp(id, "Stream0") != 0)
        error = fail(GC_ERR_INVALID_ID, "no such stream");
    else if (stream == NULL)
        error = fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    else
        error = stream_open(device);
    if (error == GC_ERR_SUCCESS)
        *stream = &device->stream->handle;
    release(device);
    return error;
}
