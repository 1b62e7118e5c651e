"""Noise of the pixel values, from the redundancy that the frames themselves hold.

N steps are N values for three unknowns (mean, cosine, sine): what is left over is noise, but also every
harmonic of fringes that are not sinusoidal. Harmonics are smooth over the picture and noise is not, so the
leftover is taken of a mixed difference over cells of 2 x 2 pixels, (I00 - I01 - I10 + I11) / 2, which keeps
the variance and removes whatever varies along one direction only. Three steps leave nothing over:
there the disagreement of the sets (residual of the finest rung of the ladder) takes its place, and a single
set of three steps is judged by the mixed difference itself, which also holds the fringes' own curvature (along a
single row not even that: only the rounding is known).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.phase.counts import Ladder
from irpmd_rig.core.phase.results import NoiseModel

Floats = npt.NDArray[np.float32]

_SMALL_PX = 16384
_GRID = 48
_RUNS, _LIT_RUNS, _RUN_PX = 32, 96, 16
_GROUPS = 8
_FEWEST = 24
"""Samples below which a group of pixels says nothing about its variance."""
_CLIP_SIGMAS = 4.0


def sample_cells(values: npt.NDArray[Any], saturation_dn: float) -> npt.NDArray[Any]:
    """Take cells of 2 x 2 neighbours from all over the frames, most of them where there are fringes.

    Parameters
    ----------
    values
        (sets, steps, H, W), any layout.
    saturation_dn
        Places that reach this are not looked for; cells that do are left out.

    Returns
    -------
    array (sets, steps, cells, 4)
        In the order I00, I01, I10, I11: all disjoint cells of small frames, 1024 of large ones; (sets, steps,
        pixels, 1) from frames of a single row or column. Fewer where some are saturated.
    """
    height, width = values.shape[2:]
    if height < 2 or width < 2:
        v, u = np.divmod(_spread(height * width, _SMALL_PX), width)
        return _unsaturated(_taken(values, v, u)[..., None], saturation_dn)
    if height * width <= _SMALL_PX or width < _RUN_PX:
        rows = _spread(height // 2, _SMALL_PX // width + 1) * 2
        columns = np.arange(0, width - 1, 2)
        top, left = (np.ravel(grid) for grid in np.meshgrid(rows, columns, indexing="ij"))
    else:
        row, column = _places(values, saturation_dn)
        top = np.repeat(row, _RUN_PX // 2)
        left = (column[:, None] + np.arange(0, _RUN_PX, 2)).ravel()
    v = top[:, None] + np.array([0, 0, 1, 1])
    u = left[:, None] + np.array([0, 1, 0, 1])
    return _unsaturated(_taken(values, v, u), saturation_dn)


def _unsaturated(cells: npt.NDArray[Any], saturation_dn: float) -> npt.NDArray[Any]:
    if cells.max() < saturation_dn:
        return cells
    return cells[:, :, (cells < saturation_dn).all(axis=(0, 1, 3))]


def _taken(values: npt.NDArray[Any], v: npt.NDArray[np.intp], u: npt.NDArray[np.intp]) -> npt.NDArray[Any]:
    """Return ``values[..., v, u]``, several times faster where the frames are contiguous."""
    if not values.flags.c_contiguous:
        return np.asarray(values[..., v, u])
    *sets, height, width = values.shape
    return np.asarray(np.take(values.reshape(*sets, height * width), v * width + u, axis=-1))


def _spread(length: int, most: int) -> npt.NDArray[np.intp]:
    """At most so many different indices, evenly over 0..length - 1."""
    return np.linspace(0, length - 1, min(length, most)).astype(np.intp)


def _places(values: npt.NDArray[Any], saturation_dn: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows and columns where runs of cells start: some anywhere, most where the first set varies.

    An object often fills a few hundredths of the picture: cells spread evenly would hardly meet it.
    """
    height, width = values.shape[2:]
    grid = np.meshgrid(_spread(height - 1, _GRID), _spread(width - _RUN_PX + 1, _GRID), indexing="ij")
    row, column = (np.ravel(g) for g in grid)
    looked_at = _taken(values[0], row, column)
    top = looked_at.max(axis=0).astype(np.float32)
    swing = np.where(top < saturation_dn, top - looked_at.min(axis=0), 0)
    strong = np.partition(swing, -(swing.size // 100) - 1)[-(swing.size // 100) - 1]
    lit = np.flatnonzero(swing >= 0.5 * strong)
    chosen = np.concatenate([_spread(swing.size, _RUNS), lit[_spread(lit.size, _LIT_RUNS)]])
    return row[chosen], column[chosen]


def estimate_noise(cells: Floats, rungs: Ladder, least_variance: float) -> NoiseModel:
    """Fit sigma_I^2 = floor + slope A, A the mean over the steps, to sampled cells.

    Parameters
    ----------
    cells
        (sets, steps, cells, 4 or 1) as `sample_cells` takes them, none saturated.
    rungs
        Ladder of the sets; used for three steps only.
    least_variance
        The floor is not let below this: a whole number cannot be better known than 1/12 DN^2 (rounding), a
        float32 than its own rounding.

    Notes
    -----
    Variances are taken in up to 8 groups of equal width in A, without what lies beyond 4 sigma (edges of the
    object). The slope is never negative, and zero unless it exceeds twice its own standard
    error: with constant noise, or a single mean, all of it is floor.
    """
    leftover, mean, modulation = _redundancy(cells, rungs)
    if leftover.size == 0:
        return NoiseModel(least_variance, 0.0)
    floor, slope = _transfer(leftover, np.maximum(mean, 0), least_variance)
    return NoiseModel(floor, slope, *_light(mean, modulation))


def _light(mean: Floats, modulation: Floats) -> tuple[float, float]:
    """Line A = dark + light B through the cells; more fringes never come with less light."""
    middle_a, middle_b = float(mean.mean()), float(modulation.mean())
    spread = float(np.sum((modulation - middle_b) ** 2))
    light = float(np.sum((modulation - middle_b) * (mean - middle_a))) / spread if spread > 0 else 0.0
    light = max(light, 0.0)
    dark = middle_a - light * middle_b
    if dark >= 0:
        return dark, light
    return 0.0, max(middle_a, 0.0) / max(middle_b, 1e-30)


def _transfer(leftover: Floats, light: Floats, least_variance: float) -> tuple[float, float]:
    """Floor and slope of the variance over the light: the photon transfer of the camera."""
    width = max(float(light.max()), 1e-30) / _GROUPS
    group = np.minimum((light / width).astype(np.intp), _GROUPS - 1)
    number = np.bincount(group, minlength=_GROUPS)
    if number.max() < _FEWEST:
        group[:] = 0
        number = np.bincount(group, minlength=_GROUPS)
    variance = _robust_variances(leftover, group, least_variance)
    strength = np.bincount(group, light, minlength=_GROUPS) / np.maximum(number, 1)
    used = number >= min(_FEWEST, number.max())
    return _fit(strength[used], variance[used], number[used], least_variance)


def _redundancy(cells: Floats, rungs: Ladder) -> tuple[Floats, Floats, Floats]:
    """Return samples of noise (each of variance sigma_I^2), and the mean and modulation that go with each."""
    sets, steps = cells.shape[:2]
    angles = 2 * np.pi * np.arange(steps) / steps
    basis = np.stack([np.ones(steps), np.cos(angles), np.sin(angles)])
    flat = cells.reshape(sets, steps, -1)
    waves = (basis[1:].astype(np.float32) @ flat).reshape(sets, 2, *cells.shape[2:])
    modulation = np.sqrt(waves[:, 0] ** 2 + waves[:, 1] ** 2) * np.float32(2 / steps)
    mean = (flat.sum(axis=1) / np.float32(steps)).reshape(sets, *cells.shape[2:])
    if steps == 3 and sets > 1:
        phase = np.arctan2(-waves[:, 1], waves[:, 0]).astype(np.float64) / (2 * np.pi)
        residual = _last_residual(phase, rungs) / rungs.amplifications[-1] * 2 * np.pi
        local = modulation.mean(axis=0)
        # sigma_phi = sqrt(2 / N) sigma_I / B, solved for sigma_I.
        noise = _mixed(residual * local * np.sqrt(steps / 2))
        return noise.astype(np.float32).ravel(), mean.mean(axis=(0, -1)), local.mean(axis=-1)
    nothing = np.empty(0, np.float32)
    if steps == 3 and cells.shape[-1] == 1:
        return nothing, nothing, nothing
    mixed = _mixed(cells)
    if steps > 3:
        null_space = np.linalg.svd(basis)[2][3:].astype(np.float32)
        mixed = null_space @ mixed
    mean, modulation = (
        np.broadcast_to(each.mean(axis=-1)[:, None], mixed.shape).ravel() for each in (mean, modulation)
    )
    return mixed.ravel(), mean, modulation


def _mixed(cells: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    if cells.shape[-1] == 1:
        return cells[..., 0]
    return np.asarray((cells[..., 0] - cells[..., 1] - cells[..., 2] + cells[..., 3]) / 2)


def _last_residual(phase: npt.NDArray[np.float64], rungs: Ladder) -> npt.NDArray[np.float64]:
    """Climb the ladder to the rounding residual of the finest rung; ``phase`` (sets, ...), all in turns."""
    finest = phase[rungs.sets[-1]]
    steps = [finest - phase[k] if rungs.beats else phase[k] for k in rungs.sets[:-1]] + [finest]
    absolute = steps[0] + (steps[0] < rungs.lowest_turns)
    residual = absolute
    for ratio, rung in zip(rungs.ratios, steps[1:], strict=True):
        guess = ratio * absolute - rung
        residual = guess - np.rint(guess)
        absolute = np.rint(guess) + rung
    return np.asarray(residual)


def _robust_variances(samples: Floats, group: npt.NDArray[np.intp], least: float) -> npt.NDArray[np.float64]:
    """Variance of each group without what lies beyond 4 sigma, from the mean size of the samples on."""
    square = samples**2
    number = np.bincount(group, minlength=_GROUPS)
    mean_size = np.bincount(group, np.abs(samples), minlength=_GROUPS) / np.maximum(number, 1)
    variance = np.maximum(np.pi / 2 * mean_size**2, least)
    for _ in range(3):
        kept = square <= (_CLIP_SIGMAS**2 * variance).astype(np.float32)[group]
        members = group[kept]
        number = np.bincount(members, minlength=_GROUPS)
        total = np.bincount(members, square[kept], minlength=_GROUPS)
        variance = np.maximum(total / np.maximum(number, 1), least)
    return np.asarray(variance)


def _fit(
    strength: npt.NDArray[np.float64],
    variance: npt.NDArray[np.float64],
    number: npt.NDArray[np.intp],
    least: float,
) -> tuple[float, float]:
    weight = number / variance**2 / 2
    total = weight.sum()
    centre = (weight * strength).sum() / total
    mean = float((weight * variance).sum() / total)
    spread = (weight * (strength - centre) ** 2).sum()
    if spread > 0:
        slope = float((weight * (strength - centre) * variance).sum() / spread)
        if slope > 2 / np.sqrt(spread):
            floor = mean - slope * float(centre)
            if floor >= least:
                return floor, slope
            through = (weight * strength * (variance - least)).sum() / (weight * strength**2).sum()
            return least, max(float(through), 0.0)
    return max(mean, least), 0.0
