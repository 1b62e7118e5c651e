"""How well frames agree with what fringes must be: the misfit of a hypothesis about their order.

Two redundancies exist. Within a set of more than three steps the frames must lie on one sinusoid a pixel.
Between sets the means must agree and the phases must belong to one projector coordinate. Global harmonics
of the fringes (gamma of projector or camera, rounding) are legitimate and are regressed out.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

TRIMMED_SHARE = 0.9
"""The worst tenth of the pixels does not count: edges of objects mix two surfaces."""

PHASES_AGREE = 0.3
"""Ratio of the squared phase disagreement to that of chance below which the orders are trusted."""


@dataclass(frozen=True, slots=True)
class SetFits:
    """Sinusoids fitted to each set from the frames present.

    Attributes
    ----------
    mean, z
        (sets, pixels): offset A and B exp(i phase) (DN).
    residual
        (sets, steps, pixels), zero where a frame is absent.
    used
        (sets,): sets whose phase is known: three frames, or two and the mean of the other sets.
    own_mean
        (sets,): sets whose mean is known from their own frames.
    mean_variance, z_variance
        (sets,): variance of A, and of either part of z, for unit noise.
    spare
        (sets,): frames beyond the three that a sinusoid needs.
    """

    mean: Floats
    z: Complexes
    residual: Floats
    used: Bools
    own_mean: Bools
    mean_variance: Floats
    z_variance: Floats
    spare: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One projector coordinate for all sets.

    Attributes
    ----------
    phase_rad
        (sets, pixels): phase of each set that the common coordinate asks for.
    tangential
        (sets, pixels): B times the difference of the measured phase to that, divided by its sigma for unit
        noise; zero for sets that are not used.
    """

    phase_rad: Floats
    tangential: Floats


@dataclass(frozen=True, slots=True)
class Misfit:
    """Squared disagreement of each pixel (DN^2, noise counted once a degree of freedom).

    Attributes
    ----------
    squares
        (pixels,), not divided by the degrees of freedom.
    freedom
        Degrees of freedom a pixel.
    complete
        Whether the phase of every set is known.
    """

    squares: Floats
    freedom: int
    complete: bool

    def clipped(self) -> Floats:
        """Squares a degree of freedom, the worst tenth of the pixels held at the 90 % quantile."""
        limit = np.quantile(self.squares, TRIMMED_SHARE)
        return np.minimum(self.squares, limit) / self.freedom

    def variance_dn2(self) -> float:
        """Robust variance a degree of freedom: from the median, by the Wilson-Hilferty formula."""
        nu = self.freedom
        return float(np.median(self.squares)) / (nu * (1 - 2 / (9 * nu)) ** 3)


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


def fit_sets(values: Floats, present: Bools) -> SetFits:
    """Fit the sinusoids of (sets, steps, pixels) to the frames that are present."""
    sets, steps, pixels = values.shape
    mean, residual = np.zeros((sets, pixels)), np.zeros_like(values)
    z = np.zeros((sets, pixels), np.complex128)
    number = present.sum(axis=1)
    mean_variance, z_variance = np.ones(sets), np.ones(sets)
    own_mean = number >= 3
    for k in np.flatnonzero(own_mean):
        rows = np.flatnonzero(present[k])
        matrix, inverse, variance = _solver(steps, tuple(rows.tolist()), 3)
        recorded = values[k, rows]
        coefficients = inverse @ recorded
        mean[k] = coefficients[0]
        z[k] = coefficients[1] + 1j * coefficients[2]
        if rows.size > 3:
            residual[k, rows] = recorded - matrix @ coefficients
        mean_variance[k], z_variance[k] = variance[0], variance[1:].mean()
    used = own_mean.copy()
    for k in np.flatnonzero(number == 2) if own_mean.any() else ():
        rows = np.flatnonzero(present[k])
        matrix, inverse, variance = _solver(steps, tuple(rows.tolist()), 2)
        if np.linalg.cond(matrix) > 1e6:
            continue
        mean[k] = mean[own_mean].mean(axis=0)
        z[k] = np.array([1, 1j]) @ (inverse @ (values[k, rows] - mean[k]))
        z_variance[k] = variance.mean() * (1 + mean_variance[own_mean].mean() / own_mean.sum())
        used[k] = True
    return SetFits(mean, z, residual, used, own_mean, mean_variance, z_variance, number - 3)


def _regress_out(target: Floats, columns: list[Floats]) -> tuple[Floats, Floats]:
    """Target minus its least-squares combination of columns, all of one shape; and the coefficients."""
    matrix = np.stack([c.ravel() for c in columns])
    gram = matrix @ matrix.T
    # A ridge of rounding size keeps columns that happen to be alike solvable.
    gram[np.diag_indices(len(columns))] += 1e-9 * np.trace(gram) + 1e-30
    solution: Floats = np.asarray(np.linalg.solve(gram, matrix @ target.ravel()), np.float64)
    rest: Floats = np.asarray(target.ravel() - solution @ matrix).reshape(target.shape)
    return rest, solution


def harmonic(z: Complexes, steps: int, rows: NDArray[np.int64], order: int) -> Complexes:
    """(frames, pixels): B exp(i order phase) of some frames of a set."""
    modulation = np.abs(z)
    rotor = np.exp(2j * np.pi * rows / steps)[:, None]
    wave: Complexes = modulation * (z / np.where(modulation > 0, modulation, 1.0) * rotor) ** order
    return wave


def without_harmonics(fits: SetFits, present: Bools) -> tuple[Floats, complex]:
    """Remove the fringes' second (from six steps on also third) harmonic from the residuals within the sets.

    Returns
    -------
    rest
        (sets, steps, pixels).
    second
        Mean second harmonic of the complete sets as a share of the modulation, zero if there is none.
    """
    rest = fits.residual.copy()
    steps = present.shape[1]
    seconds = []
    for k in np.flatnonzero(fits.spare >= 1):
        rows = np.flatnonzero(present[k])
        matrix, inverse, _ = _solver(steps, tuple(rows.tolist()), 3)
        maker = np.eye(rows.size) - matrix @ inverse
        columns = []
        for order in (2, 3) if steps >= 6 else (2,):
            wave = maker @ harmonic(fits.z[k], steps, rows, order)
            columns += [wave.real, wave.imag]
        rest[k, rows], shares = _regress_out(fits.residual[k, rows], columns)
        if rows.size == steps:
            seconds.append(complex(shares[0], -shares[1]))
    return rest, complex(np.mean(seconds)) if seconds else 0j


def refit_incomplete(values: Floats, present: Bools, fits: SetFits) -> SetFits:
    """Fit again after the second harmonic seen in complete sets is taken out of incomplete ones.

    In a complete set of four steps or more it does not disturb the sinusoid; in one that lacks a frame it does.
    """
    steps = present.shape[1]
    full = present.all(axis=1)
    if steps < 4 or full.all() or not full.any():
        return fits
    second = without_harmonics(fits, present)[1]
    for _ in range(2):
        cleaned = values.copy()
        for k in np.flatnonzero(~full & fits.used):
            cleaned[k] -= (second * harmonic(fits.z[k], steps, np.arange(steps), 2)).real
        fits = fit_sets(cleaned, present)
    return fits


def common_coordinate(fits: SetFits, counts: Floats) -> Coordinate:
    """Find each pixel's projector coordinate: the fringe order at which all sets' phases agree best.

    The orders of the finest set are tried all at once: the sum over the sets of cos(phase - asked phase)
    is a matrix product. It serves the closed-form sets and the coarse-to-fine ones alike.

    Negative counts: the phase falls with the coordinate (the steps subtract 2 pi n / N).
    """
    sign = float(np.sign(counts[0]))
    counts = np.abs(counts)
    used = np.flatnonzero(fits.used)
    finest = used[np.argmax(counts[used])]
    ratio = counts / counts[finest]
    modulation = np.abs(fits.z)
    unit = (fits.z.real + 1j * sign * fits.z.imag) / np.maximum(modulation, 1e-30)
    fine_phase = np.mod(np.angle(unit[finest]), 2 * np.pi)
    orders = np.arange(int(np.ceil(counts[finest] - 1e-9)))
    others = used[used != finest]
    turned = np.stack([unit[k] * np.exp(-1j * ratio[k] * fine_phase) for k in others])
    asked = 2 * np.pi * ratio[others, None] * orders
    # float32: only the place of the largest sum matters.
    left = np.concatenate([turned.real, turned.imag]).T.astype(np.float32)
    right = np.concatenate([np.cos(asked), np.sin(asked)]).astype(np.float32)
    order = np.argmax(left @ right, axis=1)
    phase = ratio[:, None] * (fine_phase + 2 * np.pi * order)
    difference = np.angle(unit * np.exp(-1j * phase))
    weight = np.where(fits.used, 1 / np.sqrt(fits.z_variance), 0.0)[:, None] * modulation
    pull = weight * ratio[:, None]
    shift = (pull * weight * difference).sum(axis=0) / np.maximum((pull**2).sum(axis=0), 1e-12)
    return Coordinate(
        phase_rad=sign * (phase + ratio[:, None] * shift),
        tangential=weight * (difference - ratio[:, None] * shift),
    )


def _aliased(fits: SetFits, k: int, steps: int) -> list[Floats]:
    """Patterns that the harmonics next to the number of steps leave in mean and phase of a full set."""
    if fits.spare[k] != steps - 3:
        return []
    wave = np.abs(fits.z[k]) * np.exp(1j * steps * np.angle(fits.z[k]))
    return [wave.real, wave.imag]


def _tangential_rest(fits: SetFits, coordinate: Coordinate, steps: int) -> Floats:
    """Phase disagreement without what harmonics of the fringes make of it."""
    rest = coordinate.tangential.copy()
    for k in np.flatnonzero(fits.used):
        columns = _aliased(fits, int(k), steps)
        if columns:
            rest[k], _ = _regress_out(rest[k], columns)
    return rest


def _mean_rest(fits: SetFits, steps: int) -> Floats:
    """Disagreement of the sets' means for unit noise; harmonics and a drift of the light are allowed."""
    weight = np.where(fits.own_mean, 1 / fits.mean_variance, 0.0)[:, None]
    common = (weight * fits.mean).sum(axis=0) / weight.sum()
    rest: Floats = np.sqrt(weight) * (fits.mean - common)
    for k in np.flatnonzero(fits.own_mean):
        rest[k], _ = _regress_out(rest[k], [common, *_aliased(fits, int(k), steps)])
    return rest


def misfit(values: Floats, present: Bools, counts: Floats, *, between: bool) -> Misfit | None:
    """Disagreement of frames with fringes; None if the frames present leave no redundancy.

    Parameters
    ----------
    values
        (sets, steps, pixels) in the places where the hypothesis puts them (DN).
    present
        (sets, steps): frames that the hypothesis keeps.
    counts
        Fringe counts of the sets.
    between
        Whether the sets' counts tie their phases.
    """
    fits = refit_incomplete(values, present, fit_sets(values, present))
    freedom = int(np.maximum(fits.spare, 0).sum())
    squares = (without_harmonics(fits, present)[0] ** 2).sum(axis=(0, 1))
    if between and fits.used.sum() >= 2:
        coordinate = common_coordinate(fits, counts)
        squares += (_tangential_rest(fits, coordinate, values.shape[1]) ** 2).sum(axis=0)
        squares += (_mean_rest(fits, values.shape[1]) ** 2).sum(axis=0)
        freedom += int(fits.used.sum()) + int(fits.own_mean.sum()) - 2
    return Misfit(squares, freedom, bool(fits.used.all())) if freedom > 0 else None


@dataclass(frozen=True, slots=True)
class PhaseAgreement:
    """How well the sets' phases agree on one coordinate.

    Attributes
    ----------
    good
        They agree clearly better than phases of different pixels would.
    share_of_chance
        Squared disagreement over that of different pixels (medians).
    contradiction
        (pixels,) by how much they disagree more than they should, where they do not agree although noise and
        counts would let them; otherwise None.
    """

    good: bool
    share_of_chance: float
    contradiction: Floats | None


def phase_agreement(values: Floats, present: Bools, counts: Floats, noise_dn: float) -> PhaseAgreement:
    """Compare the disagreement of the sets' phases with that of chance.

    It is not good when the counts do not determine each other (two sets alone often do not), when the noise
    hides the orders (neither is a contradiction), or when the frames are wrong.
    """
    fits = refit_incomplete(values, present, fit_sets(values, present))
    number = int(fits.used.sum())
    if number < 2:
        return PhaseAgreement(good=False, share_of_chance=1.0, contradiction=None)
    rng = np.random.default_rng(0)
    mixed = replace(fits, z=np.stack([rng.permutation(z) for z in fits.z]))
    seen, chance = ((common_coordinate(f, counts).tangential ** 2).sum(axis=0) for f in (fits, mixed))
    limit = PHASES_AGREE * float(np.median(chance))
    good = float(np.median(seen)) < limit
    knowable = noise_dn**2 * (number - 1) < 0.5 * limit
    return PhaseAgreement(
        good=good,
        share_of_chance=float(np.median(seen) / max(float(np.median(chance)), 1e-12)),
        contradiction=seen - limit if knowable and not good else None,
    )
