"""The USB library of a driver's process: a pyusb backend that reaches the simulated bus, not a real one.

It is found by a dotted name and one argument, so that a driver need not know what it is:
`sims.projector.usb_backend:get_backend` with the path of the bus's Unix socket, as in
`usb.core.find(backend=get_backend("/run/world/usb"), ...)`. Nothing of the simulated world is loaded here but
how messages look; the devices are in the world's process. If that process is not there, no device is found;
if it goes away, every device is as if unplugged.
"""

# ruff: noqa: D102 -- every method is documented by usb.backend.IBackend, which it implements

import array
import errno
import os
import socket
import threading
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import usb.backend  # type: ignore[import-untyped]
from usb.core import USBError, USBTimeoutError  # type: ignore[import-untyped]

from sims.projector.usb_messages import receive_message, send_message

# What libusb 1.0 calls these errors.
LIBUSB_CODES = {
    errno.EIO: -1,
    errno.EACCES: -3,
    errno.ENODEV: -4,
    errno.ENOENT: -5,
    errno.EBUSY: -6,
    errno.ETIMEDOUT: -7,
    errno.EOVERFLOW: -8,
    errno.EPIPE: -9,
}
FOUND_WITHIN_S = 5.0
# Longer than the host's own time-out of a transfer: past it the world's process hangs, and the device with
# it.
GRACE_S = 5.0


def get_backend(socket_path: str | os.PathLike[str]) -> "WorldBackend":
    """Return the USB backend that reaches the bus at a Unix socket; nothing need be there yet."""
    return WorldBackend(os.fspath(socket_path))


@dataclass(frozen=True, slots=True)
class _Found:
    """A device as enumeration found it."""

    address: int
    described: dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Handle:
    address: int
    number: int


class _Descriptor:
    """The fields of a descriptor as attributes."""

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)


class WorldBackend(usb.backend.IBackend):  # type: ignore[misc]
    """Every call of the USB library as a message to the world's process.

    Parameters
    ----------
    socket_path
        The Unix socket of the bus.
    """

    def __init__(self, socket_path: str) -> None:
        self._socket_path = socket_path
        self._session = uuid.uuid4().hex
        self._idle: list[socket.socket] = []
        self._lock = threading.Lock()

    def _finalize_object(self) -> None:
        for connection in self._idle:
            connection.close()
        self._idle.clear()

    # --- messages

    def _connect(self, timeout_s: float | None) -> socket.socket:
        with self._lock:
            if self._idle:
                connection = self._idle.pop()
                connection.settimeout(timeout_s)
                return connection
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(timeout_s)
            connection.connect(self._socket_path)
            send_message(connection, {"session": self._session})
        except OSError:
            connection.close()
            raise
        return connection

    def _call(
        self, call: str, data: bytes = b"", *, timeout_ms: int = 1000, **head: Any
    ) -> tuple[dict[str, Any], bytes]:
        try:
            # A time-out of 0 is for ever.
            connection = self._connect(timeout_ms / 1000 + GRACE_S if timeout_ms else None)
        except OSError as error:
            raise _usb_error(errno.ENODEV, "No such device (it may have been disconnected)") from error
        try:
            send_message(connection, {"call": call, "timeout_ms": timeout_ms} | head, data)
            answer, reply = receive_message(connection)
        except BaseException as error:
            connection.close()
            if isinstance(error, OSError):
                raise _usb_error(errno.ENODEV, "No such device (it may have been disconnected)") from error
            raise
        with self._lock:
            self._idle.append(connection)
        if "errno" in answer:
            raise _usb_error(int(answer["errno"]), str(answer["text"]))
        return answer, reply

    def _handled(self, handle: _Handle, call: str, **head: Any) -> dict[str, Any]:
        return self._call(call, address=handle.address, handle=handle.number, **head)[0]

    # --- finding and describing devices

    def enumerate_devices(self) -> Iterator[_Found]:
        try:
            answer, _ = self._call("enumerate")
        except USBError:
            return
        for described in answer["devices"]:
            yield _Found(int(described["address"]), described)

    def get_parent(self, dev: _Found) -> None:  # noqa: ARG002
        return None

    def get_device_descriptor(self, dev: _Found) -> _Descriptor:
        described = dev.described
        return _Descriptor(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x0200,
            bDeviceClass=0,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=described["vendor"],
            idProduct=described["product"],
            bcdDevice=described["release"],
            iManufacturer=1,
            iProduct=2,
            iSerialNumber=3,
            bNumConfigurations=1,
            address=dev.address,
            bus=described["bus"],
            port_number=described["port"],
            port_numbers=(described["port"],),
            speed=described["speed"],
        )

    def get_configuration_descriptor(self, dev: _Found, config: int) -> _Descriptor:
        _in_range(config, 1, "configuration")
        return _Descriptor(
            bLength=9,
            bDescriptorType=2,
            wTotalLength=18 + 7 * len(dev.described["endpoints"]),
            bNumInterfaces=1,
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0xC0,
            bMaxPower=50,
            extra_descriptors=[],
        )

    def get_interface_descriptor(self, dev: _Found, intf: int, alt: int, config: int) -> _Descriptor:
        _in_range(config, 1, "configuration")
        _in_range(intf, 1, "interface")
        _in_range(alt, 1, "alternate setting")
        return _Descriptor(
            bLength=9,
            bDescriptorType=4,
            bInterfaceNumber=0,
            bAlternateSetting=0,
            bNumEndpoints=len(dev.described["endpoints"]),
            bInterfaceClass=dev.described["interface_class"],
            bInterfaceSubClass=0,
            bInterfaceProtocol=0,
            iInterface=0,
            extra_descriptors=[],
        )

    def get_endpoint_descriptor(self, dev: _Found, ep: int, intf: int, alt: int, config: int) -> _Descriptor:
        self.get_interface_descriptor(dev, intf, alt, config)
        endpoints = dev.described["endpoints"]
        _in_range(ep, len(endpoints), "endpoint")
        return _Descriptor(
            bLength=7,
            bDescriptorType=5,
            bEndpointAddress=endpoints[ep]["address"],
            bmAttributes=endpoints[ep]["attributes"],
            wMaxPacketSize=endpoints[ep]["packet_bytes"],
            bInterval=endpoints[ep]["interval"],
            bRefresh=0,
            bSynchAddress=0,
            extra_descriptors=[],
        )

    # --- handles

    def open_device(self, dev: _Found) -> _Handle:
        return _Handle(dev.address, int(self._call("open", address=dev.address)[0]["handle"]))

    def close_device(self, dev_handle: _Handle) -> None:
        # Closing never fails: without the world there is nothing left to close.
        try:
            self._handled(dev_handle, "close")
        except USBError:
            return

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        self._handled(dev_handle, "set_configuration", value=config_value)

    def get_configuration(self, dev_handle: _Handle) -> int:
        return int(self._handled(dev_handle, "get_configuration")["value"])

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        if intf or altsetting:
            raise _usb_error(errno.ENOENT, "Entity not found")
        self._handled(dev_handle, "get_configuration")

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        self._handled(dev_handle, "claim", interface=intf)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        self._handled(dev_handle, "release", interface=intf)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        self._handled(dev_handle, "clear_halt", endpoint=ep)

    def reset_device(self, dev_handle: _Handle) -> None:
        self._handled(dev_handle, "reset")

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:  # noqa: ARG002
        return bool(self._handled(dev_handle, "kernel_driver")["active"])

    def detach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:  # noqa: ARG002
        self._handled(dev_handle, "detach")

    def attach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:  # noqa: ARG002
        self._handled(dev_handle, "attach")

    # --- transfers

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: Any, timeout: int) -> int:  # noqa: ARG002
        answer, _ = self._call(
            "out",
            data.tobytes(),
            timeout_ms=timeout,
            address=dev_handle.address,
            handle=dev_handle.number,
            endpoint=ep,
        )
        return int(answer["count"])

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: Any, timeout: int) -> int:  # noqa: ARG002
        _, reply = self._call(
            "in",
            timeout_ms=timeout,
            address=dev_handle.address,
            handle=dev_handle.number,
            endpoint=ep,
            size=len(buff) * buff.itemsize,
        )
        return _fill(buff, reply)

    intr_write = bulk_write
    intr_read = bulk_read

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,
        timeout: int,
    ) -> int:
        outward = not bmRequestType & 0x80
        _, reply = self._call(
            "control",
            data.tobytes() if outward else b"",
            timeout_ms=timeout,
            address=dev_handle.address,
            handle=dev_handle.number,
            type=bmRequestType,
            request=bRequest,
            value=wValue,
            index=wIndex,
            size=len(data) * data.itemsize,
        )
        return len(data) * data.itemsize if outward else _fill(data, reply)


def _usb_error(number: int, text: str) -> USBError:
    kind = USBTimeoutError if number == errno.ETIMEDOUT else USBError
    return kind(text, LIBUSB_CODES.get(number, -99), number)


def _in_range(index: int, count: int, what: str) -> None:
    """Past the end is an IndexError: that is how the library finds out how many there are."""
    if not 0 <= index < count:
        raise IndexError(f"Invalid {what} index {index}")


def _fill(buffer: "array.array[int]", reply: bytes) -> int:
    memoryview(buffer).cast("B")[: len(reply)] = reply
    return len(reply)
