"""What a frame that is known to be wrong shows instead: compared with what it should have been."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.quality.report import FindingKind
from irpmd_rig.core.quality.sets import fit_sets, harmonic, sinusoid

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

STALE_SHARE = 0.95
"""Share of the previous frame from which a frame counts as stale rather than blended."""

EXPLAINED = 0.25
"""A description is believed if it leaves at most this part of the difference to the expected frame."""

FLAT = 0.2
"""A frame with less than this part of the expected variation shows no fringes."""


@dataclass(frozen=True, slots=True)
class Description:
    """Kind, magnitude (see `FrameFinding`), and RMS difference to the expected frame."""

    kind: FindingKind
    magnitude: float
    rms_dn: float
    other: int | None = None


@dataclass(frozen=True, slots=True)
class _Expected:
    """Frame as it should have been (pixels,), its modulation and wave, and its noise variance factor."""

    frame: Floats
    fringes: Floats
    variance: float
    weight: Floats


def _expected(values: Floats, present: NDArray[np.bool_], place: int) -> _Expected:
    """Predict the frame at `place` from the others of its set (two suffice beside the mean of other sets)."""
    sets, steps, _ = values.shape
    k, n = divmod(place, steps)
    fits = fit_sets(values, present)
    angle = 2 * np.pi * n / steps
    weight = np.zeros(sets * steps)
    design = sinusoid(steps)
    rows = present[k]
    fringes = (fits.z[k] * np.exp(1j * angle)).real
    if fits.own_mean[k]:
        row = design[n] @ np.linalg.pinv(design[rows])
        mean_part = 0.0
    else:
        row = design[n, 1:] @ np.linalg.pinv(design[rows, 1:])
        mean_part = (1 - row.sum()) ** 2 / (steps * fits.own_mean.sum())
    weight[k * steps + np.flatnonzero(rows)] = row
    variance = float((row**2).sum() + mean_part)
    frame = fits.mean[k] + fringes
    if steps > 3:
        frame = frame + (fits.second * harmonic(fits.z[k], steps, np.array([n]), 2)[0]).real
    return _Expected(frame, fringes, variance, weight)


def describe(recorded: Floats, values: Floats, present: NDArray[np.bool_], place: int, noise_dn2: float) -> Description:
    """Say what the frame at `place` shows.

    Parameters
    ----------
    recorded
        (frames, pixels) as recorded.
    values, present
        (sets, steps, pixels), (sets, steps): frames in their places, and which are trusted.
    place
        Index of the frame, counted over sets and steps.
    noise_dn2
        Variance of one value.
    """
    expected = _expected(values, present, place)
    frame = recorded[place]
    difference = frame - expected.frame
    rms = float(np.sqrt((difference**2).mean()))
    modulation = float(np.sqrt(2 * (expected.fringes**2).mean()))
    if frame.std() < FLAT * recorded.std(axis=1).max() and np.median(difference) < -0.6 * modulation:
        return Description("black", 1.0, rms)
    noise = noise_dn2 * (1 + expected.variance)
    wanted = max(float((difference**2).mean()) - noise, 1e-12)
    trials = []
    if place > 0:
        trials.append(_of_previous(recorded[place - 1], frame, expected, place, noise_dn2))
        if not present.ravel()[place - 1]:
            # The camera missed the previous frame, which may yet have been displayed.
            shown = _expected(values, present, place - 1).frame
            trials.append(_of_previous(shown, frame, expected, place, noise_dn2))
    trials += [_of_brightness(frame, expected)]
    trials += [
        (Description("duplicate", 1.0, rms, other), float(((frame - recorded[other]) ** 2).mean()))
        for other in range(recorded.shape[0])
        if other not in (place, place - 1)
    ]
    best, rest = min(trials, key=lambda t: t[1])
    if rest - noise <= EXPLAINED * wanted:
        return Description(best.kind, best.magnitude, rms, best.other)
    missing = _missing_share(frame, expected, noise_dn2)
    if place > 0:
        return Description("unexpected", missing, rms)
    # What was displayed before the first frame is not known, only how much of its own lacks.
    return Description("stale" if missing >= STALE_SHARE else "blended", missing, rms)


def _of_previous(
    previous: Floats, frame: Floats, expected: _Expected, place: int, noise_dn2: float
) -> tuple[Description, float]:
    """Share of the previous frame, freed of the bias by the noise that both sides of the fit contain."""
    towards = previous - expected.frame
    difference = frame - expected.frame
    shared = noise_dn2 * (expected.variance - expected.weight[place - 1])
    own = noise_dn2 * (1 + expected.variance - 2 * expected.weight[place - 1])
    share = ((difference * towards).mean() - shared) / max((towards**2).mean() - own, 1e-12)
    share = float(np.clip(share, 0.0, 1.0))
    rest = float(((difference - share * towards) ** 2).mean())
    return Description("stale" if share >= STALE_SHARE else "blended", share, 0.0), rest


def _of_brightness(frame: Floats, expected: _Expected) -> tuple[Description, float]:
    """One factor over the whole frame."""
    factor = float((frame * expected.frame).sum() / (expected.frame**2).sum())
    kind: FindingKind = "black" if factor < 1 - STALE_SHARE else "brightness"
    magnitude = 1.0 if kind == "black" else factor - 1
    return Description(kind, magnitude, 0.0), float(((frame - factor * expected.frame) ** 2).mean())


def _missing_share(frame: Floats, expected: _Expected, noise_dn2: float) -> float:
    """Part of the frame's own fringes that is not seen in it."""
    fringes = expected.fringes - expected.fringes.mean()
    power = max(float((fringes**2).mean()) - noise_dn2 * expected.variance, 1e-12)
    return float(np.clip(1 - (frame * fringes).mean() / power, 0.0, 1.0))
