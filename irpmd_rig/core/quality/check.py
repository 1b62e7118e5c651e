"""The check itself: from recorded frames to findings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from irpmd_rig.core.arguments import checked_number
from irpmd_rig.core.quality.examination import Examination
from irpmd_rig.core.quality.report import FrameFinding, FrameReport
from irpmd_rig.core.quality.sampling import Sample, checked_frames, full_scale_dn, take_sample
from irpmd_rig.core.quality.small import SmallLimits

Floats = NDArray[np.float64]

ROUNDING_DN2 = 1 / 12
FEWEST_PIXELS = 64
WEAK_SHARE = 0.5
"""A set is weak if more than this share of its lit pixels is."""

GATE_SIGMAS = 14.0
"""Modulation over noise from which the fringe orders are safe (physics notes, section 3)."""

WEAK_SIGMAS = 3.0
"""Modulation over noise below which a pixel's phase is worth nothing (0.24 rad at four steps)."""


def check_frames(
    frames: NDArray[np.generic],
    counts: Sequence[float],
    *,
    saturation_dn: float | None = None,
    min_modulation_dn: float | None = None,
    max_saturated_fraction: float = 0.002,
    min_blend: float = 0.02,
    min_brightness_change: float = 0.02,
) -> FrameReport:
    """Find frames that are not what they should be, and say which, how and how surely.

    Works on about 12 000 lit pixels drawn from a regular grid. Detects, with four steps or more, blends with
    the previous frame from 3 % on (at a noise of up to a quarter of the modulation), and every frame that is
    stale, black, lost, repeated, swapped or foreign as far as the redundancy reaches: one set of four steps
    shows that a frame is out of place, but not always which; three steps need several sets. Which of these
    limits applied is in the report.

    Parameters
    ----------
    frames
        (sets, steps, H, W) uint8, uint16 or float32 in the order in which they were displayed;
        I_n = A + B cos(phase + 2 pi n / steps).
    counts
        Fringe count of each set.
    saturation_dn
        Full scale. Default: 255 for uint8; for uint16 that of the smallest camera of 8, 10, 12, 14 or 16
        bits that holds the values; float32 is not checked for saturation.
    min_modulation_dn
        Modulation below which a lit pixel is weak. Default: 10 of 255 of the full scale.
    max_saturated_fraction
        Share of the lit pixels that may be at full scale in a frame.
    min_blend, min_brightness_change
        Smallest share of the previous frame, and smallest relative change of brightness, that are reported.

    Returns
    -------
    FrameReport

    Raises
    ------
    FramesError
        Wrong shape or type, fewer than three steps, NaN, a masked value, a value over full scale.
    CountsError
        Not one positive count, at most 16384, for each set.
    MeasurementError
        A threshold that is no finite number of at least zero (saturation_dn: above zero).
    """
    frames, periods = checked_frames(frames, counts, saturation_dn)
    max_saturated_fraction = checked_number("max_saturated_fraction", max_saturated_fraction)
    limits = SmallLimits(
        checked_number("min_blend", min_blend), checked_number("min_brightness_change", min_brightness_change)
    )
    full_scale = full_scale_dn(frames, saturation_dn)
    sample = take_sample(frames, full_scale)
    if min_modulation_dn is None:
        min_modulation_dn = 10.0 * (1.0 if full_scale is None else full_scale / 255)
    min_modulation_dn = checked_number("min_modulation_dn", min_modulation_dn)
    notes = [] if full_scale is not None else ["saturation not checked: give saturation_dn for float frames"]
    if sample.values_dn.shape[2] < FEWEST_PIXELS:
        return _nothing_lit(sample, frames.shape[0], notes, _saturated(sample, max_saturated_fraction))
    floor = ROUNDING_DN2 if frames.dtype != np.float32 else 0.0
    examined = Examination(sample, periods, floor, limits)
    findings = examined.findings
    findings += _saturated(sample, max_saturated_fraction)
    findings += _weak(examined.modulation_dn, min_modulation_dn, examined.noise_dn)
    sets, steps = frames.shape[:2]
    weak = np.nan
    if np.isfinite(examined.noise_dn):
        known = np.isfinite(examined.modulation_dn[:, 0])
        typical = np.median(examined.modulation_dn[known], axis=0)
        weak = float((typical < GATE_SIGMAS * examined.noise_dn).mean())
    return FrameReport(
        findings=tuple(findings),
        noise_dn=examined.noise_dn,
        modulation_dn=tuple(float(m) for m in np.median(examined.modulation_dn, axis=1)),
        lit_fraction=sample.lit_fraction,
        weak_fraction=weak,
        pixels=sample.values_dn.shape[2],
        within_sets_checked=steps > 3,
        between_sets_checked=examined.between,
        notes=tuple(notes + _notes(examined, sets, steps)),
    )


def _notes(examined: Examination, sets: int, steps: int) -> list[str]:
    """Say what could not be checked, and why."""
    notes = []
    if steps == 3:
        notes.append("3 steps: no redundancy within a set, faults show only in the agreement of the sets")
    if sets == 1:
        notes.append("one set: faults that leave it a sinusoid are not seen, nor always which frame is wrong")
    elif not examined.between:
        notes.append("the sets' phases do not agree well enough to check the sets against each other")
    if np.isnan(examined.noise_dn):
        notes.append("noise not known: no frames are left over to estimate it from")
    return notes


def _sureness(share: float, limit: float, number: int) -> float:
    """Estimate the probability that a share seen among `number` pixels is above the limit."""
    sigma = np.sqrt(max(share * (1 - share), 1 / number) / number)
    return float(ndtr((share - limit) / sigma))


def _saturated(sample: Sample, limit: float) -> list[FrameFinding]:
    """Find frames with too many lit pixels at full scale."""
    return [
        FrameFinding("saturated", k, n, _sureness(float(share), limit, max(sample.lit_pixels, 1)), float(share), 0.0)
        for (k, n), share in np.ndenumerate(sample.saturated_fraction)
        if share > limit
    ]


def _weak(modulation_dn: Floats, minimum_dn: float, noise_dn: float) -> list[FrameFinding]:
    """Find sets in which most lit pixels have too little modulation; one finding if all sets are."""
    gate = minimum_dn if np.isnan(noise_dn) else max(minimum_dn, WEAK_SIGMAS * noise_dn)
    known = np.flatnonzero(np.isfinite(modulation_dn[:, 0]))
    shares = (modulation_dn[known] < gate).mean(axis=1)
    number = modulation_dn.shape[1]
    found = [
        FrameFinding("low_modulation", int(k), -1, _sureness(float(s), WEAK_SHARE, number), float(s), 0.0)
        for k, s in zip(known, shares, strict=True)
        if s > WEAK_SHARE
    ]
    if found and len(found) == modulation_dn.shape[0]:
        least = min(f.confidence for f in found)
        return [FrameFinding("low_modulation", -1, -1, least, float(shares.mean()), 0.0)]
    return found


def _nothing_lit(sample: Sample, sets: int, notes: list[str], saturated: list[FrameFinding]) -> FrameReport:
    """Report frames in which no fringes are seen."""
    finding = FrameFinding("low_modulation", -1, -1, 1.0, 1.0, 0.0)
    return FrameReport(
        findings=(finding, *saturated),
        noise_dn=np.nan,
        modulation_dn=(np.nan,) * sets,
        lit_fraction=sample.lit_fraction,
        weak_fraction=np.nan,
        pixels=sample.values_dn.shape[2],
        within_sets_checked=False,
        between_sets_checked=False,
        notes=(*notes, "no fringes seen in the picture: nothing else could be checked"),
    )
