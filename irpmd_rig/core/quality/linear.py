"""Linearised faults: what each would add to the frames, beside what good frames may contain.

To first order a fault adds a known pattern times one unknown number to one frame. What of the pattern is not
absorbed by each pixel's own offset, modulations and coordinate is compared with the residual of the frames by
least squares over all pixels, beside legitimate patterns: harmonics of the fringes from gamma and rounding,
drift of the light from set to set.

A memoryless response cannot pretend a blend: it makes the n-th harmonic over the steps only from harmonics
n, n +- N, ... of the phase, a blend makes it from the first.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.quality.model import common_coordinate
from irpmd_rig.core.quality.sets import SetFits, fit_sets

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Complexes = NDArray[np.complex128]
SmallKind = Literal["blended", "brightness"]

UNEVEN = 0.35
"""A set is uneven if the mean of exp(i phase) or exp(2 i phase) over the pixels is above this (the picture shows
little of a coarse fringe): harmonics and faults then look alike."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """A fault of unit size.

    Attributes
    ----------
    same
        The brightness changes by the same everywhere (ambient light).
    uneven
        The pattern is made of fringes of which the picture shows little.
    """

    kind: SmallKind
    frame: int
    same: bool = False
    uneven: bool = False

    def values(self, expected: Floats) -> Floats:
        """(pixels,) change of the frame, from (frames, pixels) as they should be."""
        frame: Floats = expected[self.frame]
        if self.kind == "blended":
            previous: Floats = expected[self.frame - 1]
            return previous - frame
        return np.full(frame.size, frame.mean()) if self.same else frame


@dataclass(frozen=True, slots=True)
class State:
    """Frames of trusted pixels beside what they should be to first order.

    Attributes
    ----------
    residual
        (pixels, frames).
    expected
        (frames, pixels).
    left
        (pixels, frames, frames): what a pixel's own unknowns leave of a pattern.
    wave
        (sets, steps, pixels): exp(i phase).
    """

    residual: Singles
    expected: Floats
    left: Singles
    wave: Complexes
    fits: SetFits
    tile: Integers
    present: NDArray[np.bool_]
    between: bool


@dataclass(frozen=True, slots=True)
class Equations:
    """Normal equations of each tile; the columns are the legitimate patterns, then the faults'."""

    gram: Floats
    right: Floats
    patterns: list[Pattern | None]


def linearise(values: Floats, present: NDArray[np.bool_], counts: Floats, tile: Integers, *, between: bool) -> State:
    """Linearise the frames about what they should be."""
    sets, steps, _ = values.shape
    fits = fit_sets(values, present)
    phase = np.angle(fits.z)
    if between:
        coordinate = common_coordinate(fits, counts)
        squares = (coordinate.tangential**2).sum(axis=0)
        # The rest have wrong orders or lie on edges.
        trusted = squares <= 16 * max(float(np.median(squares)), 1e-12)
        values, tile, phase = values[..., trusted], tile[trusted], coordinate.phase_rad[:, trusted]
        fits = fit_sets(values, present)
    wave = np.exp(1j * phase)[:, None] * np.exp(2j * np.pi * np.arange(steps) / steps)[:, None]
    known = fits.mean[:, None] + (fits.z[:, None] * np.exp(1j * (np.angle(wave) - phase[:, None]))).real
    # An absent frame is what its set says it is, so that it contributes nothing.
    values = np.where(present[..., None], values, known)
    left = _left_over(wave, counts[:, None] * np.abs(fits.z) if between else None)
    flat = values.reshape(sets * steps, -1)
    residual = (left @ flat.T[..., None].astype(np.float32))[..., 0]
    return State(residual, flat - residual.T, left, wave, fits, tile, present, between)


def _left_over(wave: Complexes, slope: Floats | None) -> Singles:
    """(pixels, frames, frames) projector onto what offset, modulations and coordinate do not absorb.

    `slope`: (sets, pixels) change of the frames with the coordinate; None: each set has phase and offset of
    its own.
    """
    sets, steps, pixels = wave.shape
    unknowns = []
    for k in range(sets):
        parts = [wave[k].real]
        if slope is None:
            parts += [wave[k].imag, np.full((steps, pixels), 0.5**0.5)]
        for part in parts:
            unknown = np.zeros(wave.shape, np.float32)
            unknown[k] = part * np.sqrt(2 / steps)
            unknowns.append(unknown)
    if slope is not None:
        pull = slope[:, None] * wave.imag
        unknowns.append((pull / np.sqrt((pull**2).sum(axis=(0, 1)))).astype(np.float32))
        unknowns.append(np.full(wave.shape, (sets * steps) ** -0.5, np.float32))
    basis = np.stack(unknowns).reshape(len(unknowns), sets * steps, pixels).transpose(2, 1, 0)
    basis = np.ascontiguousarray(basis)
    projector: Singles = np.eye(sets * steps, dtype=np.float32) - basis @ basis.transpose(0, 2, 1)
    return projector


def _legitimate(state: State) -> Singles:
    """(pixels, frames, patterns) of good frames: harmonics, also growing with the modulation, and drift."""
    modulation = np.abs(state.fits.z)
    sets, steps, pixels = state.wave.shape
    patterns = np.zeros((7 * sets, sets, steps, pixels), np.float32)
    for k in range(sets):
        second = modulation[k] * state.wave[k] ** 2
        third = modulation[k] * state.wave[k] ** 3
        relative = modulation[k] / modulation[k].mean() - 1
        parts = [second.real, second.imag, third.real, third.imag]
        parts += [relative * second.real, relative * second.imag]
        parts += [np.broadcast_to(state.fits.mean[k], second.shape)]
        patterns[7 * k : 7 * k + 7, k] = parts
    stacked = patterns.reshape(7 * sets, sets * steps, pixels).transpose(2, 1, 0)
    left: Singles = state.left @ np.ascontiguousarray(stacked)
    return left


def _fault_patterns(state: State) -> list[Pattern]:
    """Every fault that is looked for: in sets of which no frame is absent."""
    sets, steps, _ = state.wave.shape
    first = state.wave[:, 0]
    uneven = [max(abs((first[k] ** order).mean()) for order in (1, 2)) > UNEVEN for k in range(sets)]
    found = []
    for m in range(sets * steps):
        k = m // steps
        if not state.present[k].all():
            continue
        if not uneven[k]:
            found += [Pattern("brightness", m), Pattern("brightness", m, same=True)]
        if m > 0:
            found.append(Pattern("blended", m, uneven=uneven[k] or uneven[(m - 1) // steps]))
    return found


def normal_equations(state: State) -> Equations:
    """Set up the normal equations tile by tile."""
    legitimate = _legitimate(state)
    faults = _fault_patterns(state)
    pixels, frames, first = legitimate.shape
    matrix = np.empty((pixels, frames, first + len(faults) + 1), np.float32)
    matrix[..., :first] = legitimate
    for i, pattern in enumerate(faults, first):
        values = pattern.values(state.expected).astype(np.float32)
        matrix[..., i] = state.left[:, :, pattern.frame] * values[:, None]
    matrix[..., -1] = state.residual
    edges = np.concatenate([[0], np.flatnonzero(np.diff(state.tile)) + 1, [pixels]])
    grams = []
    for start, stop in pairwise(edges.tolist()):
        block = matrix[start:stop].reshape(-1, matrix.shape[2])
        grams.append(block.T @ block)
    gram = np.stack(grams).astype(np.float64)
    return Equations(gram[:, :-1, :-1], gram[:, :-1, -1], [None] * first + faults)
