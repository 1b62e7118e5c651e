/* What the parts of the producer share: modules, buffers, the wire to the simulated device. */
#ifndef IRPMD_PRODUCER_H
#define IRPMD_PRODUCER_H

#include "gentl.h"

#include <pthread.h>
#include <stdbool.h>

#define TL_TYPE "Custom"
#define PRODUCER_VENDOR "irpmd-rig"
#define PRODUCER_MODEL "Simulated GenTL producer"
#define PRODUCER_VERSION "1.0"
#define INTERFACE_ID "irpmd-rig simulated USB3"
#define MAX_DEVICES 8

/* ---- the wire: fixed little-endian records over a Unix stream socket (the other end: sims/camera/wire.py) ---- */

#define WIRE_VERSION 1
enum { OP_LIST = 1, OP_OPEN, OP_READ, OP_WRITE, OP_STREAM, OP_START, OP_STOP, OP_ACKNOWLEDGE };
enum { FRAME_IMAGE = 1, FRAME_STARTED, FRAME_STOPPED };

typedef struct {
    uint32_t operation;
    uint32_t sequence;
    uint64_t argument; /* register address, wire version, session or ring slot */
    uint32_t length;   /* bytes asked for */
    uint32_t payload;  /* bytes that follow */
} Request;

typedef struct {
    int32_t status; /* a GC_ERROR */
    uint32_t sequence;
    uint64_t value;
    uint32_t payload; /* bytes that follow */
    uint32_t unused;
} Reply;

typedef struct {
    char id[64], vendor[64], model[64], serial[64], version[64], name[64];
    uint32_t access_status;
    uint32_t unused;
} DeviceRecord;

typedef struct {
    uint64_t session; /* token that the stream's connection names */
    uint64_t xml_address;
    uint64_t xml_size;
    char xml_name[64];
} OpenRecord;

typedef struct {
    uint32_t kind;
    uint32_t slot;
    uint64_t frame_id;
    uint64_t timestamp_ns;
    uint64_t offset;    /* of the payload in the ring; for FRAME_STARTED: size of the ring */
    uint64_t size;      /* of the whole payload */
    uint64_t delivered; /* bytes of it that came through */
    uint64_t pixel_format;
    uint32_t width, height, offset_x, offset_y, padding_x;
    uint32_t lossless; /* wait for a free buffer instead of losing the frame */
} FrameRecord;

typedef struct {
    int fd;
    uint32_t sequence;
    bool lost;
    pthread_mutex_t lock;
} Connection;

const char *library_path(void);
int wire_connect(void);
GC_ERROR wire_call(Connection *connection, Request request, const void *out, void *in, size_t *in_size, uint64_t *value);
bool wire_send(int fd, const void *data, size_t size);
bool wire_receive(int fd, void *data, size_t size);
bool wire_receive_with_descriptor(int fd, void *data, size_t size, int *descriptor);

/* ---- modules; each handle that a client holds points to the first member of one of these ---- */

typedef enum { KIND_SYSTEM = 1, KIND_INTERFACE, KIND_DEVICE, KIND_REMOTE, KIND_STREAM, KIND_EVENT } Kind;

typedef struct Buffer {
    struct Buffer *next; /* in the list of announced buffers */
    struct Buffer *following; /* in the queue that holds it */
    enum { BUFFER_IDLE, BUFFER_INPUT, BUFFER_FILLING, BUFFER_OUTPUT } state;
    uint8_t *data;
    size_t size;
    void *user;
    bool ours; /* allocated by the producer */
    bool new_data;
    FrameRecord frame;
} Buffer;

typedef struct {
    Buffer *first, *last;
    size_t length;
} Queue;

void queue_push(Queue *queue, Buffer *buffer);
Buffer *queue_pop(Queue *queue);

typedef struct Device Device;

typedef struct {
    Kind kind;
} Handle;

typedef struct {
    Handle handle;
    Handle event; /* the NEW_BUFFER event's handle */
    Device *device;
    Connection connection;
    pthread_mutex_t lock;
    pthread_cond_t filled, refilled;
    Buffer *announced;
    size_t num_announced;
    Queue input, output;
    pthread_mutex_t control; /* one start or stop at a time */
    bool registered, grabbing, stopping, closing, lost;
    unsigned waiting, kills;
    uint64_t delivered, underruns, lost_frames, fired, started, to_acquire, next_frame_id;
    pthread_t thread;
    int wake; /* eventfd: ends the thread */
    const uint8_t *ring;
    size_t ring_size;
} Stream;

struct Device {
    Handle handle;
    Handle remote; /* the remote device's port */
    DeviceRecord record;
    OpenRecord opened;
    Connection connection;
    Stream *stream;
    unsigned users; /* calls under way on the device, its port, its stream or its event */
    Device *next;
};

typedef struct {
    Handle system, interface;
    bool initialised, system_open, interface_open;
    pthread_mutex_t lock;
    pthread_cond_t released;
    DeviceRecord records[MAX_DEVICES];
    unsigned num_records;
    Device *devices;
} Library;

extern Library library;

/* Look a handle up: NULL, or what it names, which stays alive until `release`. */
bool is_system(const void *handle);
bool is_interface(const void *handle);
Device *hold(const void *handle, Kind kind);
Stream *hold_stream(const void *handle, Kind kind); /* to be released by its device */
void release(Device *device);

GC_API TLClose(void *system);
GC_ERROR system_info(int32_t command, int32_t *type, void *out, size_t *size);
GC_ERROR close_interface(void);
GC_ERROR close_device(Device *device);
GC_ERROR stream_open(Device *device);
void stream_shut(Stream *stream);
void stream_free(Stream *stream);
GC_ERROR device_info(const DeviceRecord *record, bool open, int32_t command, int32_t *type, void *out, size_t *size);

/* ---- answers ---- */

GC_ERROR fail(GC_ERROR code, const char *format, ...) __attribute__((format(printf, 2, 3)));
GC_ERROR unknown_command(int32_t command);
GC_ERROR put_string(int32_t *type, void *out, size_t *size, const char *text);
GC_ERROR put_int32(int32_t *type, void *out, size_t *size, int32_t value);
GC_ERROR put_uint64(int32_t *type, void *out, size_t *size, uint64_t value);
GC_ERROR put_size(int32_t *type, void *out, size_t *size, size_t value);
GC_ERROR put_bool(int32_t *type, void *out, size_t *size, bool value);
GC_ERROR put_pointer(int32_t *type, void *out, size_t *size, void *value);

#endif
