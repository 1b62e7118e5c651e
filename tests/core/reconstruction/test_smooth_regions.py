"""Regions without a jump of the phase: what a slope may be taken over."""

import numpy as np

from irpmd_rig.core.reconstruction.smooth_regions import smooth_regions
from irpmd_rig.core.reconstruction.views import Views

SHAPE = (40, 60)


def views(*phases: np.ndarray) -> Views:
    sigmas = tuple(np.full(SHAPE, 0.01, np.float32) for _ in phases)
    window = slice(0, SHAPE[0]), slice(0, SHAPE[1])
    return Views(tuple(20.0 * k for k in range(len(phases))), phases, sigmas, window)


def ramp() -> np.ndarray:
    return (0.1 * np.arange(SHAPE[1]) * np.ones((SHAPE[0], 1))).astype(np.float32)


def test_a_jump_in_any_view_parts_two_regions() -> None:
    jumped = ramp()
    jumped[:, 30:] += 1.0
    labels = smooth_regions(views(ramp(), jumped))
    assert labels[20, 10] != labels[20, 50]
    assert 0 not in (labels[20, 10], labels[20, 50])


def test_what_two_of_three_views_know_is_a_region_of_its_own() -> None:
    half = ramp()
    half[:, 30:] = np.nan
    labels = smooth_regions(views(ramp(), ramp(), half))
    assert labels[20, 10] != labels[20, 50]
    assert 0 not in (labels[20, 10], labels[20, 50])


def test_what_one_view_knows_belongs_nowhere() -> None:
    half = ramp()
    half[:, 30:] = np.nan
    labels = smooth_regions(views(ramp(), half))
    assert labels[20, 10] > 0
    assert labels[20, 50] == 0
