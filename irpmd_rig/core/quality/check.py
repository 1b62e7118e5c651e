"""The check itself: from recorded frames to findings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from irpmd_rig.core.quality.describe import STALE_SHARE, describe
from irpmd_rig.core.quality.model import fit_sets, misfit, phases_agree
from irpmd_rig.core.quality.order import Court, Verdict, find_orders
from irpmd_rig.core.quality.report import FindingKind, FrameFinding, FrameReport
from irpmd_rig.core.quality.sampling import Sample, checked_frames, full_scale_dn, take_sample
from irpmd_rig.core.quality.small import SmallLimits, find_small

Floats = NDArray[np.float64]

ROUNDING_DN2 = 1 / 12
FEWEST_PIXELS = 64
NOISE_PIXELS = 3000
WEAK_SHARE = 0.5
"""A set is weak if more than this share of its lit pixels is."""

_STILL_FRINGES = ("dropped", "repeated", "swapped")
"""Findings after which the frame at their place is right, or known to be absent."""

GATE_SIGMAS = 14.0
"""Modulation over noise from which the fringe orders are safe (physics notes, section 3)."""

WEAK_SIGMAS = 3.5
"""Modulation over noise below which a pixel's phase is worth nothing (0.2 rad at four steps)."""


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
        Wrong shape or type, fewer than three steps, NaN, a value over full scale.
    CountsError
        Not one positive count for each set.
    """
    frames = checked_frames(frames, tuple(counts), saturation_dn)
    full_scale = full_scale_dn(frames, saturation_dn)
    sample = take_sample(frames, full_scale)
    if min_modulation_dn is None:
        min_modulation_dn = 10.0 * (1.0 if full_scale is None else full_scale / 255)
    notes = [] if full_scale is not None else ["saturation not checked: give saturation_dn for float frames"]
    if sample.values_dn.shape[2] < FEWEST_PIXELS:
        return _nothing_lit(sample, frames.shape[0], notes)
    floor = ROUNDING_DN2 if frames.dtype != np.float32 else 0.0
    examined = _Examination(sample, np.asarray(counts, float), floor, SmallLimits(min_blend, min_brightness_change))
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


class _Examination:
    """Order first, then the small faults of the frames that are in their places."""

    def __init__(self, sample: Sample, counts: Floats, floor_dn2: float, limits: SmallLimits):
        values = sample.values_dn
        sets, steps, _ = values.shape
        self._steps = steps
        self._recorded = values.reshape(sets * steps, -1)
        variation = float(np.median(np.sqrt(2) * self._recorded.std(axis=0)))
        trials = []
        for signed in _directions(counts):
            court = Court(values, sample.tile, signed, floor_dn2)
            trials.append((*find_orders(court, sets * steps, variation, sample.noise_dn), signed))
            if trials[-1][2] == 0:
                break
        source, verdicts, _, self._counts = min(trials, key=lambda t: t[2])
        self._present = (source >= 0).reshape(sets, steps)
        self._values = self._recorded[np.maximum(source, 0)].reshape(values.shape)
        self.findings = [f for v in verdicts for f in self._of_order(v)]
        self.between = phases_agree(self._values, self._present, self._counts)
        self.findings += self._small(sample, limits)
        for finding in self.findings:
            self._present[finding.set, finding.step] &= finding.kind in _STILL_FRINGES
        few = slice(None, None, max(1, values.shape[2] // NOISE_PIXELS))
        result = misfit(self._values[..., few], self._present, self._counts, between=self.between)
        self.noise_dn = np.nan if result is None else float(np.sqrt(result.variance_dn2()))
        fits = fit_sets(self._values, self._present)
        self.modulation_dn = np.where(fits.used[:, None], np.abs(fits.z), np.nan)

    def _of_order(self, verdict: Verdict) -> list[FrameFinding]:
        """List the findings of one accepted hypothesis."""
        hypothesis, steps = verdict.hypothesis, self._steps
        if hypothesis.kind == "wrong":
            return [self._wrong(m, verdict) for m in hypothesis.frames]
        assert hypothesis.kind in ("dropped", "repeated", "swapped")
        first, last = min(hypothesis.frames), max(hypothesis.frames)
        k, n = _place(first, steps)
        other = _place(last, steps) if hypothesis.kind == "swapped" else None
        moved = (hypothesis.source != np.arange(hypothesis.source.size)) & (hypothesis.source >= 0)
        change = self._recorded[hypothesis.source[moved]] - self._recorded[moved]
        rms = float(np.sqrt((change**2).mean())) if moved.any() else 0.0
        return [FrameFinding(hypothesis.kind, k, n, verdict.confidence, 1.0, rms, other)]

    def _wrong(self, place: int, verdict: Verdict) -> FrameFinding:
        """Say what is the matter with a frame that is known to be wrong."""
        steps = self._steps
        what = describe(self._recorded, self._values, self._present, place, verdict.variance_dn2)
        other = None if what.other is None else _place(what.other, steps)
        kind = what.kind
        if kind == "duplicate" and place + 2 == len(self._recorded) and what.other == place + 1:
            # A frame cannot be shown before its time: this one was lost, and the last recorded twice.
            kind, other = "dropped", None
        k, n = _place(place, steps)
        return FrameFinding(kind, k, n, verdict.confidence, what.magnitude, what.rms_dn, other)

    def _small(self, sample: Sample, limits: SmallLimits) -> list[FrameFinding]:
        """List the findings that leave the frames in their places."""
        noise = None
        # An absent frame leaves its set prone to harmonics, which would reach the others through the phases.
        if self.between and self._present.all():
            result = misfit(self._values[..., ::4], self._present, self._counts, between=True)
            noise = None if result is None else float(np.sqrt(result.variance_dn2()))
        steps = self._steps
        found = []
        for fault in find_small(self._values, self._present, self._counts, sample.tile, noise_dn=noise, limits=limits):
            kind: FindingKind = fault.kind
            if kind == "blended" and fault.size >= STALE_SHARE:
                kind = "stale"
            if kind == "brightness" and fault.size <= -STALE_SHARE:
                kind = "black"
            k, n = _place(fault.frame, steps)
            found.append(FrameFinding(kind, k, n, fault.confidence, fault.size, fault.rms_dn))
        return found


def _place(frame: int, steps: int) -> tuple[int, int]:
    """Set and step of a frame."""
    return frame // steps, frame % steps


def _directions(counts: Floats) -> list[Floats]:
    """Counts for a phase that grows with the coordinate, and for one that falls: whole counts do not care."""
    if counts.size == 1 or np.all(counts == np.round(counts)):
        return [counts]
    return [counts, -counts]


def _notes(examined: _Examination, sets: int, steps: int) -> list[str]:
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
        FrameFinding("saturated", k, n, _sureness(float(share), limit, sample.lit_pixels), float(share), 0.0)
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


def _nothing_lit(sample: Sample, sets: int, notes: list[str]) -> FrameReport:
    """Report frames in which no fringes are seen."""
    finding = FrameFinding("low_modulation", -1, -1, 1.0, 1.0, 0.0)
    return FrameReport(
        findings=(finding,),
        noise_dn=np.nan,
        modulation_dn=(np.nan,) * sets,
        lit_fraction=sample.lit_fraction,
        weak_fraction=np.nan,
        pixels=sample.values_dn.shape[2],
        within_sets_checked=False,
        between_sets_checked=False,
        notes=(*notes, "no fringes seen in the picture: nothing else could be checked"),
    )
