"""A few rays traced again by other means: SciPy's root finding on surfaces written down anew."""

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve
from scipy.spatial.transform import Rotation

from sims.instruments import Camera
from sims.objects import Freeform
from sims.optics import trace
from sims.setup import Setup
from sims.world import World


def direction(camera: Camera, u: int, v: int) -> np.ndarray:
    k1, k2, p1, p2, k3 = camera.kc
    xd = (u - camera.cc_px[0]) / camera.fc_px[0]
    yd = (v - camera.cc_px[1]) / camera.fc_px[1]

    def misfit(p: np.ndarray) -> list[float]:
        x, y = p
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        return [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - xd,
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - yd,
        ]

    x, y = fsolve(misfit, [xd, yd], xtol=1e-14)
    angle = np.radians(37.0)
    right, down = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([0.0, -1.0, 0.0])
    way = x * right + y * down + np.array([np.sin(angle), 0, -np.cos(angle)])
    return way / np.linalg.norm(way)


class Surface:
    """One freeform mirror: height above its own tilted frame, with complex-step slopes."""

    def __init__(self, world: World, number: int) -> None:
        item = world.objects["freeform"]
        assert isinstance(item, Freeform)
        self.mirror = item.mirrors[number]
        angles = [self.mirror.tilt_about_x_deg, self.mirror.tilt_about_y_deg]
        self.turn = Rotation.from_euler("xy", angles, degrees=True).as_matrix()

    def height(self, x: complex, y: complex) -> complex:
        m = self.mirror
        cx, cy = 1 / m.radius_x_mm, 1 / m.radius_y_mm
        if cx == cy:
            # A true sphere: its centre is one radius above the vertex.
            sag = m.radius_x_mm - np.sqrt(m.radius_x_mm**2 - x * x - y * y)
        else:
            sag = (cx * x * x + cy * y * y) / (1 + np.sqrt(1 - cx**2 * x * x - cy**2 * y * y))
        bx, by = x - m.bump_centre_mm[0], y - m.bump_centre_mm[1]
        return sag + m.bump_height_mm * np.exp(-(bx * bx + by * by) / (2 * m.bump_width_mm**2))

    def gap(self, point: np.ndarray) -> float:
        x, y, z = self.turn.T @ (point - np.array(self.mirror.centre_mm))
        return float(z - self.height(x, y).real)

    def normal(self, point: np.ndarray) -> np.ndarray:
        x, y, _ = self.turn.T @ (point - np.array(self.mirror.centre_mm))
        step = 1e-30
        slopes = [self.height(x + 1j * step, y).imag / step, self.height(x, y + 1j * step).imag / step]
        normal = self.turn @ np.array([-slopes[0], -slopes[1], 1.0])
        return normal / np.linalg.norm(normal)


@pytest.mark.parametrize("number", [0, 1], ids=["sphere", "saddle with a bump"])
def test_freeform_rays_meet_surface_and_bowed_glass_where_root_finding_says(misaligned: World, number: int) -> None:
    bowed = misaligned.glass.model_copy(update={"bow_um": 300.0})
    world = misaligned.model_copy(update={"glass": bowed})
    stage1_mm = 23.0
    seen = trace(world, Setup("freeform", stage1_mm=stage1_mm))
    surface = Surface(world, number)
    pixels = np.argwhere((seen.facet == number) & np.isfinite(seen.lit_mm[..., 0]))
    eye = np.array(world.camera.position_mm)
    glass_turn = Rotation.from_euler("xy", [0.0, bowed.tilt_about_y_deg], degrees=True).as_matrix()
    stage = Rotation.from_euler("xy", [0.0, world.stage1.axis_tilt_about_y_deg], degrees=True)
    glass_centre = np.array(bowed.centre_mm) - stage1_mm * stage.apply([0.0, 0.0, -1.0])
    assert len(pixels) > 100

    def over_glass(point: np.ndarray) -> float:
        x, y, z = glass_turn.T @ (point - glass_centre)
        return float(z - 0.3 * ((x / 125) ** 2 + (y / 125) ** 2))

    for v, u in pixels[:: len(pixels) // 25]:
        way = direction(world.camera, u, v)
        t = brentq(lambda t, way=way: surface.gap(eye + t * way), 330.0, 480.0, xtol=1e-13, rtol=1e-15)
        point = eye + t * way
        normal = surface.normal(point)
        turned = way - 2 * (way @ normal) * normal
        t = brentq(lambda t, p=point, w=turned: over_glass(p + t * w), 1.0, 500.0, xtol=1e-13, rtol=1e-15)
        assert seen.point_mm[v, u] == pytest.approx(point, abs=1e-11)
        assert seen.normal[v, u] == pytest.approx(normal, abs=1e-13)
        assert seen.lit_mm[v, u] == pytest.approx(point + t * turned, abs=1e-10)
