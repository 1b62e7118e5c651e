"""From sampled pixels to findings: order first, then the small faults of the frames that are in their places."""

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.quality.describe import STALE_SHARE, describe
from irpmd_rig.core.quality.model import misfit, phase_agreement
from irpmd_rig.core.quality.order import (
    CLEARLY_BEST,
    DECIDE_PIXELS,
    Court,
    Hypothesis,
    Verdict,
    find_orders,
    sure,
)
from irpmd_rig.core.quality.report import FindingKind, FrameFinding
from irpmd_rig.core.quality.sampling import Sample
from irpmd_rig.core.quality.sets import fit_sets
from irpmd_rig.core.quality.small import SmallLimits, find_small

Floats = NDArray[np.float64]

NOISE_PIXELS = 3000

CORRECTABLE = 0.7
"""Share of the previous frame up to which a blend can be undone without drowning in noise."""

_STILL_FRINGES = ("dropped", "repeated", "swapped")
"""Findings after which the frame at their place is right, or known to be absent."""


class Examination:
    """Findings of one set of frames.

    Attributes
    ----------
    findings
        Faults of order, then small ones.
    between
        Whether the sets' phases agree well enough to check them against each other.
    noise_dn
        Noise of one value of the frames without a finding; NaN if they have no redundancy.
    modulation_dn
        (sets, pixels) from the frames without a finding; NaN for sets of which too few are left.
    """

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
        source, verdicts, score, self._counts = min(trials, key=lambda t: t[2])
        if verdicts and self._blends_explain(sample, limits, floor_dn2, score):
            source, verdicts = np.arange(sets * steps), []
        self._present = (source >= 0).reshape(sets, steps)
        self._values = self._recorded[np.maximum(source, 0)].reshape(values.shape)
        self.findings = [f for v in verdicts for f in self._of_order(v)]
        agreement = phase_agreement(self._values, self._present, self._counts, sample.noise_dn)
        self.between = agreement.good
        self.findings += self._small(sample, limits)
        if agreement.contradiction is not None and not self.findings:
            against = sure(agreement.contradiction, sample.tile)
            self.findings.append(FrameFinding("inconsistent", -1, -1, against, agreement.share_of_chance, 0.0))
        for finding in self.findings:
            if finding.kind == "inconsistent":
                continue
            self._present[finding.set, finding.step] &= finding.kind in _STILL_FRINGES
        few = slice(None, None, max(1, values.shape[2] // NOISE_PIXELS))
        result = misfit(self._values[..., few], self._present, self._counts, between=self.between)
        self.noise_dn = np.nan if result is None else float(np.sqrt(result.variance_dn2()))
        fits = fit_sets(self._values, self._present)
        self.modulation_dn = np.where(fits.used[:, None], np.abs(fits.z), np.nan)

    def _blends_explain(self, sample: Sample, limits: SmallLimits, floor_dn2: float, score: float) -> bool:
        """Whether small faults of several frames fit the frames clearly better than frames left out."""
        values = self._recorded.reshape(sample.values_dn.shape)
        present = np.ones(values.shape[:2], bool)
        faults = find_small(values, present, self._counts, sample.tile, noise_dn=None, limits=limits)
        if len(faults) < 2 or any(abs(f.size) > CORRECTABLE for f in faults):
            return False
        corrected = self._recorded.copy()
        for fault in sorted(faults, key=lambda f: f.frame):
            m = fault.frame
            if fault.kind == "blended":
                corrected[m] = (corrected[m] - fault.size * corrected[m - 1]) / (1 - fault.size)
            else:
                corrected[m] /= 1 + fault.size
        court = Court(corrected.reshape(values.shape), sample.tile, self._counts, floor_dn2)
        as_recorded = Hypothesis("as recorded", np.arange(present.size), ())
        return court.score(as_recorded, DECIDE_PIXELS) < CLEARLY_BEST * score

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
