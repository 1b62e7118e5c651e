"""The camera's rays invert OpenCV's distortion to 1e-12."""

import cv2
import numpy as np
import pytest

from sims.camera_rays import monotone_reach, pixel_rays
from sims.errors import WorldError
from sims.world import World


@pytest.mark.parametrize("kc", [(-0.13744, 0.14780, -0.00004, -0.00016, 0.0), (0.2, -0.1, 0.003, -0.002, 0.3)])
def test_rays_distorted_by_opencv_are_the_pixels(ideal: World, kc: tuple[float, ...]) -> None:
    camera = ideal.camera.model_copy(update={"kc": kc})
    rays = pixel_rays(camera)
    points = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1).reshape(-1, 3)
    unit, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(kc))
    v, u = np.mgrid[: rays.shape[0], : rays.shape[1]]
    expected = np.stack([(u - camera.cc_px[0]) / camera.fc_px[0], (v - camera.cc_px[1]) / camera.fc_px[1]], axis=-1)
    assert np.abs(unit.reshape(rays.shape) - expected).max() < 1e-12


def test_rays_of_one_lens_are_shared_and_cannot_be_written(ideal: World) -> None:
    rays = pixel_rays(ideal.camera)
    assert pixel_rays(ideal.camera) is rays
    with pytest.raises(ValueError, match="read-only"):
        rays[0, 0, 0] = 0


def test_folding_distortion_is_refused(ideal: World) -> None:
    assert monotone_reach((-0.3, 0.0, 0.0, 0.0, 0.0)) == pytest.approx(1 / 0.9)
    assert monotone_reach((0.3, 0.0, 0.0, 0.0, 0.0)) == np.inf
    with pytest.raises(WorldError, match="folds the image"):
        pixel_rays(ideal.camera.model_copy(update={"kc": (-3.0, 0.0, 0.0, 0.0, 0.0)}))
