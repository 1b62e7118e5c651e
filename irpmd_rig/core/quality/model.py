"""How well frames agree with what fringes must be: the misfit of a hypothesis about their order.

Two redundancies exist. Within a set of more than three steps the frames must lie on one sinusoid a pixel.
Between sets the means must agree and the phases must belong to one projector coordinate. Global harmonics
of the fringes (gamma of projector or camera, rounding) are legitimate and are regressed out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.quality.sets import OneSet, SetFits, fit_sets, regress_out

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TRIMMED_SHARE = 0.9
"""The worst tenth of the pixels does not count: edges of objects mix two surfaces."""

ORDERS_AT_ONCE = 2**24
"""Pixels times fringe orders that are compared at a time: 64 MiB of float32."""

PHASES_AGREE = 0.3
"""Ratio of the squared phase disagreement to that of chance below which the orders are trusted."""


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
    parts = np.array_split(left, -(-left.shape[0] * orders.size // ORDERS_AT_ONCE))
    order = np.concatenate([np.argmax(part @ right, axis=1) for part in parts])
    phase = ratio[:, None] * (fine_phase + 2 * np.pi * order)
    difference = np.angle(unit * np.exp(-1j * phase))
    weight = np.where(fits.used, 1 / np.sqrt(fits.z_variance), 0.0)[:, None] * modulation
    pull = weight * ratio[:, None]
    shift = (pull * weight * difference).sum(axis=0) / np.maximum((pull**2).sum(axis=0), 1e-12)
    return Coordinate(
        phase_rad=sign * (phase + ratio[:, None] * shift),
        tangential=weight * (difference - ratio[:, None] * shift),
    )


def _tangential_rest(fits: SetFits, coordinate: Coordinate) -> Floats:
    """Phase disagreement without what harmonics of the fringes make of it."""
    rest = coordinate.tangential.copy()
    for k in np.flatnonzero(fits.used):
        if fits.aliased[k]:
            rest[k], _ = regress_out(rest[k], list(fits.aliased[k]))
    return rest


def _mean_rest(fits: SetFits) -> Floats:
    """Disagreement of the sets' means for unit noise; harmonics and a drift of the light are allowed."""
    weight = np.where(fits.own_mean, 1 / fits.mean_variance, 0.0)[:, None]
    common = (weight * fits.mean).sum(axis=0) / weight.sum()
    rest: Floats = np.sqrt(weight) * (fits.mean - common)
    for k in np.flatnonzero(fits.own_mean):
        rest[k], _ = regress_out(rest[k], [common, *fits.aliased[k]])
    return rest


def misfit(
    values: Floats, present: Bools, counts: Floats, *, between: bool, known: dict[int, OneSet] | None = None
) -> Misfit | None:
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
    known
        Sets that were fitted before.
    """
    fits = fit_sets(values, present, known)
    freedom = fits.freedom
    squares = fits.squares
    if between and fits.used.sum() >= 2:
        coordinate = common_coordinate(fits, counts)
        squares = squares + (_tangential_rest(fits, coordinate) ** 2).sum(axis=0)
        squares = squares + (_mean_rest(fits) ** 2).sum(axis=0)
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
    fits = fit_sets(values, present)
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
