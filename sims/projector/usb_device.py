"""What every simulated USB device has in common: descriptors, endpoints, stalls, and being unplugged."""

import errno
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

# Standard requests (USB 2.0 specification, table 9-4) and descriptor types (table 9-5).
GET_STATUS, CLEAR_FEATURE, GET_DESCRIPTOR, GET_CONFIGURATION = 0x00, 0x01, 0x06, 0x08
DEVICE, CONFIGURATION, STRING = 1, 2, 3
ENGLISH = 0x0409
FROM_DEVICE = 0x80
# How often a transfer that waits looks whether its client still does.
LOOK_ROUND_S = 0.1


class UsbTransferError(OSError):
    """A transfer or request that fails on the bus, with the errno that a USB library reports."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One endpoint; `attributes` 2 is bulk, 3 interrupt."""

    address: int
    attributes: int
    packet_bytes: int
    interval: int = 0


@dataclass(frozen=True, slots=True)
class Identity:
    """What a device says of itself before anyone speaks to it (one configuration, one interface).

    `speed` follows libusb: 2 is full speed, 3 high speed.
    """

    vendor: int
    product: int
    manufacturer: str
    product_name: str
    serial_number: str
    interface_class: int
    endpoints: tuple[Endpoint, ...]
    speed: int = 3
    release: int = 0x0100


class UsbFaults:
    """Faults of the USB side of a device, switchable from any thread while it runs.

    `mute` leaves every read waiting for its time-out.
    """

    def __init__(self, device: "UsbDevice") -> None:
        self._device = device
        self.mute = False
        self._lock = threading.Lock()
        self._stalls = 0
        self._time_outs = 0
        self._garbled = 0

    def stall_next(self, transfers: int = 1) -> None:
        """Stall the next transfers on data endpoints; the endpoint stays halted until it is cleared."""
        with self._lock:
            self._stalls += transfers

    def time_out_next(self, transfers: int = 1) -> None:
        """Take nothing and give nothing in the next transfers, until their time is over."""
        with self._lock:
            self._time_outs += transfers

    def garble_next(self, replies: int = 1) -> None:
        """Disturb the next replies: every second bit of every byte flips."""
        with self._lock:
            self._garbled += replies

    def unplug(self) -> None:
        """Pull the cable: transfers under way and to come fail, the device is gone from the bus."""
        self._device.unplug()

    def replug(self) -> None:
        """Plug the cable in again: the same device with a new address."""
        self._device.plug()

    def clear(self) -> None:
        """Take all faults back, except a pulled cable."""
        with self._lock:
            self.mute = False
            self._stalls = self._time_outs = self._garbled = 0

    def take_stall(self) -> bool:
        """Whether a transfer that begins now stalls."""
        with self._lock:
            self._stalls, stalled = max(0, self._stalls - 1), self._stalls > 0
            return stalled

    def take_time_out(self) -> bool:
        """Whether a transfer that begins now runs out of time."""
        with self._lock:
            self._time_outs, spent = max(0, self._time_outs - 1), self._time_outs > 0
            return spent

    def disturb(self, reply: bytes) -> bytes:
        """Return what of a reply gets onto the bus."""
        with self._lock:
            if not self._garbled:
                return reply
            self._garbled -= 1
            return bytes(byte ^ 0x55 for byte in reply)


class _Wait:
    """How long a transfer waits: in real time, for the host's time-outs are the host's; 0 ms is for ever."""

    def __init__(self, timeout_ms: int, alive: Callable[[], bool]) -> None:
        self.deadline_s = time.monotonic() + timeout_ms / 1000 if timeout_ms else float("inf")
        self.alive = alive


class UsbDevice:
    """A device on the bus; what it does with the bytes is its subclass's business.

    Parameters
    ----------
    identity
        Its descriptors.
    kernel_driver
        Whether the operating system has bound a driver of its own (as Linux does to HID devices), so that the
        interface is busy until that driver is detached.
    """

    def __init__(self, identity: Identity, *, kernel_driver: bool = False) -> None:
        self.identity = identity
        self.kernel_driver = kernel_driver
        self.usb_faults = UsbFaults(self)
        self._binds_kernel_driver = kernel_driver
        self._present = False
        self._configuration = 0
        self._halted: set[int] = set()
        self._queues: dict[int, deque[bytes]] = {}
        self._changed = threading.Condition(threading.RLock())
        self._receiving = threading.Lock()
        self._plug: Callable[[], None] = lambda: None
        self._unplug: Callable[[], None] = lambda: None

    # --- the subclass's side

    def take(self, endpoint: int, data: bytes) -> None:
        """Receive the bytes of one OUT transfer."""
        raise NotImplementedError

    def power_up(self) -> None:
        """Forget half-received messages: a new connection begins."""

    def queue(self, endpoint: int, message: bytes) -> None:
        """Send a message: it waits in packets for the host to fetch it."""
        size = self._endpoint(endpoint).packet_bytes
        message = self.usb_faults.disturb(message)
        with self._changed:
            queue = self._queues.setdefault(endpoint, deque())
            queue.extend(message[i : i + size] for i in range(0, len(message), size))
            self._changed.notify_all()

    # --- the cable

    def attach(self, plug: Callable[[], None], unplug: Callable[[], None]) -> None:
        """Learn from a bus how to be plugged and unplugged."""
        self._plug, self._unplug = plug, unplug

    def plug(self) -> None:
        """Plug the cable in."""
        self._plug()

    def unplug(self) -> None:
        """Pull the cable."""
        self._unplug()

    def connected(self) -> None:
        """Begin as a freshly enumerated device."""
        with self._changed:
            self._present = True
            self._reset()
            self.kernel_driver = self._binds_kernel_driver
        self.power_up()

    def disconnected(self) -> None:
        """End all transfers under way."""
        with self._changed:
            self._present = False
            self._changed.notify_all()

    def _reset(self) -> None:
        self._configuration = 0
        self._halted.clear()
        self._queues.clear()

    # --- the bus's side

    def description(self) -> dict[str, Any]:
        """Return what enumeration finds."""
        return asdict(self.identity)

    def interface_of(self, endpoint: int) -> int:
        """Return the interface that an endpoint belongs to."""
        self._endpoint(endpoint)
        return 0

    def call(
        self, call: str, head: dict[str, Any], data: bytes, alive: Callable[[], bool]
    ) -> tuple[dict[str, Any], bytes]:
        """Carry out one call of the USB library; raise UsbTransferError if it fails on the bus.

        `alive` says whether the caller still waits.
        """
        if call in ("in", "out"):
            endpoint, wait = int(head["endpoint"]), _Wait(int(head["timeout_ms"]), alive)
            if call == "in":
                return {}, self._transfer_in(endpoint, int(head["size"]), wait)
            return {"count": self._transfer_out(endpoint, data, wait)}, b""
        if call == "control":
            return {}, self.control(*(int(head[name]) for name in ("type", "request", "value", "index", "size")))
        return self._housekeeping(call, head), b""

    def _housekeeping(self, call: str, head: dict[str, Any]) -> dict[str, Any]:
        with self._changed:
            if call == "set_configuration":
                if self.kernel_driver:
                    raise UsbTransferError(errno.EBUSY, "Resource busy")
                if int(head["value"]) not in (0, 1):
                    raise UsbTransferError(errno.ENOENT, "Entity not found")
                self._configuration = int(head["value"])
                return {}
            if call == "get_configuration":
                return {"value": self._configuration}
            if call == "clear_halt":
                self._halted.discard(int(head["endpoint"]))
                return {}
            if call == "reset":
                configuration = self._configuration
                self._reset()
                self._configuration = configuration
                return {}
            if call == "kernel_driver":
                return {"active": self.kernel_driver}
            if call in ("detach", "attach"):
                self.kernel_driver = call == "attach" and self._binds_kernel_driver
                return {}
        raise UsbTransferError(errno.ENOSYS, "Operation not supported or unimplemented on this platform")

    def control(self, request_type: int, request: int, value: int, index: int, size: int) -> bytes:
        """Answer a standard control request; stall (EPIPE) on any other."""
        if request_type == FROM_DEVICE and request == GET_DESCRIPTOR:
            return self._descriptor(value >> 8, value & 0xFF)[:size]
        if request_type == FROM_DEVICE and request == GET_CONFIGURATION:
            return bytes([self._configuration])[:size]
        if request_type & 0xE0 == FROM_DEVICE and request == GET_STATUS:
            halted = request_type & 0x1F == 2 and index in self._halted
            return bytes([halted, 0])[:size]
        if request_type == 0x02 and request == CLEAR_FEATURE and value == 0:
            with self._changed:
                self._halted.discard(index)
            return b""
        raise UsbTransferError(errno.EPIPE, "Pipe error")

    def _descriptor(self, kind: int, index: int) -> bytes:
        if kind == STRING:
            texts = (self.identity.manufacturer, self.identity.product_name, self.identity.serial_number)
            if index == 0:
                return struct.pack("<BBH", 4, STRING, ENGLISH)
            if index <= len(texts):
                text = texts[index - 1].encode("utf-16-le")
                return struct.pack("<BB", len(text) + 2, STRING) + text
        raise UsbTransferError(errno.EPIPE, "Pipe error")

    def _endpoint(self, address: int) -> Endpoint:
        for endpoint in self.identity.endpoints:
            if endpoint.address == address:
                return endpoint
        raise UsbTransferError(errno.ENOENT, "Entity not found")

    def _begin(self, endpoint: int, wait: _Wait) -> None:
        """Fail a transfer as its endpoint's state or a fault demands."""
        with self._changed:
            if self.usb_faults.take_stall():
                self._halted.add(endpoint)
            if endpoint in self._halted:
                raise UsbTransferError(errno.EPIPE, "Pipe error")
        if self.usb_faults.take_time_out():
            self._wait_for(lambda: False, wait)
            raise UsbTransferError(errno.ETIMEDOUT, "Operation timed out")

    def _wait_for(self, condition: Callable[[], bool], wait: _Wait) -> bool:
        with self._changed:
            while True:
                if not self._present or not wait.alive():
                    raise UsbTransferError(errno.ENODEV, "No such device (it may have been disconnected)")
                if condition():
                    return True
                left_s = wait.deadline_s - time.monotonic()
                if left_s <= 0:
                    return False
                self._changed.wait(min(left_s, LOOK_ROUND_S))

    def _transfer_out(self, endpoint: int, data: bytes, wait: _Wait) -> int:
        self._endpoint(endpoint)
        self._begin(endpoint, wait)
        # One after the other, whatever threads they come from: there is one wire.
        with self._receiving:
            self.take(endpoint, data)
        return len(data)

    def _transfer_in(self, endpoint: int, size: int, wait: _Wait) -> bytes:
        """Return the packets up to `size`: a short packet ends the transfer, one too long overflows it."""
        packet_bytes = self._endpoint(endpoint).packet_bytes
        self._begin(endpoint, wait)
        queue = self._queues.setdefault(endpoint, deque())
        got = bytearray()
        while len(got) < size:
            with self._changed:
                if not self._wait_for(lambda: bool(queue) and not self.usb_faults.mute, wait):
                    break
                packet = queue.popleft()
            if len(packet) > size - len(got):
                raise UsbTransferError(errno.EOVERFLOW, "Overflow")
            got += packet
            if len(packet) < packet_bytes:
                return bytes(got)
        if not got and size:
            raise UsbTransferError(errno.ETIMEDOUT, "Operation timed out")
        return bytes(got)
