"""The paper's depth with its uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.errors import FramesError, MeasurementError
from irpmd_rig.core.reconstruction.depth_equation import equation_depth
from tests.core.reconstruction.traced_views import SIGMA_RAD, cut, seen, world_of

SIZE_PX = 256
D_MM = 180.0


@pytest.mark.parametrize("positions_mm", [(0.0, 40.0), (0.0, -60.0)])
def test_exact_in_the_ideal_rig(positions_mm):
    scene, mirror = (seen(world_of("ideal"), subject, positions_mm, SIZE_PX) for subject in ("freeform", "mirror"))
    assert np.abs(scene.errors_um(equation_depth(scene.views, mirror.views, d_mm=D_MM).depth_mm)).max() < 1e-3


def test_sigma_of_the_equation_is_the_scatter_of_object_and_reference():
    world = world_of("ideal")
    for object_sigma, mirror_sigma in ((SIGMA_RAD, 1e-6), (SIGMA_RAD, SIGMA_RAD)):
        pulls = []
        for seed in range(4):
            scene = seen(world, "mirror_step_tilted", (0.0, 40.0), SIZE_PX, sigma_rad=object_sigma, seed=seed)
            mirror = seen(world, "mirror", (0.0, 40.0), SIZE_PX, sigma_rad=mirror_sigma, seed=100 + seed)
            found = equation_depth(scene.views, mirror.views, d_mm=D_MM)
            pulls.append((found.depth_mm - scene.depth_mm) / found.sigma_mm)
        assert np.nanstd(pulls) == pytest.approx(1.0, abs=0.03)


def test_the_physics_notes_figure_of_the_noise():
    scene, mirror = (seen(world_of("ideal"), subject, (0.0, 40.0), SIZE_PX) for subject in ("mirror_step_y", "mirror"))
    smooth = replace(mirror.views, sigmas_rad=tuple(np.zeros_like(sigma) for sigma in mirror.views.sigmas_rad))
    assert 0.07 < np.nanmedian(equation_depth(scene.views, smooth, d_mm=D_MM).sigma_mm) < 0.09


def test_other_positions_or_windows_are_refused():
    world = world_of("ideal")
    scene = seen(world, "mirror", (0.0, 40.0), 64)
    three = seen(world, "mirror", (0.0, 20.0, 40.0), 64)
    with pytest.raises(MeasurementError, match="takes two stage positions, not 3"):
        equation_depth(three.views, three.views, d_mm=D_MM)
    with pytest.raises(FramesError, match="one window"):
        equation_depth(scene.views, cut(scene.views, slice(0, 32), slice(0, 64)), d_mm=D_MM)
    with pytest.raises(FramesError, match="same two positions"):
        equation_depth(scene.views, three.views, d_mm=D_MM)
