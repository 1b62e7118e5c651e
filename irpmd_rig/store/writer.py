"""Frames to disk while the rig takes the next: one thread, a bounded queue, many frames a sync of the folder."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import suppress
from pathlib import Path

from irpmd_rig.store.durable import Journal, sync_folder, typed_errors
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.frame_file import Image, place_frame

# A set of twelve 2048 x 2048 frames of 8 bits fits: the camera never waits for the disk within a set.
_UNWRITTEN_BYTES = 64_000_000
# A folder that nobody closes keeps no thread for longer.
_IDLE_S = 1.0


class FrameWriter:
    """Writes frames and their manifest lines in the order in which they come.

    A frame is durable when its manifest line is: first the file (written beside, synced, renamed), then the folder,
    then the line. Frames that wait together share the sync of the folder and of the manifest.

    Parameters
    ----------
    folder
        The run's folder.
    manifest
        Its manifest.
    """

    def __init__(self, folder: Path, manifest: Journal) -> None:
        self._folder = folder
        self._manifest = manifest
        self._changed = threading.Condition()
        self._waiting: deque[tuple[Image, ManifestEntry]] = deque()
        self._unwritten_bytes = 0
        self._not_durable = 0
        self._error: Exception | None = None
        self._thread: threading.Thread | None = None
        self._closing = False

    def put(self, image: Image, entry: ManifestEntry) -> None:
        """Hand a frame over; waits while too many are on their way.

        Raises
        ------
        DiskFull, WriteFailed
            If an earlier frame could not be written: it and all behind it are gone, this one too.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._error or self._has_room(image.nbytes))
            self._raise()
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="frame-writer", daemon=True)
                self._thread.start()
            self._waiting.append((image, entry))
            self._unwritten_bytes += image.nbytes
            self._not_durable += 1
            self._changed.notify_all()

    def flush(self) -> None:
        """Wait until every frame handed over is durable.

        Raises
        ------
        DiskFull, WriteFailed
            If one could not be written. It is said once; the writer may be used again afterwards.
        """
        with self._changed:
            self._changed.wait_for(lambda: not self._not_durable)
            self._raise()

    def close(self) -> None:
        """Write what waits and end the thread; raises as `flush` does."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
            thread = self._thread
        if thread is not None:
            thread.join()
        with self._changed:
            self._closing = False
            self._raise()

    def _has_room(self, nbytes: int) -> bool:
        return self._unwritten_bytes == 0 or self._unwritten_bytes + nbytes <= _UNWRITTEN_BYTES

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing, timeout=_IDLE_S)
                group = len(self._waiting)
                if not group:
                    self._thread = None
                    return
            error: Exception | None = None
            try:
                self._write_group(group)
            # Whatever it is, it belongs to the thread that waits for these frames.
            except Exception as problem:
                error = problem
            with self._changed:
                if error is not None:
                    self._error = error
                    self._waiting.clear()
                    self._unwritten_bytes = 0
                self._not_durable = len(self._waiting)
                self._changed.notify_all()

    def _write_group(self, group: int) -> None:
        """Make frames durable; one that fails takes those behind it with it, never those before it."""
        written: list[ManifestEntry] = []
        try:
            for _ in range(group):
                image, entry = self._waiting[0]
                written.append(place_frame(self._folder, image, entry))
                with self._changed:
                    self._waiting.popleft()
                    self._unwritten_bytes -= image.nbytes
                    self._changed.notify_all()
                del image
        finally:
            self._enter(written)

    def _enter(self, written: list[ManifestEntry]) -> None:
        if not written:
            return
        try:
            with typed_errors(self._manifest.path):
                sync_folder(self._folder / "frames")
            self._manifest.append([entry.line() for entry in written])
        except StoreError:
            # Nobody knows these frames: they would only take the room that the run's last line needs.
            for entry in written:
                with suppress(OSError):
                    (self._folder / entry.path).unlink()
            raise
