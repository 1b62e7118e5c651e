"""Positions in a burst, from the camera's own count: a lost frame never shifts those that follow it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Arrival:
    """What a frame's id says.

    Attributes
    ----------
    lost
        Frames of the burst that are missing before it.
    index
        Its position in the burst; None: it has none, since it lies beyond the burst or came before.
    """

    lost: int
    index: int | None


class FrameCount:
    """Follows one arming.

    Parameters
    ----------
    limit
        Frames of the burst; None: without end.
    first_id
        Id of the first frame of an earlier arming, where one is known.
    advances
        Whether ids were seen to advance: of a camera that counts nothing all ids are the same.
    """

    def __init__(self, limit: int | None, first_id: int | None = None, *, advances: bool = False) -> None:
        self._limit = limit
        self.first_id = first_id
        self.advances = advances
        self._last_id: int | None = None
        self._last_s: float | None = None
        self._next_id: int | None = None
        self._position = 0
        self._lost = 0

    @property
    def complete(self) -> bool:
        """Whether every position of the burst is accounted for."""
        return self._limit is not None and self._position >= self._limit

    @property
    def first(self) -> bool:
        """Whether no frame has come yet."""
        return self._next_id is None

    def frame(self, frame_id: int, stream_lost: int = 0, timestamp_s: float | None = None) -> Arrival:
        """Take a complete frame.

        Parameters
        ----------
        frame_id
            The camera's count.
        stream_lost
            Frames that the transport knows it has lost since arming. Only the first frame needs it: what came
            before it shows in no gap.
        timestamp_s
            The camera's time of it, where it tells one.
        """
        same_time = timestamp_s is not None and timestamp_s == self._last_s
        self.advances = self.advances or (self._last_id is not None and frame_id > self._last_id)
        self._last_id, self._last_s = frame_id, timestamp_s
        if self._next_id is None:
            gap = self._gap_before_first(frame_id, stream_lost)
            if self._position + gap == 0:
                self.first_id = frame_id
        elif frame_id == self._next_id - 1 and (self.advances or same_time):
            # Delivered again: a stale frame takes no place from those to come.
            return Arrival(0, None)
        else:
            # A count that went backwards has begun anew: nothing can be said about it.
            gap = max(0, frame_id - self._next_id)
        self._next_id = frame_id + 1
        lost = self._skip(gap)
        if self.complete:
            return Arrival(lost, None)
        self._position += 1
        return Arrival(lost, self._position - 1)

    def incomplete(self) -> int:
        """Take a frame that arrived with parts missing; returns its position."""
        self._position += 1
        if self._next_id is not None:
            self._next_id += 1
        return self._position - 1

    def silent(self, stream_lost: int) -> int:
        """Tell how many frames the transport lost since the last one that came: no later id shows them yet."""
        lost = self._skip(max(0, stream_lost - self._lost))
        if self._next_id is not None:
            self._next_id += lost
        return lost

    def _skip(self, frames: int) -> int:
        if self._limit is not None:
            frames = min(frames, self._limit - self._position)
        self._position += frames
        self._lost += frames
        return frames

    def _gap_before_first(self, frame_id: int, stream_lost: int) -> int:
        # Cameras begin at 0 or 1, or where they began before; believed only where the transport says so, too.
        unexplained = stream_lost - self._lost
        for first in (self.first_id, 0, 1):
            if first is not None and 0 < (gap := frame_id - first - self._position) <= unexplained:
                return gap
        return 0
