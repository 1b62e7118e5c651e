"""Sinusoids through the frames of each set, and what harmonics of the fringes leave beside them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class OneSet:
    """Sinusoid through three or more frames of one set.

    Attributes
    ----------
    mean, z
        (pixels,): offset A and B exp(i phase) (DN).
    squares
        (pixels,): squared residuals after the second (from five steps on also third) harmonic is removed.
    second
        Second harmonic as a share of the modulation; None if the set is not complete or has three steps.
    aliased
        Patterns (pixels,) that the harmonics next to the number of steps leave in mean and phase; none if the
        set is not complete.
    """

    mean: Floats
    z: Complexes
    squares: Floats
    second: complex | None
    aliased: tuple[Floats, ...]


@dataclass(frozen=True, slots=True)
class SetFits:
    """Sinusoids of all sets.

    Attributes
    ----------
    mean, z
        (sets, pixels): offset A and B exp(i phase) (DN).
    squares
        (pixels,): squared residuals within all sets.
    used
        (sets,): sets whose phase is known: three frames, or two and the mean of the other sets.
    own_mean
        (sets,): sets whose mean is known from their own frames.
    mean_variance, z_variance
        (sets,): variance of A, and of either part of z, for unit noise.
    freedom
        Degrees of freedom within the sets.
    second
        Mean second harmonic of the complete sets as a share of the modulation.
    aliased
        See `OneSet`, one entry a set.
    """

    mean: Floats
    z: Complexes
    squares: Floats
    used: Bools
    own_mean: Bools
    mean_variance: Floats
    z_variance: Floats
    freedom: int
    second: complex
    aliased: tuple[tuple[Floats, ...], ...]


def sinusoid(steps: int) -> Floats:
    """Build the (steps, 3) matrix of A, Re z, Im z in I_n = A + Re(z exp(2 pi i n / N))."""
    angle = 2 * np.pi * np.arange(steps) / steps
    return np.stack([np.ones(steps), np.cos(angle), -np.sin(angle)], axis=1)


@lru_cache(maxsize=1024)
def _solver(steps: int, rows: tuple[int, ...], unknowns: int) -> tuple[Floats, Floats, Floats]:
    """Compute design, pseudo-inverse and variances for some frames; with two unknowns the mean is known."""
    matrix = sinusoid(steps)[list(rows)][:, 3 - unknowns :]
    inverse: Floats = np.asarray(np.linalg.pinv(matrix), np.float64)
    variances: Floats = np.asarray(np.diag(np.linalg.pinv(matrix.T @ matrix)), np.float64)
    return matrix, inverse, variances


def harmonic(z: Complexes, steps: int, rows: Integers, order: int) -> Complexes:
    """(frames, pixels): B exp(i order phase) of some frames of a set."""
    modulation = np.abs(z)
    unit = z / np.maximum(modulation, 1e-30)
    wave: Complexes = (modulation * unit**order) * np.exp(2j * np.pi * order * rows / steps)[:, None]
    return wave


def regress_out(target: Floats, columns: list[Floats]) -> tuple[Floats, Floats]:
    """Target minus its least-squares combination of columns, all of one shape; and the coefficients."""
    flat = [c.ravel() for c in columns]
    gram = np.array([[a @ b for a in flat] for b in flat])
    # A ridge of rounding size keeps columns that happen to be alike solvable.
    gram[np.diag_indices(len(flat))] += 1e-9 * np.trace(gram) + 1e-30
    wanted = target.ravel()
    solution: Floats = np.asarray(np.linalg.solve(gram, np.array([c @ wanted for c in flat])), np.float64)
    rest = target - sum(share * column for share, column in zip(solution, columns, strict=True))
    return rest, solution


def fit_one(values: Floats, rows: tuple[int, ...]) -> OneSet:
    """Fit the frames `rows`, at least three, of one set (steps, pixels)."""
    steps, pixels = values.shape
    matrix, inverse, _ = _solver(steps, rows, 3)
    recorded = values[list(rows)]
    coefficients = inverse @ recorded
    z = coefficients[1] + 1j * coefficients[2]
    squares, second = np.zeros(pixels), None
    if len(rows) > 3:
        maker = np.eye(len(rows)) - matrix @ inverse
        columns = []
        for order in (2, 3) if steps >= 5 else (2,):
            wave = maker @ harmonic(z, steps, np.array(rows), order)
            columns += [wave.real, wave.imag]
        rest, shares = regress_out(recorded - matrix @ coefficients, columns)
        squares = np.einsum("np,np->p", rest, rest)
        second = complex(shares[0], -shares[1]) if len(rows) == steps else None
    aliased: tuple[Floats, ...] = ()
    if len(rows) == steps:
        wave = harmonic(z, steps, np.array([0]), steps)[0]
        aliased = (wave.real, wave.imag)
    return OneSet(coefficients[0], z, squares, second, aliased)


def fit_sets(values: Floats, present: Bools, known: dict[int, OneSet] | None = None) -> SetFits:
    """Fit the sinusoids of (sets, steps, pixels) to the frames that are present.

    The second harmonic seen in complete sets is first taken out of those that lack a frame: a complete set of
    four steps or more is not disturbed by it, one that lacks a frame is.

    Parameters
    ----------
    values, present
        (sets, steps, pixels), (sets, steps).
    known
        Sets that were fitted before.
    """
    sets, steps, pixels = values.shape
    rows = [tuple(np.flatnonzero(p).tolist()) for p in present]
    ones = dict(known or {})
    for k in range(sets):
        if k not in ones and len(rows[k]) >= 3:
            ones[k] = fit_one(values[k], rows[k])
    seconds = [one.second for one in ones.values() if one.second is not None]
    second = complex(np.mean(seconds)) if seconds else 0j
    for k, one in ones.items():
        if seconds and len(rows[k]) < steps:
            ones[k] = _cleaned(values[k], rows[k], one, second)
    mean, z = np.zeros((sets, pixels)), np.zeros((sets, pixels), np.complex128)
    mean_variance, z_variance = np.ones(sets), np.ones(sets)
    for k, one in ones.items():
        mean[k], z[k] = one.mean, one.z
        variance = _solver(steps, rows[k], 3)[2]
        mean_variance[k], z_variance[k] = variance[0], variance[1:].mean()
    own_mean = np.array([k in ones for k in range(sets)])
    used = own_mean.copy()
    for k in range(sets):
        if ones and len(rows[k]) == 2:
            common = mean[own_mean].mean(axis=0)
            used[k], mean[k] = _two_frames(values[k], rows[k], common, second, z[k]), common
            variance = _solver(steps, rows[k], 2)[2]
            z_variance[k] = variance.mean() * (1 + mean_variance[own_mean].mean() / own_mean.sum())
    return SetFits(
        mean,
        z,
        np.sum([one.squares for one in ones.values()], axis=0) if ones else np.zeros(pixels),
        used,
        own_mean,
        mean_variance,
        z_variance,
        sum(len(rows[k]) - 3 for k in ones),
        second,
        tuple(ones[k].aliased if k in ones else () for k in range(sets)),
    )


def _cleaned(values: Floats, rows: tuple[int, ...], one: OneSet, second: complex) -> OneSet:
    """Fit an incomplete set again without the second harmonic of the others."""
    steps = values.shape[0]
    for _ in range(2):
        one = fit_one(values - (second * harmonic(one.z, steps, np.arange(steps), 2)).real, rows)
    return one


def _two_frames(values: Floats, rows: tuple[int, ...], mean: Floats, second: complex, z: Complexes) -> bool:
    """Fill in z from two frames of a set and a known mean; False if they are half a period apart."""
    matrix, inverse, _ = _solver(values.shape[0], rows, 2)
    if np.linalg.cond(matrix) > 1e6:
        return False
    recorded = values[list(rows)] - mean
    z[:] = np.array([1, 1j]) @ (inverse @ recorded)
    for _ in range(2):
        wave = (second * harmonic(z, values.shape[0], np.array(rows), 2)).real
        z[:] = np.array([1, 1j]) @ (inverse @ (recorded - wave))
    return True
