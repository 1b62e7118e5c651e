"""A USB bus of simulated devices, served to drivers' processes over a Unix socket.

The world's process owns a `UsbBus` and plugs devices into it; the other end, `usb_backend`, is the USB
library of a driver's process. Which interface a process has claimed is known here, as the operating system
knows it.
"""

import contextlib
import errno
import socket
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sims.projector.usb_device import UsbDevice, UsbTransferError
from sims.projector.usb_messages import receive_message, send_message

BUS_NUMBER = 1


@dataclass(slots=True)
class _Socket:
    """A place on the bus: a device, and a new address every time that it is plugged in."""

    device: UsbDevice
    port: int
    address: int | None = None


class UsbBus:
    """Devices behind one Unix socket.

    Parameters
    ----------
    socket_path
        Where to listen.
    """

    def __init__(self, socket_path: Path) -> None:
        self.socket_path = socket_path
        self._lock = threading.RLock()
        self._places: list[_Socket] = []
        self._sessions: Counter[str] = Counter()
        # Who holds which (address, interface): a session's name and the number of its handle.
        self._claims: dict[tuple[int, int], tuple[str, int]] = {}
        self._next_address = self._next_handle = 1
        self._listener: socket.socket | None = None
        self._acceptor: threading.Thread | None = None
        self._threads: set[threading.Thread] = set()
        self._connections: set[socket.socket] = set()

    def add(self, device: UsbDevice, *, plugged: bool = True) -> None:
        """Give a device a place on the bus; it learns how to plug and unplug itself."""
        with self._lock:
            place = _Socket(device, len(self._places) + 1)
            self._places.append(place)
        device.attach(lambda: self._plug(place), lambda: self._unplug(place))
        if plugged:
            self._plug(place)

    def start(self) -> None:
        """Listen for drivers."""
        self.socket_path.parent.mkdir(parents=True, exist_ok=True)
        self.socket_path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self.socket_path))
        self._listener.listen(16)
        self._acceptor = threading.Thread(target=self._accept, args=(self._listener,), daemon=True)
        self._acceptor.start()

    def close(self) -> None:
        """Unplug everything, drop the clients and end all threads."""
        for place in self._places:
            self._unplug(place)
        if self._listener is None or self._acceptor is None:
            return
        self.socket_path.unlink(missing_ok=True)
        self._listener.shutdown(socket.SHUT_RDWR)
        self._acceptor.join()
        self._listener.close()
        self._listener = self._acceptor = None
        with self._lock:
            connections, threads = list(self._connections), list(self._threads)
        for connection in connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                thread = threading.Thread(target=self._serve, args=(connection,), name="usb-bus", daemon=True)
                with self._lock:
                    self._connections.add(connection)
                    self._threads.add(thread)
                thread.start()

    def _plug(self, place: _Socket) -> None:
        with self._lock:
            if place.address is None:
                place.address = self._next_address
                self._next_address += 1
                place.device.connected()

    def _unplug(self, place: _Socket) -> None:
        with self._lock:
            if place.address is None:
                return
            address, place.address = place.address, None
            self._claims = {claim: holder for claim, holder in self._claims.items() if claim[0] != address}
        place.device.disconnected()

    def _serve(self, connection: socket.socket) -> None:
        session = ""
        with connection, contextlib.suppress(OSError):
            head, _ = receive_message(connection)
            session = str(head["session"])
            with self._lock:
                self._sessions[session] += 1
            while True:
                head, data = receive_message(connection)
                try:
                    answer, reply = self._call(session, head, data, lambda: _is_alive(connection))
                except UsbTransferError as failure:
                    answer, reply = {"errno": failure.errno, "text": failure.strerror}, b""
                send_message(connection, answer, reply)
        with self._lock:
            self._connections.discard(connection)
            self._threads.discard(threading.current_thread())
            if session:
                self._leave(session)

    def _leave(self, session: str) -> None:
        """Free what a process held once the last of its connections has gone."""
        self._sessions[session] -= 1
        if not self._sessions[session]:
            del self._sessions[session]
            self._claims = {claim: holder for claim, holder in self._claims.items() if holder[0] != session}

    def _device(self, address: int) -> UsbDevice:
        with self._lock:
            for place in self._places:
                if place.address == address:
                    return place.device
        raise UsbTransferError(errno.ENODEV, "No such device (it may have been disconnected)")

    def _call(
        self, session: str, head: dict[str, Any], data: bytes, alive: Callable[[], bool]
    ) -> tuple[dict[str, Any], bytes]:
        call = str(head["call"])
        if call == "enumerate":
            return {"devices": self._present()}, b""
        address = int(head["address"])
        if call == "close":
            with self._lock:
                holder = (session, int(head["handle"]))
                self._claims = {claim: held for claim, held in self._claims.items() if held != holder}
            return {}, b""
        device = self._device(address)
        if call == "open":
            with self._lock:
                self._next_handle += 1
                return {"handle": self._next_handle}, b""
        holder = (session, int(head["handle"]))
        if call in ("claim", "release"):
            self._claim(holder, (address, int(head["interface"])), device, take=call == "claim")
            return {}, b""
        if call in ("out", "in"):
            claim = (address, device.interface_of(int(head["endpoint"])))
            if self._claims.get(claim) != holder:
                raise UsbTransferError(errno.EIO, "Input/Output Error")
        return device.call(call, head, data, alive)

    def _present(self) -> list[dict[str, Any]]:
        with self._lock:
            return [
                {"bus": BUS_NUMBER, "address": place.address, "port": place.port} | place.device.description()
                for place in self._places
                if place.address is not None
            ]

    def _claim(self, holder: tuple[str, int], claim: tuple[int, int], device: UsbDevice, *, take: bool) -> None:
        with self._lock:
            held = self._claims.get(claim)
            if take:
                if device.kernel_driver or held not in (None, holder):
                    raise UsbTransferError(errno.EBUSY, "Resource busy")
                self._claims[claim] = holder
            elif held == holder:
                del self._claims[claim]
            else:
                raise UsbTransferError(errno.ENOENT, "Entity not found")


def _is_alive(connection: socket.socket) -> bool:
    """Whether the client still waits: a process that died must not swallow what its successor waits for."""
    try:
        return connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False
