"""Fringes and their decoding written down a second time, plainly, in float64: what the kernels are held to."""

from itertools import pairwise

import numpy as np


def fringes(counts, position, steps, mean=127.0, modulation=100.0):
    """Frames (sets, steps, H, W) float64 of points at a position (H, W) in 0..1 across the projector."""
    counts = np.asarray(counts, dtype=float)[:, None, None, None]
    shift = np.arange(steps)[:, None, None] / steps
    return mean + modulation * np.cos(2 * np.pi * (counts * position + shift))


def columns(width, height=1):
    """Positions of the projector's own columns."""
    return np.broadcast_to((np.arange(width) + 0.5) / width, (height, width))


def wrapped_turns(frames):
    steps = frames.shape[1]
    wave = np.exp(-2j * np.pi * np.arange(steps) / steps)
    sums = np.einsum("n,knvu->kvu", wave, frames.astype(float))
    return np.angle(sums) / (2 * np.pi), 2 / steps * np.abs(sums)


def optimum(frames, counts):
    """Absolute phase of the finest set in rad: every set unwrapped by itself, then their weighted mean."""
    turns, modulation = wrapped_turns(frames)
    order = np.argsort(counts)[::-1]
    finest = counts[order[0]]
    position = np.mod(turns[order[0]] - turns[order[1]], 1)
    for k in order[2:]:
        beat = turns[order[0]] - turns[k]
        scale = finest - counts[k]
        position = (beat + np.round(position * scale - beat)) / scale
    first = turns[order[0]] + np.round(position * finest - turns[order[0]])
    estimates = [first]
    for k in order[1:]:
        unwrapped = turns[k] + np.round(first * counts[k] / finest - turns[k])
        estimates.append(unwrapped * finest / counts[k])
    weights = np.square([counts[k] for k in order])
    mean = np.tensordot(weights / weights.sum(), np.array(estimates), axes=1)
    return 2 * np.pi * np.mod(mean, finest), modulation.mean(axis=0)


def hierarchical(frames, counts):
    """Absolute phase of the finest set in rad, from coarse to fine."""
    turns, modulation = wrapped_turns(frames)
    order = np.argsort(counts)
    gap = 1 - counts[order[0]]
    absolute = np.mod(turns[order[0]] + gap / 2, 1) - gap / 2
    for coarse, fine in pairwise(order):
        guess = absolute * counts[fine] / counts[coarse]
        absolute = turns[fine] + np.round(guess - turns[fine])
    return 2 * np.pi * absolute, modulation.mean(axis=0)
