"""Frames between the worker and the program: slots in one anonymous memory file, one copy in, none out.

The first page holds one byte a slot: 0 free, 1 taken. Only the worker takes slots, only the program frees
them, so that no lock is needed. The file has no name: it is gone when both processes are, however they end.
"""

import ctypes
import fcntl
import mmap
import os
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

FREE, TAKEN = b"\0", b"\1"
_PAGE = mmap.PAGESIZE
# Constants of fcntl(2); Python 3.11's fcntl module has them, its type stubs do not.
_ADD_SEALS, _SEAL_SIZE = 1033, 0x1 | 0x2 | 0x4
_libc = ctypes.CDLL(None, use_errno=True)
_libc.mmap.restype = ctypes.c_void_p
_libc.mmap.argtypes = (
    ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long,
)  # fmt: skip
_libc.munmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t)
_MAP_FAILED = ctypes.c_void_p(-1).value


def _pages(size_bytes: int) -> int:
    return -(-size_bytes // _PAGE) * _PAGE


def _identity(descriptor: int) -> tuple[int, int]:
    status = os.fstat(descriptor)
    return status.st_dev, status.st_ino


class RingWriter:
    """The worker's side: makes the memory and fills its slots.

    Parameters
    ----------
    slots
        How many frames it holds.
    slot_bytes
        Size of the largest frame.
    """

    def __init__(self, slots: int, slot_bytes: int) -> None:
        self.slots, self.slot_bytes = slots, slot_bytes
        self._stride = _pages(slot_bytes)
        size = _PAGE + slots * self._stride
        self.descriptor = os.memfd_create("camera frames", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(self.descriptor, size)
        # Memory that shrank under the program would kill it.
        fcntl.fcntl(self.descriptor, _ADD_SEALS, _SEAL_SIZE)
        self._memory = mmap.mmap(self.descriptor, size)

    def free_slot(self) -> int | None:
        """Return a slot that nobody uses, if there is one."""
        found = self._memory.find(FREE, 0, self.slots)
        return None if found < 0 else found

    def array(self, slot: int, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
        """Return the slot's memory, to be filled; let it go before `close`."""
        return np.ndarray(shape, kind, self._memory, _PAGE + slot * self._stride)

    def take(self, slot: int) -> None:
        """Give a filled slot to the program."""
        self._memory[slot : slot + 1] = TAKEN

    def close(self) -> None:
        """Let the memory go."""
        self._memory.close()
        os.close(self.descriptor)


class RingReader:
    """The program's side: frames as arrays that own their slot until they are collected.

    Parameters
    ----------
    descriptor
        Of the memory file; the caller closes it.
    slots, slot_bytes
        As the writer made it.

    Raises
    ------
    ValueError
        The file is smaller than that.
    OSError
        It cannot be mapped.
    """

    def __init__(self, descriptor: int, slots: int, slot_bytes: int) -> None:
        self.slots, self.slot_bytes = slots, slot_bytes
        self._stride = _pages(slot_bytes)
        size = _PAGE + slots * self._stride
        if not 0 < slots <= _PAGE or slot_bytes <= 0 or os.fstat(descriptor).st_size < size:
            raise ValueError("the ring of frames is smaller than announced")
        # Not mmap.mmap: it keeps a descriptor for as long as a caller keeps a frame.
        address = _libc.mmap(None, size, mmap.PROT_READ | mmap.PROT_WRITE, mmap.MAP_SHARED, descriptor, 0)
        if address is None or address == _MAP_FAILED:
            raise OSError(ctypes.get_errno(), "the ring of frames cannot be mapped")
        self._memory = (ctypes.c_uint8 * size).from_address(address)
        weakref.finalize(self._memory, _libc.munmap, address, size).atexit = False
        self._lent = 0
        self._identity = _identity(descriptor)

    def same(self, descriptor: int) -> bool:
        """Whether a descriptor is of this ring's memory."""
        return self._identity == _identity(descriptor)

    def take(self, slot: int, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
        """Return a filled slot's frame as a read-only array that nothing ever changes.

        Up to half of the slots are lent: the array is the slot's memory, and the slot is freed when neither the
        array nor any view of it is left. Beyond that the frame is copied, so that a caller who keeps frames
        never starves the camera.

        Raises
        ------
        ValueError
            There is no such slot, or the frame does not fit into one.
        """
        size = int(np.prod(shape, dtype=np.int64)) * kind.itemsize
        if not 0 <= slot < self.slots or not 0 < size <= self.slot_bytes:
            raise ValueError("a frame outside the ring was announced")
        # An object of its own for each loan: numpy lets views of views refer to it directly.
        loan = (ctypes.c_uint8 * size).from_buffer(self._memory, _PAGE + slot * self._stride)
        image: NDArray[Any] = np.frombuffer(memoryview(loan), kind).reshape(shape)
        if self._lent < self.slots // 2:
            self._lent += 1
            weakref.finalize(loan, self._give_back, slot).atexit = False
        else:
            image = image.copy()
            self.free(slot)
        image.flags.writeable = False
        return image

    def free(self, slot: int) -> None:
        """Give a slot back that was not taken."""
        if 0 <= slot < self.slots:
            self._memory[slot] = FREE[0]

    def _give_back(self, slot: int) -> None:
        self._lent -= 1
        self.free(slot)
