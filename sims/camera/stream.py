"""Frames to the computer: a ring of shared memory and a socket that says which part of it holds a frame."""

import mmap
import os
import socket
from collections.abc import Callable
from threading import Condition, Event

import numpy as np

from sims.camera.acquisition import Frame
from sims.camera.wire import FrameKind, FrameRecord, Operation, Request

SLOTS = 16
"""Frames on their way: the real camera writes into the client's memory by itself, so that a client which is not
run for a moment (177 ms at full rate) must not lose what it has room for."""
LOOK_S = 0.05
PAGE_BYTES = mmap.PAGESIZE


class Ring:
    """Memory for `SLOTS` frames that both processes map; the slot freed last, still cached, goes first.

    Parameters
    ----------
    slot_bytes : int
        Room for a frame.
    """

    def __init__(self, slot_bytes: int):
        self.slot_bytes = -(-slot_bytes // PAGE_BYTES) * PAGE_BYTES
        self.size = SLOTS * self.slot_bytes
        self.descriptor = os.memfd_create("irpmd camera frames", os.MFD_CLOEXEC)
        os.ftruncate(self.descriptor, self.size)
        memory = np.frombuffer(mmap.mmap(self.descriptor, self.size), dtype=np.uint8)
        self.slots = memory.reshape(SLOTS, self.slot_bytes)
        self.free = list(range(SLOTS))

    def close(self) -> None:
        """Close the descriptor; the memory goes with its last user."""
        os.close(self.descriptor)


class FrameStream:
    """One client's stream: starts, stops and acknowledges as the client asks, and sends frames in between.

    Parameters
    ----------
    connection : socket.socket
        The stream's connection.
    payload_bytes : callable
        Size of a frame as the camera is set now.
    to_ns : callable
        Converts the clock's seconds to the camera's time stamp.
    """

    def __init__(self, connection: socket.socket, payload_bytes: Callable[[], int], to_ns: Callable[[float], int]):
        self._connection = connection
        self._payload_bytes, self._to_ns = payload_bytes, to_ns
        self._changed = Condition()
        self._ring: Ring | None = None

    def serve(self) -> None:
        """Answer the client until its connection ends."""
        try:
            while True:
                request, _ = Request.receive(self._connection)
                if request.operation == Operation.START:
                    self._start()
                elif request.operation == Operation.STOP:
                    self._stop()
                    self._connection.sendall(FrameRecord(FrameKind.STOPPED).pack())
                else:
                    self._acknowledge(request.argument)
        except (EOFError, OSError):
            pass
        finally:
            self._stop()

    def send(self, frame: Frame, ended: Event, *, lossless: bool) -> bool:
        """Put a frame into the ring and tell the client; False if it is stopped or without room."""
        settings = frame.settings
        size = settings.payload_bytes
        slot = self._take_slot(size, ended, wait=lossless)
        if slot is None:
            return False
        ring, number = slot
        frame.pack(ring.slots[number])
        record = FrameRecord(
            FrameKind.IMAGE,
            slot=number,
            frame_id=frame.frame_id,
            timestamp_ns=self._to_ns(frame.start_s),
            offset=number * ring.slot_bytes,
            size=size,
            delivered=int(size * frame.share),
            pixel_format=settings.pixel_format.value,
            width=settings.size_px[0],
            height=settings.size_px[1],
            offset_x=settings.offset_px[0],
            offset_y=settings.offset_px[1],
            padding_x=settings.line_padding_bytes,
            lossless=lossless,
        ).pack()
        with self._changed:
            if self._ring is not ring or ended.is_set():
                ring.free.append(number)
                return False
            try:
                self._connection.sendall(record)
            except OSError:
                return False
        return True

    def _take_slot(self, size: int, ended: Event, *, wait: bool) -> tuple[Ring, int] | None:
        with self._changed:
            while wait and self._ring is not None and not self._ring.free and not ended.is_set():
                self._changed.wait(LOOK_S)
            ring = self._ring
            # Too small where a client made the region larger after it had started the stream.
            if ring is None or not ring.free or size > ring.slot_bytes or ended.is_set():
                return None
            return ring, ring.free.pop()

    def _start(self) -> None:
        with self._changed:
            self._close_ring()
            self._ring = Ring(self._payload_bytes())
            record = FrameRecord(FrameKind.STARTED, offset=self._ring.size).pack()
            socket.send_fds(self._connection, [record], [self._ring.descriptor])

    def _stop(self) -> None:
        with self._changed:
            self._close_ring()
            self._changed.notify_all()

    def _close_ring(self) -> None:
        if self._ring is not None:
            self._ring.close()
            self._ring = None

    def _acknowledge(self, slot: int) -> None:
        with self._changed:
            if self._ring is not None:
                self._ring.free.append(slot)
                self._changed.notify_all()
