"""Uncertainty by a calibration that also told where the stage stood."""

from dataclasses import replace

import numpy as np

from irpmd_rig.core import find_facets
from irpmd_rig.core.evaluation.step_report import steps_of
from irpmd_rig.core.reconstruction.facet_estimate import Doubts, estimate_surfaces
from tests.core.seen_objects import DEPTH_SIGMA_MM, seen


def test_what_another_rig_tells_of_the_positions_goes_into_the_calibrations_part() -> None:
    treads = seen("mirror_step_tilted", size_px=256)
    depth, views = treads.depth_with(0.0, 0), treads.views_with(0.0, 0)
    facets = find_facets(treads.depth_with(DEPTH_SIGMA_MM, 0).depth_mm)
    a, b, c = treads.model.glass
    farther = replace(treads.model, glass=(a, b, c + 0.02))
    shifts_mm = np.array([[0.018, 0.013]])

    def steps(model, positions_mm, doubts):
        there = replace(views, positions_mm=positions_mm)
        return steps_of(estimate_surfaces(there, depth, facets, model, doubts))

    stated = steps(treads.model, (0.0, 40.0), Doubts(variations=(farther,), shifts_mm=shifts_mm))
    alone = steps(treads.model, (0.0, 40.0), Doubts(variations=(farther,)))
    other = steps(farther, (0.018, 40.013), Doubts(chi2_limit=np.inf))
    change = np.abs(other.values_mm - stated.values_mm)
    assert change.max() > 1e-3
    np.testing.assert_allclose(stated.calibration_mm, change, rtol=0.1, atol=5e-5)
    assert np.abs(alone.calibration_mm - change).max() > 5e-4
