"""What the check of the frames found: frozen values, with sentences for people."""

from dataclasses import dataclass
from typing import Literal

FindingKind = Literal[
    "stale",
    "blended",
    "duplicate",
    "dropped",
    "repeated",
    "swapped",
    "black",
    "brightness",
    "unexpected",
    "inconsistent",
    "saturated",
    "low_modulation",
]

_SENTENCES: dict[FindingKind, str] = {
    "stale": "shows the frame displayed before it (share {magnitude:.2f})",
    "blended": "holds {magnitude:.3f} of the frame displayed before it",
    "duplicate": "is a copy of {other}",
    "dropped": "was never recorded: from here on every frame is one too late in the sequence",
    "repeated": "was recorded twice: from here on every frame is one too early in the sequence",
    "swapped": "is swapped with {other}",
    "black": "is black",
    "brightness": "is brighter by {magnitude:+.3f} of its mean",
    "unexpected": "is not the frame expected (share {magnitude:.2f} of its modulation is missing)",
    "inconsistent": "has sets whose phases contradict each other ({magnitude:.2f} of what chance would give)",
    "saturated": "has {magnitude:.4f} of its lit pixels at full scale",
    "low_modulation": "has too little modulation in {magnitude:.3f} of its lit pixels",
}


@dataclass(frozen=True, slots=True)
class FrameFinding:
    """One fault, and the frame that has it.

    Attributes
    ----------
    kind
        ``stale`` (the previously displayed frame), ``blended`` (partly the previously displayed frame),
        ``duplicate`` (a copy of another frame, ``other``), ``dropped`` (the frame that belongs here was
        lost; all later ones are one place early, the last one is something else), ``repeated`` (this place
        holds an extra frame; all later ones are one place late), ``swapped`` (with ``other``), ``black``,
        ``brightness`` (one factor or offset over the whole frame), ``unexpected`` (none of these),
        ``saturated``, ``low_modulation`` (of a whole set: ``step`` is -1; of all frames: ``set`` too).
    set, step
        Place of the frame in display order, counted from 0; -1 where the finding concerns all of them.
    confidence
        Probability that this explanation fits the frames better than the best other one, 'no fault'
        included: the one-sided normal probability of the difference of the two misfits, its scatter taken
        from tiles of the picture (the test of Vuong, Econometrica 57, 1989, for models that are not
        nested). 0.5: a draw. For ``saturated`` and ``low_modulation``: the probability that the share
        among all lit pixels lies above the limit, given the sub-sample.
    magnitude
        ``stale``, ``blended``: share of the previous frame (0..1). ``brightness``: relative change of the
        frame's mean. ``unexpected``: share of its own modulation that is missing. ``inconsistent``: squared
        disagreement of the phases, chance being 1. ``saturated``,
        ``low_modulation``: share of the lit pixels. ``dropped``, ``repeated``: 1 (frame). Otherwise 1.
    rms_dn
        RMS over the modulated pixels of recorded minus expected frame (DN); for ``saturated`` and
        ``low_modulation`` 0.
    other
        (set, step) of the other frame, for ``swapped`` and ``duplicate``.
    """

    kind: FindingKind
    set: int
    step: int
    confidence: float
    magnitude: float
    rms_dn: float
    other: tuple[int, int] | None = None

    @property
    def message(self) -> str:
        """One line that names frame, fault and confidence."""
        if self.set < 0:
            place = "the measurement"
        elif self.step < 0:
            place = f"set {self.set}"
        else:
            place = f"set {self.set} step {self.step}"
        other = "" if self.other is None else f"set {self.other[0]} step {self.other[1]}"
        sentence = _SENTENCES[self.kind].format(magnitude=self.magnitude, other=other)
        return f"{place} {sentence} (confidence {self.confidence:.3f})"


@dataclass(frozen=True, slots=True)
class FrameReport:
    """Result of `check_frames`.

    Attributes
    ----------
    findings
        The faults, the structural ones (whole frames out of place) first.
    noise_dn
        One-sigma noise of one pixel of one frame (DN), from the frames' own redundancy after everything
        found was corrected; NaN where there is none (one set of three steps).
    modulation_dn
        Median modulation of each set over the lit pixels (DN); NaN where nothing is lit.
    lit_fraction
        Share of the picture's pixels in which the fringes are seen.
    weak_fraction
        Share of the lit pixels whose modulation lies below 14 noise sigmas, the gate below which fringe
        orders become unsafe (physics notes, section 3); NaN where the noise is unknown.
    pixels
        Number of sub-sampled pixels that the statistics rest on.
    within_sets_checked, between_sets_checked
        Whether the redundancy within a set (4 steps or more) and the consistency of the sets' phases
        (counts that determine each other, noise low enough) could be used.
    notes
        What could not be checked and why, one line each.
    """

    findings: tuple[FrameFinding, ...]
    noise_dn: float
    modulation_dn: tuple[float, ...]
    lit_fraction: float
    weak_fraction: float
    pixels: int
    within_sets_checked: bool
    between_sets_checked: bool
    notes: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """True if nothing was found."""
        return not self.findings
