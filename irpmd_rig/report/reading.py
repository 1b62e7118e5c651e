"""What is on disk of a run, as its report needs it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.phase.counts import usual_unwrapping
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import FileNotInRun, StoreError
from irpmd_rig.store.library import Library
from irpmd_rig.store.record import RunRecord
from irpmd_rig.store.results import CALIBRATION, RESULT
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Transition

Content = dict[str, Any]

_SHOWN_PX = 420  # of a frame's longer side


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A run as it lies on disk.

    Attributes
    ----------
    folder
        The folder.
    record, entries, state
        What it is, its frames, and how it ended; None if it has no states.
    content
        `result.json` or `calibration.json`; None if nothing was computed.
    used
        Kind to `calibration.json` of the calibrations and the reference that were used; None where it is not there.
    """

    folder: RunFolder
    record: RunRecord
    entries: tuple[ManifestEntry, ...]
    state: Transition | None
    content: Content | None
    used: dict[str, Content | None]


def read_run(folder: RunFolder, library: Library | None) -> Run:
    """Read everything but frames and arrays; raises RunFolderError."""
    content = _document(folder, RESULT) or _document(folder, CALIBRATION)
    uses: dict[str, str] = (content or {}).get("uses") or {}
    used = {kind: _used(folder, library, kind, run_id) for kind, run_id in uses.items()}
    return Run(folder, folder.record(), folder.manifest(), folder.state(), content, used)


def _document(folder: RunFolder, name: str) -> Content | None:
    try:
        return folder.results.read_json(name)
    except FileNotInRun:
        return None


def _used(folder: RunFolder, library: Library | None, kind: str, run_id: str) -> Content | None:
    """Read a calibration: from the library, or from the folder beside; None if it is neither there nor here."""
    try:
        found = RunFolder(folder.path.resolve().parent / run_id) if library is None else library.resolve(kind, run_id)
        return found.results.read_json(CALIBRATION)
    except StoreError:
        return None


@dataclass(frozen=True, slots=True)
class FringeSets:
    """All frames of the fringes along one axis at one station.

    Attributes
    ----------
    label, orientation
        What stood before the camera; along which axis of the projector the phase grows.
    counts, steps
        Fringe counts of the sets, phase steps of each.
    entries
        By set and step.
    """

    label: str
    orientation: str
    counts: tuple[float, ...]
    steps: int
    entries: tuple[ManifestEntry, ...]

    @property
    def unwrapping(self) -> Literal["optimum", "hierarchical"]:
        """How the counts are meant: from coarse to fine where one set has no more than a period, else by beats."""
        return usual_unwrapping(self.counts)


def fringe_sets(entries: Sequence[ManifestEntry], label: str, orientation: str = "x") -> tuple[FringeSets, ...]:
    """Sets of fringes of a label that are complete, in the order of their stations."""
    wanted = [e for e in entries if (e.label, e.role, e.orientation) == (label, "fringes", orientation)]
    found = []
    for station in sorted({entry.station for entry in wanted}):
        own = {(e.set, e.step): e for e in wanted if e.station == station}
        first = next(iter(own.values()))
        if first.counts is None or first.steps is None:
            continue
        places = [(number, step) for number in range(len(first.counts)) for step in range(first.steps)]
        if all(place in own for place in places):
            ordered = tuple(own[place] for place in places)
            found.append(FringeSets(label, orientation, first.counts, first.steps, ordered))
    return tuple(found)


def thin_frames(
    folder: RunFolder, entries: Sequence[ManifestEntry], window: tuple[slice, slice] | None = None
) -> NDArray[Any] | None:
    """Every so many pixels of frames, (n, h, w): as many as a picture shows; None if a frame is not there any more.

    Parameters
    ----------
    folder, entries
        Which frames.
    window
        Rows and columns that are wanted; all by default.
    """
    frames: list[NDArray[Any]] = []
    for entry in entries:
        try:
            frame = folder.read_frame(entry)[window or np.s_[:, :]]
        except StoreError:
            return None
        stride = max(1, max(frame.shape) // _SHOWN_PX)
        frames.append(frame[::stride, ::stride])
    if not frames or len({frame.shape for frame in frames}) > 1:
        return None
    return np.stack(frames)
