/* Ports: the remote device's registers go over the wire; each local module has a page of registers and an XML. */
#define _GNU_SOURCE
#include "producer.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#define PAGE_SIZE 4096
#define INTEGERS 0xF00
#define XML_ADDRESS 0x10000

#define XML_HEAD(model, guid)                                                                                          \
    "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"                                                                     \
    "<RegisterDescription xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" ModelName=\"" model                      \
    "\" VendorName=\"irpmd_rig\" StandardNameSpace=\"None\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" "        \
    "SchemaSubMinorVersion=\"0\" MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "                         \
    "ProductGuid=\"" guid "\" VersionGuid=\"" guid "\">\n"
#define XML_PORT(port) "<Port Name=\"" port "\"/>\n</RegisterDescription>\n"
#define XML_STRING(port, name, address)                                                                                \
    "<StringReg Name=\"" name "\"><Address>" address "</Address><Length>256</Length><AccessMode>RO</AccessMode>"       \
    "<pPort>" port "</pPort><Cachable>NoCache</Cachable></StringReg>\n"
#define XML_INTEGER(port, name, address)                                                                               \
    "<IntReg Name=\"" name "\"><Address>" address "</Address><Length>8</Length><AccessMode>RO</AccessMode>"            \
    "<pPort>" port "</pPort><Cachable>NoCache</Cachable><Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess>"     \
    "</IntReg>\n"
#define XML_ROOT_BEGIN "<Category Name=\"Root\">"
#define XML_FEATURE(name) "<pFeature>" name "</pFeature>"
#define XML_ROOT_END "</Category>\n"

static const char system_xml[] = XML_HEAD("System", "6f0b9a51-3c1e-4f5b-9d2c-5f6c0e6b1a01")
    XML_ROOT_BEGIN XML_FEATURE("TLVendorName") XML_FEATURE("TLModelName") XML_FEATURE("TLVersion") XML_FEATURE("TLPath")
    XML_FEATURE("TLType") XML_ROOT_END
    XML_STRING("TLPort", "TLVendorName", "0x0") XML_STRING("TLPort", "TLModelName", "0x100")
    XML_STRING("TLPort", "TLVersion", "0x200") XML_STRING("TLPort", "TLPath", "0x300")
    XML_STRING("TLPort", "TLType", "0x400") XML_PORT("TLPort");

static const char interface_xml[] = XML_HEAD("Interface", "6f0b9a51-3c1e-4f5b-9d2c-5f6c0e6b1a02")
    XML_ROOT_BEGIN XML_FEATURE("InterfaceID") XML_FEATURE("InterfaceDeviceCount") XML_ROOT_END
    XML_STRING("InterfacePort", "InterfaceID", "0x0") XML_INTEGER("InterfacePort", "InterfaceDeviceCount", "0xF00")
    XML_PORT("InterfacePort");

static const char device_xml[] = XML_HEAD("Device", "6f0b9a51-3c1e-4f5b-9d2c-5f6c0e6b1a03")
    XML_ROOT_BEGIN XML_FEATURE("DeviceID") XML_FEATURE("DeviceVendorName") XML_FEATURE("DeviceModelName")
    XML_FEATURE("DeviceSerialNumber") XML_FEATURE("DeviceVersion") XML_ROOT_END
    XML_STRING("DevicePort", "DeviceID", "0x0") XML_STRING("DevicePort", "DeviceVendorName", "0x100")
    XML_STRING("DevicePort", "DeviceModelName", "0x200") XML_STRING("DevicePort", "DeviceSerialNumber", "0x300")
    XML_STRING("DevicePort", "DeviceVersion", "0x400") XML_PORT("DevicePort");

static const char stream_xml[] = XML_HEAD("Stream", "6f0b9a51-3c1e-4f5b-9d2c-5f6c0e6b1a04")
    XML_ROOT_BEGIN XML_FEATURE("StreamID") XML_FEATURE("StreamAnnouncedBufferCount")
    XML_FEATURE("StreamInputBufferCount") XML_FEATURE("StreamOutputBufferCount")
    XML_FEATURE("StreamStartedFrameCount") XML_FEATURE("StreamDeliveredFrameCount")
    XML_FEATURE("StreamLostFrameCount") XML_FEATURE("StreamIsGrabbing") XML_ROOT_END
    XML_STRING("StreamPort", "StreamID", "0x0") XML_INTEGER("StreamPort", "StreamAnnouncedBufferCount", "0xF00")
    XML_INTEGER("StreamPort", "StreamInputBufferCount", "0xF08")
    XML_INTEGER("StreamPort", "StreamOutputBufferCount", "0xF10")
    XML_INTEGER("StreamPort", "StreamStartedFrameCount", "0xF18")
    XML_INTEGER("StreamPort", "StreamDeliveredFrameCount", "0xF20")
    XML_INTEGER("StreamPort", "StreamLostFrameCount", "0xF28")
    XML_INTEGER("StreamPort", "StreamIsGrabbing", "0xF30") XML_PORT("StreamPort");

/* ---- what a handle is a port of ---- */

typedef struct {
    Kind kind;
    Device *device; /* held */
    Stream *stream;
} Port;

static bool open_port(const void *handle, Port *port) {
    *port = (Port){0};
    if (handle == &library.system || handle == &library.interface) {
        port->kind = handle == &library.system ? KIND_SYSTEM : KIND_INTERFACE;
        return port->kind == KIND_SYSTEM ? is_system(handle) : is_interface(handle);
    }
    if ((port->device = hold(handle, KIND_DEVICE)) != NULL)
        port->kind = KIND_DEVICE;
    else if ((port->device = hold(handle, KIND_REMOTE)) != NULL)
        port->kind = KIND_REMOTE;
    else if ((port->stream = hold_stream(handle, KIND_STREAM)) != NULL) {
        port->kind = KIND_STREAM;
        port->device = port->stream->device;
    }
    return port->kind != 0;
}

static void close_port(Port *port) {
    if (port->device != NULL)
        release(port->device);
}

static const char *xml_of(Kind kind) {
    return kind == KIND_SYSTEM      ? system_xml
           : kind == KIND_INTERFACE ? interface_xml
           : kind == KIND_DEVICE    ? device_xml
                                    : stream_xml;
}

/* ---- registers ---- */

static void set_string(uint8_t *page, int index, const char *text) {
    snprintf((char *)page + 256 * index, 256, "%s", text);
}

static void set_integer(uint8_t *page, int index, uint64_t value) {
    memcpy(page + INTEGERS + 8 * index, &value, sizeof value);
}

static void fill_stream_page(Stream *stream, uint8_t *page) {
    set_string(page, 0, "Stream0");
    pthread_mutex_lock(&stream->lock);
    set_integer(page, 0, stream->num_announced);
    set_integer(page, 1, stream->input.length);
    set_integer(page, 2, stream->output.length);
    set_integer(page, 3, stream->started);
    set_integer(page, 4, stream->delivered);
    set_integer(page, 5, stream->lost_frames);
    set_integer(page, 6, stream->grabbing);
    pthread_mutex_unlock(&stream->lock);
}

static void fill_page(const Port *port, uint8_t *page) {
    if (port->kind == KIND_SYSTEM) {
        set_string(page, 0, PRODUCER_VENDOR);
        set_string(page, 1, PRODUCER_MODEL);
        set_string(page, 2, PRODUCER_VERSION);
        set_string(page, 3, library_path());
        set_string(page, 4, TL_TYPE);
    } else if (port->kind == KIND_INTERFACE) {
        set_string(page, 0, INTERFACE_ID);
        set_integer(page, 0, library.num_records);
    } else if (port->kind == KIND_DEVICE) {
        const DeviceRecord *record = &port->device->record;
        set_string(page, 0, record->id);
        set_string(page, 1, record->vendor);
        set_string(page, 2, record->model);
        set_string(page, 3, record->serial);
        set_string(page, 4, record->version);
    } else {
        fill_stream_page(port->stream, page);
    }
}

static GC_ERROR read_local(const Port *port, uint64_t address, void *out, size_t *size) {
    uint8_t page[PAGE_SIZE] = {0};
    const char *xml = xml_of(port->kind);
    size_t xml_size = strlen(xml);
    if (address <= PAGE_SIZE && *size <= PAGE_SIZE - address) {
        fill_page(port, page);
        memcpy(out, page + address, *size);
    } else if (address >= XML_ADDRESS && address - XML_ADDRESS <= xml_size &&
               *size <= xml_size - (address - XML_ADDRESS)) {
        memcpy(out, xml + (address - XML_ADDRESS), *size);
    } else {
        return fail(GC_ERR_INVALID_ADDRESS, "no %zu bytes at 0x%" PRIx64, *size, address);
    }
    return GC_ERR_SUCCESS;
}

GC_API GCReadPort(void *handle, uint64_t address, void *out, size_t *size) {
    Port port;
    if (out == NULL || size == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the data");
    if (!open_port(handle, &port))
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error;
    if (port.kind == KIND_REMOTE) {
        Request request = {.operation = OP_READ, .argument = address, .length = (uint32_t)*size};
        error = wire_call(&port.device->connection, request, NULL, out, size, NULL);
    } else {
        error = read_local(&port, address, out, size);
    }
    close_port(&port);
    return error;
}

GC_API GCWritePort(void *handle, uint64_t address, const void *data, size_t *size) {
    Port port;
    if (data == NULL || size == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no data");
    if (!open_port(handle, &port))
        return GC_ERR_INVALID_HANDLE;
    GC_ERROR error;
    if (port.kind == KIND_REMOTE) {
        Request request = {.operation = OP_WRITE, .argument = address, .payload = (uint32_t)*size};
        error = wire_call(&port.device->connection, request, data, NULL, NULL, NULL);
    } else {
        error = fail(GC_ERR_ACCESS_DENIED, "the registers of this module can only be read");
    }
    close_port(&port);
    return error;
}

GC_API GCReadPortStacked(void *handle, PORT_REGISTER_STACK_ENTRY *entries, size_t *count) {
    GC_ERROR error = GC_ERR_SUCCESS;
    if (entries == NULL || count == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no entries");
    size_t done = 0;
    for (; done < *count && error == GC_ERR_SUCCESS; done += error == GC_ERR_SUCCESS) {
        size_t size = entries[done].Size;
        error = GCReadPort(handle, entries[done].Address, entries[done].pBuffer, &size);
    }
    *count = done;
    return error;
}

GC_API GCWritePortStacked(void *handle, PORT_REGISTER_STACK_ENTRY *entries, size_t *count) {
    GC_ERROR error = GC_ERR_SUCCESS;
    if (entries == NULL || count == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no entries");
    size_t done = 0;
    for (; done < *count && error == GC_ERR_SUCCESS; done += error == GC_ERR_SUCCESS) {
        size_t size = entries[done].Size;
        error = GCWritePort(handle, entries[done].Address, entries[done].pBuffer, &size);
    }
    *count = done;
    return error;
}

/* ---- information on a port and its XML ---- */

static const char *port_text(const Port *port, int32_t command) {
    static const char *const names[] = {"", "TLPort", "InterfacePort", "DevicePort", "Device", "StreamPort"};
    static const char *const modules[] = {"", "TLSystem", "TLInterface", "TLDevice", "Device", "TLDataStream"};
    bool device = port->kind == KIND_DEVICE || port->kind == KIND_REMOTE;
    switch (command) {
    case PORT_INFO_ID:
        return device                          ? port->device->record.id
               : port->kind == KIND_STREAM     ? "Stream0"
               : port->kind == KIND_INTERFACE  ? INTERFACE_ID
                                               : library_path();
    case PORT_INFO_VENDOR:
        return device ? port->device->record.vendor : PRODUCER_VENDOR;
    case PORT_INFO_MODEL:
        return device ? port->device->record.model : PRODUCER_MODEL;
    case PORT_INFO_TLTYPE:
        return TL_TYPE;
    case PORT_INFO_MODULE:
        return modules[port->kind];
    case PORT_INFO_VERSION:
        return device ? port->device->record.version : PRODUCER_VERSION;
    case PORT_INFO_PORTNAME:
        return names[port->kind];
    default:
        return NULL;
    }
}

GC_API GCGetPortInfo(void *handle, int32_t command, int32_t *type, void *out, size_t *size) {
    Port port;
    if (!open_port(handle, &port))
        return GC_ERR_INVALID_HANDLE;
    const char *text = port_text(&port, command);
    GC_ERROR error;
    if (text != NULL)
        error = put_string(type, out, size, text);
    else if (command == PORT_INFO_LITTLE_ENDIAN || command == PORT_INFO_ACCESS_READ)
        error = put_bool(type, out, size, true);
    else if (command == PORT_INFO_ACCESS_WRITE)
        error = put_bool(type, out, size, port.kind == KIND_REMOTE);
    else if (command == PORT_INFO_BIG_ENDIAN || command == PORT_INFO_ACCESS_NA || command == PORT_INFO_ACCESS_NI)
        error = put_bool(type, out, size, false);
    else
        error = unknown_command(command);
    close_port(&port);
    return error;
}

typedef struct {
    char name[96];
    uint64_t address, size;
} XmlFile;

static XmlFile xml_file(const Port *port) {
    static const char *const names[] = {"", "irpmd_system.xml", "irpmd_interface.xml", "irpmd_device.xml", "",
                                        "irpmd_stream.xml"};
    XmlFile file = {.address = XML_ADDRESS};
    if (port->kind == KIND_REMOTE) {
        file.address = port->device->opened.xml_address;
        file.size = port->device->opened.xml_size;
        snprintf(file.name, sizeof file.name, "%.63s", port->device->opened.xml_name);
    } else {
        file.size = strlen(xml_of(port->kind));
        snprintf(file.name, sizeof file.name, "%s", names[port->kind]);
    }
    return file;
}

static GC_ERROR url_info(const XmlFile *file, int32_t command, int32_t *type, void *out, size_t *size) {
    char url[192];
    switch (command) {
    case URL_INFO_URL:
        snprintf(url, sizeof url, "local:%s;%" PRIx64 ";%" PRIx64 "?SchemaVersion=1.1.0", file->name, file->address,
                 file->size);
        return put_string(type, out, size, url);
    case URL_INFO_SCHEMA_VER_MAJOR:
    case URL_INFO_SCHEMA_VER_MINOR:
    case URL_INFO_FILE_VER_MAJOR:
        return put_int32(type, out, size, 1);
    case URL_INFO_FILE_VER_MINOR:
    case URL_INFO_FILE_VER_SUBMINOR:
        return put_int32(type, out, size, 0);
    case URL_INFO_FILE_REGISTER_ADDRESS:
        return put_uint64(type, out, size, file->address);
    case URL_INFO_FILE_SIZE:
        return put_uint64(type, out, size, file->size);
    case URL_INFO_SCHEME:
        return put_int32(type, out, size, URL_SCHEME_LOCAL);
    case URL_INFO_FILENAME:
        return put_string(type, out, size, file->name);
    default:
        return unknown_command(command);
    }
}

/* A client may ask with a NULL handle (for a device that is not open yet): an error, since 0 URLs would be believed. */
GC_API GCGetNumPortURLs(void *handle, uint32_t *count) {
    Port port;
    if (!open_port(handle, &port))
        return GC_ERR_INVALID_HANDLE;
    close_port(&port);
    if (count == NULL)
        return fail(GC_ERR_INVALID_PARAMETER, "no place for the number");
    *count = 1;
    return GC_ERR_SUCCESS;
}

GC_API GCGetPortURLInfo(void *handle, uint32_t index, int32_t command, int32_t *type, void *out, size_t *size) {
    Port port;
    if (!open_port(handle, &port))
        return GC_ERR_INVALID_HANDLE;
    XmlFile file = xml_file(&port);
    close_port(&port);
    return index == 0 ? url_info(&file, command, type, out, size) : fail(GC_ERR_INVALID_INDEX, "one URL only");
}

GC_API GCGetPortURL(void *handle, char *url, size_t *size) {
    return GCGetPortURLInfo(handle, 0, URL_INFO_URL, NULL, url, size);
}
