"""A USB device through pyusb: found, claimed, written and read within bounds; every failure is a typed error."""

import contextlib
import errno
import importlib
from dataclasses import dataclass
from typing import Any

import usb.backend.libusb1
import usb.core
import usb.util

from drivers.errors import (
    ConfigurationError,
    DeviceFault,
    DeviceLost,
    GarbledReply,
    InstrumentError,
    NotConnected,
    TimedOut,
)

# What may lie in an endpoint after an error: replies that nobody fetched.
STALE_READS = 16
STALE_WAIT_MS = 20

_UDEV = "give this user access: install the udev rules of configs/udev and plug it in again"


@dataclass(frozen=True, slots=True)
class UsbAddress:
    """Where a device is on the bus and how it is spoken to; serial_number None: the first that is found."""

    vendor: int
    product: int
    endpoint_out: int
    endpoint_in: int
    interface: int = 0
    serial_number: str | None = None


@dataclass(frozen=True, slots=True)
class UsbBackend:
    """The USB library: "module:function" with at most one argument, or None for libusb."""

    function: str | None = None
    argument: str | None = None


class UsbLink:
    """The line to one device; used by one thread at a time.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    address
        What to look for.
    backend
        The USB library.
    timeout_s
        Bound of one transfer.
    """

    def __init__(self, device: str, address: UsbAddress, backend: UsbBackend, timeout_s: float) -> None:
        self._device = device
        self._address = address
        self._backend_choice = backend
        self._timeout_ms = max(1, round(timeout_s * 1000))
        self._backend: Any = None
        self._usb: Any = None
        self._detached = False

    @property
    def is_open(self) -> bool:
        """Whether the device is claimed, as far as is known."""
        return self._usb is not None

    def open(self) -> None:
        """Find the device, configure it and claim its interface.

        Raises
        ------
        NotConnected
            It is not there, or another program or the system's rights keep it.
        ConfigurationError
            There is no such backend, or no USB library.
        """
        self.close()
        self._backend = load_backend(self._device, self._backend_choice)
        try:
            self._claim()
        except usb.core.USBError as error:
            self.close()
            raise self._not_connected(error) from None
        except ValueError:
            # What pyusb raises where it may not read the serial number.
            self.close()
            raise NotConnected(self._device, "the USB device's serial number cannot be read", _UDEV) from None
        except InstrumentError:
            self.close()
            raise

    def close(self) -> None:
        """Give the device back; never raises, may be repeated."""
        found, self._usb = self._usb, None
        backend, self._backend = self._backend, None
        if found is not None:
            with contextlib.suppress(usb.core.USBError):
                usb.util.release_interface(found, self._address.interface)
            if self._detached:
                with contextlib.suppress(usb.core.USBError, NotImplementedError):
                    found.attach_kernel_driver(self._address.interface)
            with contextlib.suppress(usb.core.USBError):
                usb.util.dispose_resources(found)
        self._detached = False
        if backend is not None:
            backend.finalize()

    def write(self, data: bytes) -> None:
        """Write all of `data`.

        Raises
        ------
        TimedOut, DeviceLost, DeviceFault
            It does not take it in time; it has gone; its endpoint stalled or takes only a part.
        """
        endpoint = self._address.endpoint_out
        try:
            count = self._claimed().write(endpoint, data, self._timeout_ms)
        except usb.core.USBError as error:
            raise self._transfer_error(error, endpoint) from None
        if count != len(data):
            raise DeviceFault(self._device, f"it took {count} of {len(data)} bytes", "switch it off and on, then retry")

    def read(self, size: int, timeout_s: float | None = None) -> bytes:
        """Read one transfer of at most `size` bytes; raises as `write`, or GarbledReply if more came."""
        endpoint = self._address.endpoint_in
        timeout_ms = self._timeout_ms if timeout_s is None else max(1, round(timeout_s * 1000))
        try:
            return bytes(self._claimed().read(endpoint, size, timeout_ms))
        except usb.core.USBError as error:
            raise self._transfer_error(error, endpoint) from None

    def recover(self, size: int) -> None:
        """After an error: clear halted endpoints and throw away replies that nobody fetched."""
        device = self._claimed()
        try:
            for endpoint in (self._address.endpoint_out, self._address.endpoint_in):
                device.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise self._transfer_error(error, endpoint) from None
        for _ in range(STALE_READS):
            try:
                device.read(self._address.endpoint_in, size, STALE_WAIT_MS)
            except usb.core.USBTimeoutError:
                return
            except usb.core.USBError as error:
                raise self._transfer_error(error, self._address.endpoint_in) from None

    def _claim(self) -> None:
        address = self._address
        serial = {} if address.serial_number is None else {"serial_number": address.serial_number}
        found = usb.core.find(backend=self._backend, idVendor=address.vendor, idProduct=address.product, **serial)
        if found is None:
            which = "" if address.serial_number is None else f" with serial number {address.serial_number!r}"
            raise NotConnected(
                self._device,
                f"no USB device {address.vendor:04x}:{address.product:04x}{which} is found",
                "switch it on and plug it in",
            )
        self._usb = found
        with contextlib.suppress(NotImplementedError):
            if found.is_kernel_driver_active(address.interface):
                found.detach_kernel_driver(address.interface)
                self._detached = True
        found.set_configuration()
        usb.util.claim_interface(found, address.interface)

    def _claimed(self) -> Any:
        device = self._usb
        if device is None:
            raise DeviceLost(self._device, "it has gone from the USB bus", "plug it in and switch it on")
        return device

    def _not_connected(self, error: Exception) -> NotConnected:
        number = getattr(error, "errno", None)
        if number in (errno.EACCES, errno.EPERM):
            return NotConnected(self._device, "the USB device may not be used by this user", _UDEV)
        if number == errno.EBUSY:
            return NotConnected(self._device, "another program holds the USB device", "end that program")
        return NotConnected(self._device, f"the USB device cannot be opened: {error}", "unplug it and plug it in again")

    def _transfer_error(self, error: Exception, endpoint: int) -> InstrumentError:
        # A time-out is a USBError, too.
        if isinstance(error, usb.core.USBTimeoutError):
            seconds = self._timeout_ms / 1000
            return TimedOut(self._device, f"no answer on USB within {seconds:g} s", "look at the projector, then retry")
        number = getattr(error, "errno", None)
        if number in (errno.ENODEV, errno.EIO, errno.ENOENT, errno.ENXIO, errno.ESHUTDOWN):
            self.close()
            return DeviceLost(self._device, "it has gone from the USB bus", "plug it in and switch it on")
        if number == errno.EOVERFLOW:
            return GarbledReply(self._device, "more came on USB than a reply can be", "retry")
        if number == errno.EPIPE:
            return DeviceFault(self._device, f"the USB endpoint {endpoint:#04x} stalled", "retry")
        return DeviceFault(self._device, f"a USB transfer failed: {error}", "unplug it and plug it in again")


def load_backend(device: str, choice: UsbBackend) -> Any:
    """Return the USB library that is named by its dotted name, or libusb.

    Raises
    ------
    ConfigurationError
        There is none of that name, or no libusb on this machine.
    """
    if choice.function is None:
        backend = usb.backend.libusb1.get_backend()
        if backend is None:
            raise ConfigurationError(device, "there is no libusb", "install it (Debian: libusb-1.0-0)")
        return backend
    module, colon, function = choice.function.partition(":")
    arguments = () if choice.argument is None else (choice.argument,)
    try:
        if not colon:
            raise ValueError("it is not of the form module:function")
        backend = getattr(importlib.import_module(module), function)(*arguments)
    except (ImportError, AttributeError, TypeError, ValueError, OSError) as error:
        raise ConfigurationError(
            device,
            f"the USB backend {choice.function!r} cannot be used: {error}",
            "name one as module:function, or none for libusb",
            ("backend",),
        ) from error
    if not isinstance(backend, usb.backend.IBackend):
        raise ConfigurationError(
            device, f"{choice.function!r} returns no pyusb backend", "name one, or none for libusb", ("backend",)
        )
    return backend
