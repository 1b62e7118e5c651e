"""The tracer against what plane mirrors do in closed form; OpenCV projects the points."""

import cv2
import numpy as np
import pytest

from sims.instruments import Camera
from sims.optics import Trace, trace
from sims.setup import Setup
from sims.truth import true_planes_mm
from sims.world import World


def pixels_of(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Camera pixels of points of frame M, by OpenCV; the camera's axes as the conventions say."""
    z = np.array(camera.axis) / np.linalg.norm(camera.axis)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    matrix = np.array([[camera.fc_px[0], 0, camera.cc_px[0]], [0, camera.fc_px[1], camera.cc_px[1]], [0, 0, 1.0]])
    local = (points - np.array(camera.position_mm)) @ axes.T
    out, _ = cv2.projectPoints(local, np.zeros(3), np.zeros(3), matrix, np.array(camera.kc))
    return out.reshape(-1, 2)


def centres(mask: np.ndarray) -> np.ndarray:
    return np.argwhere(mask)[:, ::-1].astype(float)


def seen_and_lit(seen: Trace, facet: int) -> np.ndarray:
    return (seen.kind == 1) & (seen.facet == facet) & np.isfinite(seen.lit_mm[..., 0])


def test_points_seen_project_back_to_their_pixels(misaligned: World) -> None:
    seen = trace(misaligned, Setup("mirror"))
    known = seen.kind > 0
    assert {1, 2, 3} <= set(np.unique(seen.kind))
    error = pixels_of(misaligned.camera, seen.point_mm[known]) - centres(known)
    assert np.abs(error).max() < 1e-9


def test_a_plane_mirror_shows_the_glass_where_its_virtual_image_is(misaligned: World) -> None:
    seen = trace(misaligned, Setup("mirror", stage1_mm=17.0))
    known = seen_and_lit(seen, 0)
    virtual = seen.lit_mm[known] * [1.0, 1.0, -1.0]
    assert known.sum() > 1000
    assert np.abs(pixels_of(misaligned.camera, virtual) - centres(known)).max() < 1e-9


def test_a_tilted_mirror_shows_the_image_reflected_at_its_plane(misaligned: World) -> None:
    seen = trace(misaligned, Setup("mirror_step_tilted"))
    for facet, (a, b, c) in enumerate(true_planes_mm(misaligned, "mirror_step_tilted")):
        known = seen_and_lit(seen, facet)
        normal = np.array([-b, -c, 1.0]) / np.sqrt(1 + b * b + c * c)
        lit = seen.lit_mm[known]
        height = (lit - [0.0, 0.0, a]) @ normal
        virtual = lit - 2 * height[:, None] * normal
        assert known.sum() > 300
        assert np.abs(pixels_of(misaligned.camera, virtual) - centres(known)).max() < 1e-9
        assert np.abs(seen.normal[known] - normal).max() < 1e-12


def test_camera_roll_turns_the_image(ideal: World) -> None:
    """A roll of 180 degrees about the principal point, without distortion, turns the picture upside down."""
    square = {"cc_px": (127.5, 127.5), "kc": (0.0, 0.0, 0.0, 0.0, 0.0)}
    upright, turned = (
        trace(
            ideal.model_copy(update={"camera": ideal.camera.model_copy(update={**square, "roll_deg": roll})}),
            Setup("mirror"),
        )
        for roll in (0.0, 180.0)
    )
    assert np.array_equal(upright.kind, turned.kind[::-1, ::-1])
    both = np.isfinite(upright.projector_px)
    assert np.abs(upright.projector_px - turned.projector_px[::-1, ::-1])[both].max() < 1e-8


def test_inverse_square_law_and_cosine_of_incidence(ideal: World) -> None:
    seen = trace(ideal, Setup("mirror"))
    source = np.array(ideal.projector.position_mm)
    for kind, share, normal_z in ((1, 0.9 * ideal.glass.transmission, 1.0), (2, ideal.mirror.sprayed_albedo, 1.0)):
        known = (seen.kind == kind) & (seen.projector_factor_per_mm2 > 0)
        way = source - seen.lit_mm[known]
        distance = np.linalg.norm(way, axis=1)
        expected = share * normal_z * way[:, 2] / distance / (np.pi * distance**2)
        assert seen.projector_factor_per_mm2[known] == pytest.approx(expected, rel=1e-12)
