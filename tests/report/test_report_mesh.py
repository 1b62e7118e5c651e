"""The surface as a page holds it."""

import base64
import json

import numpy as np
import pytest

from irpmd_rig.report.mesh import mesh_of

Y, X = np.mgrid[:40, :60].astype(float)
POINTS = np.dstack([0.1 * X, 0.2 * Y, np.sin(X / 9)])


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<u2") / 65535


def test_points_come_back_to_a_fraction_of_their_range():
    content = json.loads(mesh_of(POINTS).as_json())
    low, high = np.array(content["low_mm"]), np.array(content["high_mm"])
    points = low + unpacked(content["points"]).reshape(content["rows"], content["columns"], 3) * (high - low)
    np.testing.assert_allclose(points, POINTS, atol=1e-4)


def test_a_large_surface_is_made_small():
    tall = np.dstack(np.broadcast_arrays(*np.meshgrid(np.arange(2048.0), np.arange(1500.0)), 1.0))
    mesh = mesh_of(tall)
    assert max(mesh.labels.shape) <= 220
    assert len(mesh.as_json()) < 500_000


def test_what_belongs_to_no_facet_is_left_out():
    labels = np.where(X < 30, 1, 0)
    labels[:, 50:] = 2
    points = POINTS.copy()
    points[3, 3] = np.nan
    mesh = mesh_of(points, labels)
    assert mesh.labels[3, 3] == 0
    assert np.isnan(mesh.points_mm[mesh.labels == 0]).all()
    assert set(np.unique(mesh.labels)) == {0, 1, 2}
    assert json.loads(mesh.as_json())["low_mm"][2] == pytest.approx(np.nanmin(points[labels > 0][:, 2]), abs=1e-3)


def test_residuals_go_to_either_side_of_zero():
    residual = np.where(X > 5, 10 * np.cos(Y), np.nan)
    content = json.loads(mesh_of(POINTS, None, residual).as_json())
    reach = content["residual_reach_um"]
    back = (2 * unpacked(content["residuals"]) - 1) * reach
    known = np.isfinite(residual).ravel()
    np.testing.assert_allclose(back[known], residual.ravel()[known], atol=2e-3 * reach)
    assert "residuals" not in json.loads(mesh_of(POINTS, None, np.full(X.shape, np.nan)).as_json())


def test_where_nothing_is_known_there_is_no_surface():
    assert mesh_of(np.full((9, 9, 3), np.nan)) is None
    assert mesh_of(POINTS, np.zeros(X.shape, int)) is None
