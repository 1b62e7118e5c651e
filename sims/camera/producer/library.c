/* The library as a whole: initialisation, handles, last error, the shapes of answers. */
#define _GNU_SOURCE
#include "producer.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

Library library = {
    .system = {KIND_SYSTEM},
    .interface = {KIND_INTERFACE},
    .lock = PTHREAD_MUTEX_INITIALIZER,
    .released = PTHREAD_COND_INITIALIZER,
};

static _Thread_local GC_ERROR last_error;
static _Thread_local char last_text[256];

GC_ERROR fail(GC_ERROR code, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    last_error = code;
    vsnprintf(last_text, sizeof last_text, format, arguments);
    va_end(arguments);
    return code;
}

GC_ERROR unknown_command(int32_t command) {
    return fail(GC_ERR_NOT_AVAILABLE, "information %d is not available", (int)command);
}

/* ---- answers: with no buffer only the size is told, as the standard asks ---- */

static GC_ERROR put(int32_t *type, int32_t kind, void *out, size_t *size, const void *value, size_t length) {
    if (size == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no size given");
    if (type != NULL)
        *type = kind;
    if (out != NULL) {
        if (*size < length)
            return fail(GC_ERR_BUFFER_TOO_SMALL, "%zu bytes are needed, %zu were given", length, *size);
        memcpy(out, value, length);
    }
    *size = length;
    return GC_ERR_SUCCESS;
}

GC_ERROR put_string(int32_t *type, void *out, size_t *size, const char *text) {
    return put(type, INFO_DATATYPE_STRING, out, size, text, strlen(text) + 1);
}

GC_ERROR put_int32(int32_t *type, void *out, size_t *size, int32_t value) {
    return put(type, INFO_DATATYPE_INT32, out, size, &value, sizeof value);
}

GC_ERROR put_uint64(int32_t *type, void *out, size_t *size, uint64_t value) {
    return put(type, INFO_DATATYPE_UINT64, out, size, &value, sizeof value);
}

GC_ERROR put_size(int32_t *type, void *out, size_t *size, size_t value) {
    return put(type, INFO_DATATYPE_SIZET, out, size, &value, sizeof value);
}

GC_ERROR put_bool(int32_t *type, void *out, size_t *size, bool value) {
    bool8_t byte = value;
    return put(type, INFO_DATATYPE_BOOL8, out, size, &byte, sizeof byte);
}

GC_ERROR put_pointer(int32_t *type, void *out, size_t *size, void *value) {
    return put(type, INFO_DATATYPE_PTR, out, size, &value, sizeof value);
}

/* ---- handles ---- */

static bool open_handle(const void *handle, const Handle *own, const bool *open) {
    pthread_mutex_lock(&library.lock);
    bool found = library.initialised && *open && handle == (const void *)own;
    pthread_mutex_unlock(&library.lock);
    if (!found)
        fail(GC_ERR_INVALID_HANDLE, "not an open module of this producer");
    return found;
}

bool is_system(const void *handle) {
    return open_handle(handle, &library.system, &library.system_open);
}

bool is_interface(const void *handle) {
    return open_handle(handle, &library.interface, &library.interface_open);
}

Device *hold(const void *handle, Kind kind) {
    pthread_mutex_lock(&library.lock);
    Device *device = library.devices;
    while (device != NULL && handle != (kind == KIND_REMOTE ? &device->remote : &device->handle))
        device = device->next;
    if (device != NULL)
        device->users++;
    pthread_mutex_unlock(&library.lock);
    if (device == NULL)
        fail(GC_ERR_INVALID_HANDLE, "not an open device of this producer");
    return device;
}

static bool is_handle_of(const Stream *stream, const void *handle, Kind kind) {
    if (kind == KIND_EVENT)
        return stream->registered && handle == &stream->event;
    return handle == &stream->handle;
}

Stream *hold_stream(const void *handle, Kind kind) {
    Stream *stream = NULL;
    pthread_mutex_lock(&library.lock);
    for (Device *device = library.devices; device != NULL && stream == NULL; device = device->next)
        if (device->stream != NULL && is_handle_of(device->stream, handle, kind)) {
            stream = device->stream;
            device->users++;
        }
    pthread_mutex_unlock(&library.lock);
    if (stream == NULL)
        fail(GC_ERR_INVALID_HANDLE, "not an open stream or event of this producer");
    return stream;
}

void release(Device *device) {
    pthread_mutex_lock(&library.lock);
    device->users--;
    pthread_cond_broadcast(&library.released);
    pthread_mutex_unlock(&library.lock);
}

/* ---- the library's own calls ---- */

GC_API GCInitLib(void) {
    pthread_mutex_lock(&library.lock);
    bool again = library.initialised;
    library.initialised = true;
    library_path(); /* found once, before other threads can ask */
    pthread_mutex_unlock(&library.lock);
    return again ? fail(GC_ERR_RESOURCE_IN_USE, "the library is initialised already") : GC_ERR_SUCCESS;
}

GC_API GCCloseLib(void) {
    if (!library.initialised)
        return fail(GC_ERR_NOT_INITIALIZED, "GCInitLib was not called");
    if (library.system_open)
        TLClose(&library.system);
    pthread_mutex_lock(&library.lock);
    library.initialised = false;
    pthread_mutex_unlock(&library.lock);
    return GC_ERR_SUCCESS;
}

GC_API GCGetLastError(GC_ERROR *code, char *text, size_t *size) {
    if (code != NULL)
        *code = last_error;
    return put_string(NULL, text, size, last_error == GC_ERR_SUCCESS ? "No error" : last_text);
}

GC_API GCGetInfo(int32_t command, int32_t *type, void *out, size_t *size) {
    return system_info(command, type, out, size);
}
