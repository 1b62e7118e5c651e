"""Frames of a rehearsal, given back when the same frame is asked for again."""

from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]
# 400 frames of 2048 x 2048 in 8 bits: a whole measurement with its references.
LIMIT_BYTES = 400 * 2**22


class Recording:
    """Frames by what they show; those asked for longest ago go first.

    Parameters
    ----------
    limit_bytes : int
        Memory that the frames may take.
    """

    def __init__(self, limit_bytes: int = LIMIT_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._frames: OrderedDict[Hashable, Image] = OrderedDict()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, key: Hashable, render: Callable[[], Image]) -> Image:
        """Return the frame of this key; the first time it is rendered."""
        frame = self._frames.pop(key, None)
        if frame is None:
            frame = render()
            self._bytes += frame.nbytes
            while self._bytes > self._limit_bytes and self._frames:
                self._bytes -= self._frames.popitem(last=False)[1].nbytes
        self._frames[key] = frame
        return frame
