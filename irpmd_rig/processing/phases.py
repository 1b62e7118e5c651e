"""Absolute phases of a run's stations: decoded once, ahead of time where possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import AbsolutePhase, check_frames, decode
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.core.phase.counts import usual_unwrapping
from irpmd_rig.core.phase.pattern_error import PatternError, pattern_error
from irpmd_rig.core.phase.results import phase_sigma
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.errors import FramesUnusable, ProcessingError
from irpmd_rig.processing.frames import Frame, FringeStation, read_fringes
from irpmd_rig.processing.regions import Window
from irpmd_rig.processing.rig_facts import rig_facts
from irpmd_rig.processing.stage_position import GlassSeen, glass_seen
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Reason

_SAMPLE = 8  # pixels between those from which a map's typical values are taken
# Many stations, whose maps would wait for each other: nobody asks for the sigma of their pixels.
_WITHOUT_MODULATION = "plate"


@dataclass(frozen=True, slots=True, eq=False)
class StationPhase:
    """Absolute phase at one station, and what it is worth.

    Attributes
    ----------
    phase_rad
        float32 (H, W), NaN where not valid; the pattern's own error is removed.
    modulation_map_dn
        float32 (H, W); None where it is not kept: of the white plate.
    noise_dn
        float32 (h, w): one sigma of the phase times the modulation, at few pixels (`AbsolutePhase.noise_dn`).
    valid_fraction
        Share of the picture's pixels that are valid.
    modulation_dn, sigma_rad
        Medians over the valid pixels: modulation, and one sigma of the phase by the frames' own noise.
    """

    phase_rad: NDArray[np.float32]
    modulation_map_dn: NDArray[np.float32] | None
    noise_dn: NDArray[np.float32]
    valid_fraction: float
    modulation_dn: float
    sigma_rad: float

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        height, width = self.phase_rad.shape
        return width, height

    def sigma_in(self, window: Window) -> NDArray[np.float32]:
        """One sigma of the phase by the frames' own noise, in a window; rad, without meaning where not valid."""
        assert self.modulation_map_dn is not None  # nobody asks it of the white plate
        return phase_sigma(self.noise_dn, self.modulation_map_dn, window)

    def quality(self) -> dict[str, float | None]:
        """What the phase is worth, for people; None where it cannot be known."""
        figures = {name: getattr(self, name) for name in ("valid_fraction", "modulation_dn", "sigma_rad")}
        return {name: value if np.isfinite(value) else None for name, value in figures.items()}


class Phases:
    """Decodes stations of one folder at a time and remembers them until another folder comes.

    Parameters
    ----------
    threads
        For decoding.
    """

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        self._folder: Path | None = None
        self._known: dict[tuple[Any, ...], StationPhase] = {}
        self._frames: Frame | None = None
        self._maps: AbsolutePhase | None = None
        self._glass: dict[tuple[Any, ...], tuple[RigModel, GlassSeen]] = {}
        self._errors: dict[tuple[tuple[float, ...], int, int], PatternError] = {}

    def at(self, folder: RunFolder, station: FringeStation, *, take: bool = False) -> StationPhase:
        """Phase of a station, decoded now if it was not before.

        Parameters
        ----------
        folder, station
            Which frames.
        take
            Whether to forget the phase: the caller keeps it, or no longer needs it.

        Raises
        ------
        FramesUnusable
            If frames cannot be read or decoded.
        """
        if folder.path != self._folder:
            self.forget()
            self._folder = folder.path
        known = self._known.pop(station.key, None) or self._decode(folder, station)
        if not take:
            self._known[station.key] = known
        return known

    def glass(
        self, station: FringeStation, phase: StationPhase, model: RigModel, outline_mm: NDArray[np.float64]
    ) -> GlassSeen:
        """What the glass tells (`glass_seen`) in the frames of a station whose phase was asked for; found once."""
        known = self._glass.get(station.key)
        if known is None or known[0] is not model:
            known = self._glass[station.key] = model, glass_seen(station, phase, model, outline_mm)
        return known[1]

    def forget(self) -> None:
        """Let go of all phases and buffers."""
        self._folder = None
        self._known.clear()
        self._glass.clear()
        self.release()

    def release(self) -> None:
        """Let go of the buffers; the phases stay."""
        self._frames = self._maps = None

    def _decode(self, folder: RunFolder, station: FringeStation) -> StationPhase:
        self._frames = frames = read_fringes(folder, station, self._frames)
        maps = self._maps
        if maps is not None and maps.phase_rad.shape == frames.shape[2:]:
            # Phase and modulation stay with whoever asked for them; the other map is used again.
            phase, modulation = (np.empty(frames.shape[2:], np.float32) for _ in range(2))
            maps = replace(maps, phase_rad=phase, modulation_dn=modulation)
        else:
            maps = None
        try:
            self._maps = result = decode(
                frames,
                station.counts,
                unwrapping=usual_unwrapping(station.counts),
                threads=self.threads,
                saturation_dn=station.full_scale_dn,
                out=maps,
            )
        except MeasurementError as error:
            remedy = "measure again" if station.full_scale_dn else 'give the camera\'s "bits": 12 or so in the manifest'
            raise FramesUnusable(
                f"station {station.number} ({station.label}) cannot be decoded: {error}", remedy
            ) from None
        # Levels that compensate a gamma are rounded in other ways than those that the error is known for.
        if folder.record().recipe.get("compensation") is None:
            self._pattern_error(folder, station).remove(result.phase_rad)
        summarised = _summarised(result)
        return replace(summarised, modulation_map_dn=None) if station.label == _WITHOUT_MODULATION else summarised

    def _pattern_error(self, folder: RunFolder, station: FringeStation) -> PatternError:
        """Error of the images that `irpmd_rig.core.fringe_images` makes for this rig's projector."""
        size_px = rig_facts(folder.record()).projector.size_px
        key = station.counts, station.steps, size_px[0 if station.orientation == "x" else 1]
        if key not in self._errors:
            self._errors[key] = pattern_error(*key, unwrapping=usual_unwrapping(station.counts))
        return self._errors[key]


def check_station(folder: RunFolder, station: FringeStation, announce: Callable[[str], None]) -> dict[str, Any]:
    """Check a station's frames against each other, unless that was done when they were taken.

    Returns
    -------
    dict
        What is known of the frames' quality.

    Raises
    ------
    FramesUnusable
        If a frame is stale, blended, dropped, swapped or saturated.
    """
    if station.checked:
        return {"checked": "when taken", "checks": dict(station.entries[-1].checks)}
    announce(f"station {station.number} ({station.label}): frames are checked")
    frames = read_fringes(folder, station)
    try:
        report = check_frames(frames, station.counts, saturation_dn=station.full_scale_dn)
    except MeasurementError as error:
        raise ProcessingError(str(error), "measure again", reason=Reason.FRAME_QUALITY) from None
    if not report.ok:
        findings = "; ".join(finding.message for finding in report.findings)
        raise FramesUnusable(f"station {station.number} ({station.label}): {findings}", "measure again")
    return {
        "checked": "now",
        "noise_dn": report.noise_dn,
        "modulation_dn": list(report.modulation_dn),
        "lit_fraction": report.lit_fraction,
        "weak_fraction": report.weak_fraction,
        "notes": list(report.notes),
    }


def _summarised(result: AbsolutePhase) -> StationPhase:
    thin = np.s_[::_SAMPLE, ::_SAMPLE]
    valid = result.valid[thin]
    modulation = np.median(result.modulation_dn[thin][valid]) if valid.any() else np.nan
    sigma = np.median(result.sigma_in(thin)[valid]) if valid.any() else np.nan
    return StationPhase(
        phase_rad=result.phase_rad,
        modulation_map_dn=result.modulation_dn,
        noise_dn=result.noise_dn,
        valid_fraction=float(np.count_nonzero(result.valid) / result.valid.size),
        modulation_dn=float(modulation),
        sigma_rad=float(sigma),
    )
