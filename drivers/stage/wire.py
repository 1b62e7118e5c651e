"""Opens a serial line through pyserial: a device file, ``socket://host:port``, or another of its URLs."""

import errno
import socket
import termios
from typing import Any, Protocol, cast
from urllib.parse import urlsplit

import serial
from serial.urlhandler import protocol_socket

from drivers.stage.dialect import Line

READ_SLICE_S = 0.02
WRITE_TIMEOUT_S = 1.0

# tcflush and tcsetattr raise termios.error, which is no OSError; SerialException is one.
IO_ERRORS = (OSError, termios.error)

_PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}


class Wire(Protocol):
    """What is used of an opened line; each call may raise one of `IO_ERRORS`."""

    @property
    def in_waiting(self) -> int:
        """Count the bytes that can be read at once (of a socket: whether there are any)."""

    def read(self, size: int) -> bytes:
        """Read up to `size` bytes, within `READ_SLICE_S`."""

    def write(self, data: bytes, /) -> int | None:
        """Write all of `data`, within `WRITE_TIMEOUT_S`."""

    def close(self) -> None:
        """Close the line."""


class _Socket(protocol_socket.Serial):
    """pyserial's ``socket://``, without its waits that have no end and its descriptor that may stay open."""

    _socket: socket.socket | None

    def reset_input_buffer(self) -> None:
        """Do nothing: pyserial reads here for as long as the peer sends; `Port` drains within a bound."""

    def close(self) -> None:
        """Close the socket also where its peer is gone: pyserial leaves it open when the shutdown fails."""
        self.is_open = False
        connection = self._socket
        self._socket = None
        if connection is not None:
            connection.close()


def open_wire(url: str, line: Line) -> Wire:
    """Open a line.

    Raises
    ------
    ValueError
        No such kind of URL, or a setting that no line has.
    OSError, termios.error
        It cannot be opened.
    """
    settings: dict[str, Any] = {
        "baudrate": line.baud,
        "bytesize": line.data_bits,
        "parity": _PARITY[line.parity],
        "stopbits": line.stop_bits,
        "rtscts": line.flow_control == "rtscts",
        "timeout": READ_SLICE_S,
        "write_timeout": WRITE_TIMEOUT_S,
    }
    if url.lower().startswith("socket://"):
        # pyserial takes what it cannot read here for a line that is not there.
        address = urlsplit(url)
        if not address.hostname or not address.port:
            raise ValueError("it names no host and port")
        connection = _Socket(None, **settings)
        connection.port = url
        connection.open()
        return cast(Wire, connection)
    # Exclusive: two programs that write to one controller would move its stages behind each other's back.
    return cast(Wire, serial.serial_for_url(url, exclusive=True, **settings))


def reason(error: BaseException) -> str:
    """Say in a few words why a line failed."""
    return str(error.args[-1] if error.args else error).strip() or type(error).__name__


def remedy(error: BaseException) -> str:
    """Say what mends a line that cannot be opened."""
    number = getattr(error, "errno", None)
    if number == errno.EACCES:
        return "allow this user to use it: add it to the group dialout, or install the udev rules"
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program uses it: close that one"
    return "plug it in and switch it on, and correct the port in the rig file"
