"""What takes time: a display until its light is there, a stage until it is at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError

Floats = NDArray[np.float64]

ALL_FRACTION = 0.98
"""Share of the light from which on all of it counts as there."""

_LIT_DN = 10.0
_FEWEST_PX = 500
_REST_SHARE = 1 / 3


@dataclass(frozen=True, slots=True, eq=False)
class DisplayDelay:
    """Light of a picture after the order to show it.

    Attributes
    ----------
    after_s : ndarray, (n,)
        Time from the order to the frame, rising.
    light : ndarray, (n,)
        Share of the light that was there.
    before_s, until_s : float
        All of the light is there between these two times after the order: it was not yet at the first (0 where it
        always was), it was from the second on.
    """

    after_s: Floats
    light: Floats
    before_s: float
    until_s: float


def display_delay(after_s: NDArray[np.floating], light: NDArray[np.floating]) -> DisplayDelay:
    """Find when all light of a picture is there.

    Parameters
    ----------
    after_s, light : ndarray, (n,)
        Time after the order, and share of the light (`light_share`).

    Returns
    -------
    DisplayDelay
        See there.

    Raises
    ------
    CalibrationError
        It is not there at the last time either.
    """
    order = np.argsort(after_s)
    times, shares = np.asarray(after_s, dtype=np.float64)[order], np.asarray(light, dtype=np.float64)[order]
    lacking = np.flatnonzero(shares < ALL_FRACTION)
    if lacking.size and lacking[-1] == shares.size - 1:
        raise CalibrationError(
            f"{1e3 * times[-1]:.0f} ms after the order only {100 * shares[-1]:.0f} % of the light is there: "
            "give longer delays"
        )
    last = -1 if lacking.size == 0 else int(lacking[-1])
    return DisplayDelay(times, shares, 0.0 if last < 0 else float(times[last]), float(times[last + 1]))


def light_share(frame: NDArray[np.generic], black: NDArray[np.generic], white: NDArray[np.generic]) -> float:
    """Share of a white picture's light in a frame, over the lit pixels; all (H, W).

    Raises
    ------
    CalibrationError
        White is no brighter than black.
    """
    dark = black.astype(np.float64)
    swing = white.astype(np.float64) - dark
    lit = swing > max(_LIT_DN, 0.2 * float(np.percentile(swing, 99)))
    if np.count_nonzero(lit) < _FEWEST_PX:
        raise CalibrationError("a white picture is no brighter than a black one: check light and placement")
    return float((frame.astype(np.float64)[lit] - dark[lit]).sum() / swing[lit].sum())


@dataclass(frozen=True, slots=True, eq=False)
class Settling:
    """A stage after its controller said that the motion has ended.

    Attributes
    ----------
    after_s : ndarray, (n,)
        Time since then.
    off_mm : ndarray, (n,)
        Distance from where it comes to rest.
    sigma_mm : float
        One sigma of these, by the scatter at rest.
    settle_s : float
        Time from which on it stays within the limit; NaN where it does not come to rest.
    """

    after_s: Floats
    off_mm: Floats
    sigma_mm: float
    settle_s: float


def settling(after_s: NDArray[np.floating], off_mm: NDArray[np.floating], still_mm: float) -> Settling:
    """Find when a stage is at rest.

    Parameters
    ----------
    after_s, off_mm : ndarray, (n,)
        Times, and the stage's place at these (`stage_offset_mm`).
    still_mm : float
        Movement that counts as rest.
    """
    times = np.asarray(after_s, dtype=np.float64)
    tail = max(3, int(times.size * _REST_SHARE))
    off = np.asarray(off_mm, dtype=np.float64) - float(np.mean(off_mm[-tail:]))
    moving = np.flatnonzero(np.abs(off) > still_mm)
    settle_s = float(times[0]) if moving.size == 0 else float("nan")
    if moving.size and moving[-1] < times.size - tail:
        settle_s = float(times[moving[-1] + 1])
    return Settling(times, off, float(np.std(off[-tail:])), max(settle_s, 0.0) if settle_s == settle_s else settle_s)


def stage_offset_mm(
    frame: NDArray[np.generic],
    wrapped_rad: NDArray[np.floating],
    modulation_dn: NDArray[np.floating],
    mean_dn: NDArray[np.floating],
    phase_a_mm: NDArray[np.floating],
) -> float:
    """Distance along the stage at which a frame of one fringe picture was taken from where its phase was measured.

    Parameters
    ----------
    frame : ndarray, (H, W)
        Frame of the fringe picture of step 0.
    wrapped_rad, modulation_dn, mean_dn : ndarray, (H, W)
        Phase, modulation and mean of these fringes at rest.
    phase_a_mm : ndarray, (H, W)
        Growth of this phase with the stage, rad/mm; NaN where not known.

    Returns
    -------
    float
        mm; for distances over which the phase changes by much less than a period.

    Raises
    ------
    CalibrationError
        Too few pixels see fringes.

    Notes
    -----
    I = k (A + B cos(phi + g u)): linear least squares for u and for the brightness k, which a lamp may change.
    """
    known = np.isfinite(phase_a_mm) & (modulation_dn > _LIT_DN)
    if np.count_nonzero(known) < _FEWEST_PX:
        raise CalibrationError("too few pixels see the fringes at both positions: check light and placement")
    at_rest = mean_dn[known] + modulation_dn[known] * np.cos(wrapped_rad[known])
    moved = -modulation_dn[known] * np.sin(wrapped_rad[known]) * phase_a_mm[known]
    design = np.stack([at_rest, moved], axis=1).astype(np.float64)
    solution = np.linalg.solve(design.T @ design, design.T @ frame[known].astype(np.float64))
    return float(solution[1] / solution[0])
