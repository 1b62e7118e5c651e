"""One run that is being computed: its frames, what it may use, and how far it is."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Drawing
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.archive import UNITS, Content
from irpmd_rig.processing.chain import Chain
from irpmd_rig.processing.errors import FramesUnusable
from irpmd_rig.processing.frames import FringeStation, fringe_stations, picture
from irpmd_rig.processing.phases import Phases, StationPhase
from irpmd_rig.processing.regions import Mask, lit
from irpmd_rig.processing.rig_facts import RigFacts, rig_facts
from irpmd_rig.processing.stage_position import GlassSeen
from irpmd_rig.processing.values import Announce, ProcessedRun, Progress, Summary
from irpmd_rig.processing.whole import withdraw
from irpmd_rig.store.entries import ManifestEntry, Orientation
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.record import RunRecord, software_versions
from irpmd_rig.store.run_folder import RunFolder


class Job:
    """One run that is being computed.

    Parameters
    ----------
    folder, record, entries
        The run.
    chain
        What it uses.
    phases
        Decodes and remembers.
    announce
        Is told how far it is.
    """

    def __init__(
        self,
        folder: RunFolder,
        record: RunRecord,
        entries: Sequence[ManifestEntry],
        chain: Chain,
        phases: Phases,
        announce: Announce,
    ) -> None:
        self.folder = folder
        self.record = record
        self.entries = tuple(entries)
        self.chain = chain
        self._phases = phases
        self._announce = announce
        self._done = 0
        self._steps = 1
        self.threads = phases.threads
        self.files: list[str] = []

    @property
    def facts(self) -> RigFacts:
        """What is known of the rig; raises ProcessingError if it is wrong."""
        return rig_facts(self.record)

    @property
    def drawing(self) -> Drawing:
        """Nominal places of camera and glass; raises ProcessingError if they are not known."""
        return self.facts.known_drawing()

    def plan(self, steps: int) -> None:
        """Set how many steps `step` will be told of."""
        self._steps = steps

    def step(self, text: str) -> None:
        """Begin the next step."""
        self._announce(Progress(text, min(1.0, self._done / self._steps)))
        self._done += 1

    def begin_results(self) -> None:
        """Delete what was computed before: old and new results never lie side by side."""
        withdraw(self.folder.results)

    def withdraw(self) -> None:
        """Delete what was computed of a run that cannot be computed: half of it would pass for a result."""
        if self.files:
            with suppress(OSError, StoreError):
                withdraw(self.folder.results)

    def wrote(self, name: str) -> None:
        """Tell of a result that is on disk."""
        self.files.append(name)
        self._announce(Progress(f"{name} is written", min(1.0, self._done / self._steps), name))

    def stations(self, label: str, orientation: Orientation = "x") -> tuple[FringeStation, ...]:
        """Full sets of fringes of one label; raises FramesUnusable."""
        return fringe_stations(self.entries, label, orientation)

    def has(self, label: str, orientation: Orientation) -> bool:
        """Whether there are fringes of a label along an axis of the projector."""
        return any(e.label == label and e.role == "fringes" and e.orientation == orientation for e in self.entries)

    def phase(self, station: FringeStation, *, take: bool = False) -> StationPhase:
        """Phase of a station (`Phases.at`); raises FramesUnusable, or Refused for frames of another size."""
        known = self._phases.at(self.folder, station, take=take)
        self.chain.check_size(known.size_px)
        return known

    def glass(
        self, station: FringeStation, phase: StationPhase, model: RigModel, outline_mm: NDArray[np.float64]
    ) -> GlassSeen:
        """What the glass tells in a station's frames (`Phases.glass`)."""
        return self._phases.glass(station, phase, model, outline_mm)

    def release(self) -> None:
        """Let go of what decoding another station would use again."""
        self._phases.release()

    def region(self, label: str, station: int | None = None) -> Mask:
        """Where the projector lights a scene, from its white and black frame; raises FramesUnusable."""
        white = picture(self.folder, self.entries, label, "white", station)
        black = picture(self.folder, self.entries, label, "black", station)
        if white.shape != black.shape:
            raise FramesUnusable(f"white and black frame of {label!r} differ in size", "measure again")
        return lit(white, black)

    def header(self, size_px: tuple[int, int]) -> Content:
        """Say which run it is, of when, with what: how every result begins."""
        record = self.record
        return {
            "kind": record.kind,
            "run": self.folder.id,
            "created": record.created.isoformat() if record.created else None,
            "computed": datetime.now(UTC).isoformat(),
            "units": UNITS,
            "camera_serial": record.optics.camera_serial if record.optics else None,
            "size_px": list(size_px),
            "uses": dict(self.chain.uses),
            "versions": software_versions(),
        }

    def finished(self, **summary: Summary) -> ProcessedRun:
        """Everything is on disk: sum it up."""
        uses = {str(kind): run for kind, run in self.chain.uses.items()}
        known = {key: _known(value) for key, value in summary.items()}
        return ProcessedRun(self.folder.id, self.record.kind, uses, tuple(self.files), known)


def known_number(value: float) -> float | None:
    """Give None for what is not a finite number: JSON has none."""
    return float(value) if np.isfinite(value) else None


def _known(value: Summary) -> Summary:
    if isinstance(value, list):
        return [None if number is None else known_number(number) for number in value]
    return known_number(value) if isinstance(value, float) else value


def size_of(shape: tuple[int, ...]) -> tuple[int, int]:
    """Width and height of a picture's shape."""
    return shape[1], shape[0]
