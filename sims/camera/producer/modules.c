/* System, interface and devices: what there is, opening and closing. One system with one interface. */
#define _GNU_SOURCE
#include "producer.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- system ---- */

GC_ERROR system_info(int32_t command, int32_t *type, void *out, size_t *size) {
    const char *path = library_path();
    switch (command) {
    case TL_INFO_ID:
    case TL_INFO_PATHNAME:
        return put_string(type, out, size, path);
    case TL_INFO_VENDOR:
        return put_string(type, out, size, PRODUCER_VENDOR);
    case TL_INFO_MODEL:
    case TL_INFO_DISPLAYNAME:
        return put_string(type, out, size, PRODUCER_MODEL);
    case TL_INFO_VERSION:
        return put_string(type, out, size, PRODUCER_VERSION);
    case TL_INFO_TLTYPE:
        return put_string(type, out, size, TL_TYPE);
    case TL_INFO_NAME:
        return put_string(type, out, size, strrchr(path, '/') != NULL ? strrchr(path, '/') + 1 : path);
    case TL_INFO_CHAR_ENCODING:
        return put_int32(type, out, size, TL_CHAR_ENCODING_UTF8);
    case TL_INFO_GENTL_VER_MAJOR:
        return put_int32(type, out, size, 1);
    case TL_INFO_GENTL_VER_MINOR:
        return put_int32(type, out, size, 5);
    default:
        return unknown_command(command);
    }
}

GC_API TLOpen(void **system) {
    if (system == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    pthread_mutex_lock(&library.lock);
    bool ready = library.initialised, again = library.system_open;
    if (ready)
        library.system_open = true;
    pthread_mutex_unlock(&library.lock);
    if (!ready)
        return fail(GC_ERR_NOT_INITIALIZED, "GCInitLib was not called");
    if (again)
        return fail(GC_ERR_RESOURCE_IN_USE, "the system is open already");
    *system = &library.system;
    return GC_ERR_SUCCESS;
}

GC_API TLClose(void *system) {
    if (!is_system(system))
        return GC_ERR_INVALID_HANDLE;
    close_interface();
    pthread_mutex_lock(&library.lock);
    library.system_open = false;
    pthread_mutex_unlock(&library.lock);
    return GC_ERR_SUCCESS;
}

GC_API TLGetInfo(void *system, int32_t command, int32_t *type, void *out, size_t *size) {
    return is_system(system) ? system_info(command, type, out, size) : GC_ERR_INVALID_HANDLE;
}

GC_API TLUpdateInterfaceList(void *system, bool8_t *changed, uint64_t timeout) {
    (void)timeout;
    if (!is_system(system))
        return GC_ERR_INVALID_HANDLE;
    if (changed != NULL)
        *changed = 0;
    return GC_ERR_SUCCESS;
}

GC_API TLGetNumInterfaces(void *system, uint32_t *count) {
    if (!is_system(system))
        return GC_ERR_INVALID_HANDLE;
    if (count == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the number");
    *count = 1;
    return GC_ERR_SUCCESS;
}

GC_API TLGetInterfaceID(void *system, uint32_t index, char *id, size_t *size) {
    if (!is_system(system))
        return GC_ERR_INVALID_HANDLE;
    return index == 0 ? put_string(NULL, id, size, INTERFACE_ID) : fail(GC_ERR_INVALID_INDEX, "one interface only");
}

static GC_ERROR interface_info(int32_t command, int32_t *type, void *out, size_t *size) {
    switch (command) {
    case INTERFACE_INFO_ID:
    case INTERFACE_INFO_DISPLAYNAME:
        return put_string(type, out, size, INTERFACE_ID);
    case INTERFACE_INFO_TLTYPE:
        return put_string(type, out, size, TL_TYPE);
    default:
        return unknown_command(command);
    }
}

GC_API TLGetInterfaceInfo(void *system, const char *id, int32_t command, int32_t *type, void *out, size_t *size) {
    if (!is_system(system))
        return GC_ERR_INVALID_HANDLE;
    if (id == NULL || strcmp(id, INTERFACE_ID) != 0)
        return fail(GC_ERR_INVALID_ID, "no such interface");
    return interface_info(command, type, out, size);
}

GC_API TLOpenInterface(void *system, const char *id, void **interface) {
    if (!is_system(system))
        return GC_ERR_INVALID_HANDLE;
    if (id == NULL || strcmp(id, INTERFACE_ID) != 0)
        return fail(GC_ERR_INVALID_ID, "no such interface");
    if (interface == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    pthread_mutex_lock(&library.lock);
    bool again = library.interface_open;
    library.interface_open = true;
    pthread_mutex_unlock(&library.lock);
    if (again)
        return fail(GC_ERR_RESOURCE_IN_USE, "the interface is open already");
    *interface = &library.interface;
    return GC_ERR_SUCCESS;
}

/* ---- interface ---- */

GC_ERROR close_interface(void) {
    for (;;) {
        pthread_mutex_lock(&library.lock);
        Device *device = library.devices;
        library.interface_open = library.interface_open && device != NULL;
        library.num_records = device != NULL ? library.num_records : 0;
        pthread_mutex_unlock(&library.lock);
        if (device == NULL)
            return GC_ERR_SUCCESS;
        close_device(device);
    }
}

GC_API IFClose(void *interface) {
    return is_interface(interface) ? close_interface() : GC_ERR_INVALID_HANDLE;
}

GC_API IFGetInfo(void *interface, int32_t command, int32_t *type, void *out, size_t *size) {
    return is_interface(interface) ? interface_info(command, type, out, size) : GC_ERR_INVALID_HANDLE;
}

GC_API IFGetParentTL(void *interface, void **system) {
    if (!is_interface(interface))
        return GC_ERR_INVALID_HANDLE;
    if (system == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    *system = &library.system;
    return GC_ERR_SUCCESS;
}

/* Without a process that plays the camera there is no device, as on a machine where none is plugged in. */
static size_t ask_for_devices(DeviceRecord *records) {
    size_t size = MAX_DEVICES * sizeof *records;
    Connection connection = {.fd = wire_connect(), .lock = PTHREAD_MUTEX_INITIALIZER};
    if (connection.fd < 0)
        return 0;
    Request request = {.operation = OP_LIST, .argument = WIRE_VERSION};
    if (wire_call(&connection, request, NULL, records, &size, NULL) != GC_ERR_SUCCESS)
        size = 0;
    close(connection.fd);
    return size / sizeof *records;
}

GC_API IFUpdateDeviceList(void *interface, bool8_t *changed, uint64_t timeout) {
    (void)timeout;
    DeviceRecord records[MAX_DEVICES];
    if (!is_interface(interface))
        return GC_ERR_INVALID_HANDLE;
    memset(records, 0, sizeof records);
    size_t count = ask_for_devices(records);
    pthread_mutex_lock(&library.lock);
    bool differs = count != library.num_records;
    for (size_t i = 0; i < count && !differs; i++)
        differs = strcmp(records[i].id, library.records[i].id) != 0;
    memcpy(library.records, records, sizeof records);
    library.num_records = (unsigned)count;
    pthread_mutex_unlock(&library.lock);
    if (changed != NULL)
        *changed = differs;
    return GC_ERR_SUCCESS;
}

GC_API IFGetNumDevices(void *interface, uint32_t *count) {
    if (!is_interface(interface))
        return GC_ERR_INVALID_HANDLE;
    if (count == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the number");
    *count = library.num_records;
    return GC_ERR_SUCCESS;
}

GC_API IFGetDeviceID(void *interface, uint32_t index, char *id, size_t *size) {
    if (!is_interface(interface))
        return GC_ERR_INVALID_HANDLE;
    pthread_mutex_lock(&library.lock);
    GC_ERROR error = index < library.num_records ? put_string(NULL, id, size, library.records[index].id)
                                                 : fail(GC_ERR_INVALID_INDEX, "no device %u", (unsigned)index);
    pthread_mutex_unlock(&library.lock);
    return error;
}

static bool find_record(const char *id, DeviceRecord *record, bool *open) {
    bool found = false;
    pthread_mutex_lock(&library.lock);
    for (unsigned i = 0; id != NULL && i < library.num_records; i++)
        if (strcmp(library.records[i].id, id) == 0) {
            *record = library.records[i];
            found = true;
        }
    *open = false;
    for (Device *device = library.devices; found && device != NULL; device = device->next)
        *open = *open || strcmp(device->record.id, id) == 0;
    pthread_mutex_unlock(&library.lock);
    if (!found)
        fail(GC_ERR_INVALID_ID, "no such device");
    return found;
}

GC_API IFGetDeviceInfo(void *interface, const char *id, int32_t command, int32_t *type, void *out, size_t *size) {
    DeviceRecord record;
    bool open;
    if (!is_interface(interface))
        return GC_ERR_INVALID_HANDLE;
    return find_record(id, &record, &open) ? device_info(&record, open, command, type, out, size) : GC_ERR_INVALID_ID;
}

GC_API IFOpenDevice(void *interface, const char *id, int32_t access, void **handle) {
    DeviceRecord record;
    bool open;
    if (!is_interface(interface))
        return GC_ERR_INVALID_HANDLE;
    if (handle == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the handle");
    if (!find_record(id, &record, &open))
        return GC_ERR_INVALID_ID;
    if (open)
        return fail(GC_ERR_RESOURCE_IN_USE, "the device is open already");
    Device *device = calloc(1, sizeof *device);
    if (device == NULL)
        return fail(GC_ERR_OUT_OF_MEMORY, "no memory");
    *device = (Device){.handle = {KIND_DEVICE}, .remote = {KIND_REMOTE}, .record = record};
    pthread_mutex_init(&device->connection.lock, NULL);
    device->connection.fd = wire_connect();
    size_t size = sizeof device->opened;
    Request request = {.operation = OP_OPEN, .length = (uint32_t)access, .payload = sizeof record.id};
    GC_ERROR error = device->connection.fd < 0
                         ? fail(GC_ERR_IO, "the camera is gone")
                         : wire_call(&device->connection, request, record.id, &device->opened, &size, NULL);
    if (error != GC_ERR_SUCCESS || size != sizeof device->opened) {
        if (device->connection.fd >= 0)
            close(device->connection.fd);
        pthread_mutex_destroy(&device->connection.lock);
        free(device);
        return error != GC_ERR_SUCCESS ? error : fail(GC_ERR_IO, "the camera's answer is too short");
    }
    pthread_mutex_lock(&library.lock);
    device->next = library.devices;
    library.devices = device;
    pthread_mutex_unlock(&library.lock);
    *handle = &device->handle;
    return GC_ERR_SUCCESS;
}
