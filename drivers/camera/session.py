"""One arming of a camera, in the program: what has come and was not fetched yet."""

import threading
import time
from collections import deque
from dataclasses import dataclass

from drivers.errors import FramesLost, IncompleteFrame, InstrumentError, Refused
from drivers.values import Frame, Trigger


@dataclass(slots=True)
class Tally:
    """Frames since `open`; one lock guards it, the session's."""

    delivered: int = 0
    incomplete: int = 0
    lost: int = 0


def again(error: InstrumentError) -> InstrumentError:
    """Copy an error that is raised more than once, perhaps in several threads."""
    return type(error)(*error.args)


class Session:
    """Frames and gaps in order, between the thread that receives and those that fetch.

    Parameters
    ----------
    device
        Name of the camera, for errors.
    number
        Tells this arming from the others.
    limit
        Frames of the burst; None: without end.
    trigger
        What starts an exposure.
    tally
        Counts over all sessions.
    """

    def __init__(self, device: str, number: int, limit: int | None, trigger: Trigger, tally: Tally) -> None:
        self.number = number
        self.trigger = trigger
        self._device = device
        self._limit = limit
        self._tally = tally
        self._arrived: deque[Frame | InstrumentError] = deque()
        self._changed = threading.Condition()
        self._position = 0
        self._end: InstrumentError | None = None

    def frame(self, frame: Frame) -> None:
        """Take a frame that came."""
        self._put(frame)

    def incomplete(self, index: int) -> None:
        """Take the news of a frame with parts missing."""
        with self._changed:
            self._tally.incomplete += 1
        what = f"frame {index} of the burst arrived with parts missing"
        self._put(IncompleteFrame(self._device, what, "check cable and load of the bus, and take the burst again"))

    def lost(self, frames: int) -> None:
        """Take the news of frames that never arrived."""
        with self._changed:
            self._tally.lost += frames
            self._arrived.append(
                _Lost(self._device, f"{frames} frame{'s' * (frames > 1)} never arrived", "take the burst again", frames)
            )
            self._changed.notify_all()

    def end(self, reason: InstrumentError) -> None:
        """Let every later `next` raise, once what has come was fetched."""
        with self._changed:
            if self._end is None:
                self._end = reason
            self._changed.notify_all()

    def discard(self, reason: InstrumentError) -> None:
        """End at once: what has come is let go."""
        with self._changed:
            self._arrived.clear()
            self._end = reason
            self._changed.notify_all()

    @property
    def complete(self) -> bool:
        """Whether the whole burst was fetched."""
        with self._changed:
            return self._complete()

    @property
    def over(self) -> bool:
        """Whether no frame is taken for it any more."""
        with self._changed:
            return self._end is not None or self._complete()

    def next(self, timeout_s: float) -> Frame | None:
        """Return the next frame, or None where none came in time.

        Raises
        ------
        IncompleteFrame, FramesLost, Refused, DeviceLost
            In the place of the frames that they are about, or as `end` was told.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while not self._arrived:
                if self._complete():
                    raise Refused(self._device, "all frames of the burst were fetched", "arm the camera again")
                if self._end is not None:
                    raise again(self._end)
                left_s = deadline_s - time.monotonic()
                if left_s <= 0 or not self._changed.wait(left_s):
                    if self._arrived or self._end is not None:
                        continue
                    return None
            return self._taken(self._arrived.popleft())

    def _taken(self, item: Frame | InstrumentError) -> Frame:
        if isinstance(item, Frame):
            self._position = item.index + 1
            self._tally.delivered += 1
            return item
        self._position += item.frames if isinstance(item, _Lost) else 1
        raise FramesLost(item.device, item.what, item.remedy) if isinstance(item, _Lost) else item

    def _put(self, item: Frame | InstrumentError) -> None:
        with self._changed:
            if self._end is None:
                self._arrived.append(item)
            self._changed.notify_all()

    def _complete(self) -> bool:
        return self._limit is not None and self._position >= self._limit and not self._arrived


class _Lost(FramesLost):
    """Knows how many frames it stands for."""

    def __init__(self, device: str, what: str, remedy: str, frames: int) -> None:
        super().__init__(device, what, remedy)
        self.frames = frames
