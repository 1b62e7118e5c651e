"""What is seen of the object: its phases at every stage position, and the window of the picture that they fill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.reconstruction.views import Views
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.processing.frames import FringeStation, at_same_positions, check_along_y
from irpmd_rig.processing.glass import glass_mask
from irpmd_rig.processing.job import Job
from irpmd_rig.processing.optics import KnownRig, Optics
from irpmd_rig.processing.phases import StationPhase
from irpmd_rig.processing.regions import Mask, Window, bounding_box, grow, within
from irpmd_rig.processing.stage_position import StagePosition, stage_position


@dataclass(frozen=True, slots=True, eq=False)
class ObjectViews:
    """Phases of the object.

    Attributes
    ----------
    stations
        One a stage position.
    phases, phases_y
        Of the whole picture; None where there are no fringes along y, or the calibration does not know them.
    positions
        Refined where the rig is calibrated.
    window
        Rows and columns that hold every pixel whose phase is known at two positions or more.
    hidden
        Pixels of the window that show the glass itself, or the spray of the reference mirror; None: not known.
    """

    stations: tuple[FringeStation, ...]
    phases: tuple[StationPhase, ...]
    phases_y: tuple[StationPhase, ...] | None
    positions: tuple[StagePosition, ...]
    window: Window
    hidden: Mask | None

    @property
    def read_mm(self) -> tuple[float, ...]:
        """Stage positions as the stage told them."""
        return tuple(position.read_mm for position in self.positions)

    @property
    def true_mm(self) -> tuple[float, ...]:
        """Stage positions as the glass tells them, or as read where it does not."""
        return tuple(position.used_mm for position in self.positions)

    def shifts_mm(self, variations: Sequence[RigModel]) -> NDArray[np.float64]:
        """By how much other rigs would move each of `true_mm`, (variations, positions)."""
        return np.stack([position.shifts_mm(variations) for position in self.positions], axis=1)

    def cut(self, window: Window) -> ObjectViews:
        """Give a smaller window, of the picture's rows and columns, inside this one."""
        hidden = None if self.hidden is None else self.hidden[within(window, self.window)]
        return replace(self, window=window, hidden=hidden)

    def views(self) -> Views:
        """Give them to the methods that use the rig model: cut to the window, positions refined."""

        def cut(phases: Sequence[StationPhase]) -> tuple[NDArray[np.float32], ...]:
            maps = tuple(phase.phase_rad[self.window].copy() for phase in phases)
            if self.hidden is not None:
                for phase in maps:
                    phase[self.hidden] = np.nan
            return maps

        return Views(
            positions_mm=self.true_mm,
            phases_rad=cut(self.phases),
            sigmas_rad=tuple(phase.sigma_in(self.window) for phase in self.phases),
            window=self.window,
            phases_y_rad=None if self.phases_y is None else cut(self.phases_y),
        )


def object_views(job: Job, optics: Optics, stations: tuple[FringeStation, ...]) -> ObjectViews:
    """Phases of the object at all stations.

    Raises
    ------
    FramesUnusable
        If frames are missing or cannot be decoded.
    ProcessingError
        If no pixel is seen at two positions.
    """
    phases = []
    for number, station in enumerate(stations, 1):
        job.step(f"phase at position {number}, {station.stage1_mm:g} mm")
        phases.append(job.phase(station, take=True))
    across = _along_y(job, optics, stations)
    job.release()
    positions, hidden = _glass(job, optics, stations, phases)
    views = np.zeros(phases[0].phase_rad.shape, np.uint8)
    for phase in phases:
        views += np.isfinite(phase.phase_rad)
    seen = views > 1
    if hidden is not None:
        seen &= ~hidden
    elif optics.references is not None:
        outside = np.ones_like(seen)
        outside[optics.references.window] = False
        seen &= ~outside
    # Single pixels that are valid by chance would make the window as large as the picture.
    window = bounding_box(cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)
    if window is None:
        raise nothing_seen()
    cut = None if hidden is None else np.ascontiguousarray(hidden[window])
    return ObjectViews(stations, tuple(phases), across, positions, window, cut)


def nothing_seen() -> ProcessingError:
    """No pixel has a depth."""
    return ProcessingError(
        "no pixel has a depth", "check that the object reflects the glass into the camera at two positions or more"
    )


def hidden_mask(rig: KnownRig, positions_mm: Sequence[float]) -> Mask:
    """Pixels that show the glass itself at any of several positions, or the spray of the reference mirror."""
    glass = [glass_mask(rig.model, rig.outline_mm, position) for position in positions_mm]
    return grow(np.logical_or.reduce([rig.sprayed, *glass]))


def _glass(
    job: Job, optics: Optics, stations: Sequence[FringeStation], phases: Sequence[StationPhase]
) -> tuple[tuple[StagePosition, ...], Mask | None]:
    """Stage positions, and the pixels that show the glass at any of them or the spray of the reference mirror."""
    if optics.rig is None:
        unseen = zip(stations, phases, strict=True)
        return tuple(stage_position(station, phase, None) for station, phase in unseen), None
    model, outline_mm = optics.rig.model, optics.rig.outline_mm
    found = [job.glass(*seen, model, outline_mm) for seen in zip(stations, phases, strict=True)]
    hidden = np.logical_or.reduce([grow(optics.rig.sprayed), *(glass.hidden for glass in found)])
    return tuple(glass.position for glass in found), hidden


def _along_y(job: Job, optics: Optics, stations: tuple[FringeStation, ...]) -> tuple[StationPhase, ...] | None:
    # A calibration from fringes along x does not know which row of the projector lights a point.
    if not job.has("object", "y") or (optics.rig is not None and not optics.rig.along_y):
        return None
    across = at_same_positions(stations, job.stations("object", "y"), job.facts.stage1.in_position_mm)
    check_along_y(stations, across)
    return tuple(job.phase(station, take=True) for station in across)
