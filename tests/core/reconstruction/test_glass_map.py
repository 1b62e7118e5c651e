"""The polynomials of the glass against the model that they stand for."""

import numpy as np
import pytest

from irpmd_rig.core.reconstruction.glass_map import powers, tabulate
from tests.core.reconstruction.traced_views import rig_of, world_of


@pytest.mark.parametrize("name", ["ideal", "misaligned", "turned", "mirrored"])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_place_on_the_glass_is_met_to_a_tenth_of_a_nanometre(name, axis):
    model = rig_of(world_of(name), 64)
    glass = tabulate(model, axis)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-90, 250, 2000), rng.uniform(-120, 120, 2000)
    along, across = (x, y) if axis == 0 else (y, x)
    for lifted_mm, within_mm in ((0.0, 1e-7), (0.1, 1e-6)):
        points = np.stack([x, y, model.glass_z_mm(x, y) + lifted_mm], axis=-1)
        phase = model.phase_rad(points, on_glass=True) if axis == 0 else model.phase_y_rad(points)
        found = glass.shear * across + glass.value(glass.place_mm, phase, across)
        found = found + lifted_mm * glass.value(glass.lift, phase, across)
        assert np.abs(found - along).max() < within_mm


@pytest.mark.parametrize("name", ["misaligned", "turned", "mirrored"])
def test_the_coarse_map_is_met_to_micrometres(name):
    glass = tabulate(rig_of(world_of(name), 64))
    rng = np.random.default_rng(0)
    phase, across = (middle + half * rng.uniform(-1, 1, 2000) for middle, half in (glass.along_rad, glass.across_mm))
    fine, coarse = (glass.value(coefficients, phase, across) for coefficients in (glass.place_mm, glass.coarse_mm))
    assert np.abs(coarse - fine).max() < 5e-3


def test_powers_of_chebyshev_polynomials():
    coefficients = np.random.default_rng(1).normal(size=(4, 6))
    x, y = np.linspace(-1, 1, 7), np.linspace(-0.5, 1, 7)
    expected = np.polynomial.chebyshev.chebval2d(x, y, coefficients)
    np.testing.assert_allclose(np.polynomial.polynomial.polyval2d(x, y, powers(coefficients)), expected, atol=1e-12)
