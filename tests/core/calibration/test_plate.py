"""The white-plate relation: phase to depth, pixel by pixel, of an order that the residuals justify."""

import numpy as np
import pytest

from irpmd_rig.core.calibration.intrinsics import BoardPose
from irpmd_rig.core.calibration.plate import fit_plate_relation, place_plate
from irpmd_rig.core.errors import CalibrationError, FramesError, MeasurementError

POSITIONS = np.arange(0.0, 201.0, 10.0)


def plate_phase(position_mm, shape=(96, 112)):
    """A perspective phase: a ratio of linear functions of the plate's position, other at every pixel."""
    v, u = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    z = position_mm + 213.0
    return 150 + 200 * (z * (0.5 + 0.3 * u) - 160) / (1900 + 0.8 * z * (1 + 0.1 * v)) * 5.0


def stack(noise_rad=0.0, seed=0):
    rng = np.random.default_rng(seed)
    maps = [plate_phase(p) for p in POSITIONS]
    return np.stack([m + rng.normal(0, noise_rad, m.shape) for m in maps]).astype(np.float32)


def test_the_relation_gives_positions_between_the_calibrated_ones():
    relation = fit_plate_relation(stack(), POSITIONS, order=5)
    for truth in (3.0, 77.7, 195.0):
        np.testing.assert_allclose(relation.position_mm(plate_phase(truth).astype(np.float32)), truth, atol=2e-3)


def test_the_order_is_the_smallest_without_a_coherent_residual():
    relation = fit_plate_relation(stack(noise_rad=0.009), POSITIONS)
    coherent = {r.order: r.coherent_um for r in relation.residuals}
    pixel = {r.order: r.pixel_um for r in relation.residuals}
    assert relation.order == min(o for o, c in coherent.items() if c <= 1.1 * min(coherent.values()))
    assert 2 <= relation.order <= 4
    assert coherent[1] > 20 * coherent[relation.order]
    assert pixel[relation.order] > 3 * coherent[relation.order]


def test_a_pixel_that_saw_too_few_positions_is_unknown_and_nothing_is_extrapolated():
    phases = stack()
    phases[5:, 0, 0] = np.nan
    phases[:, 1, 1] = 7.0
    relation = fit_plate_relation(phases, POSITIONS, order=3)
    assert not relation.valid[0, 0]
    assert not relation.valid[1, 1]
    assert relation.valid.sum() == relation.valid.size - 2
    position = relation.position_mm(plate_phase(230.0).astype(np.float32))
    assert np.isnan(position).all()
    assert np.isnan(relation.position_mm(np.full((96, 112), np.nan, np.float32))).all()


def test_threads_give_the_same_numbers():
    one = fit_plate_relation(stack(0.01), POSITIONS, order=4)
    two = fit_plate_relation(stack(0.01), POSITIONS, order=4, threads=2)
    np.testing.assert_array_equal(one.coefficients_mm, two.coefficients_mm)
    phase = plate_phase(55.0).astype(np.float32)
    np.testing.assert_array_equal(one.position_mm(phase), two.position_mm(phase, threads=2))


def test_absolute_depth_comes_from_the_board_on_the_plate():
    tilt = np.deg2rad(2.0)
    rotation = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    board = BoardPose(0, rotation, np.zeros(3), np.array([5.0, -3.0, 313.0]), 0.01, 1e-5, 0.03)
    placement = place_plate(board, 100.0)
    directions = np.array([[[5.0, -3.0, 313.0], [0.1, 0.0, 1.0]]]) / [[[313.0], [1.0]]]
    depth = placement.depth_mm(np.array([[100.0, 130.0]]), directions)
    assert depth[0, 0] == pytest.approx(313.0)
    normal = rotation[:, 2]
    point = np.array([5.0, -3.0, 343.0])  # the plate moved by 30 mm along the optical axis
    assert normal @ (depth[0, 1] * directions[0, 1] - point) == pytest.approx(0, abs=1e-12)


def test_what_is_missing_is_said():
    with pytest.raises(CalibrationError, match="add positions"):
        fit_plate_relation(stack()[:3], POSITIONS[:3])
    with pytest.raises(CalibrationError, match="different positions"):
        fit_plate_relation(stack(), np.zeros(21))
    with pytest.raises(CalibrationError, match="check light"):
        fit_plate_relation(np.full((21, 64, 64), np.nan, np.float32), POSITIONS)
    with pytest.raises(FramesError, match="one finite position a map"):
        fit_plate_relation(stack(), POSITIONS[:-1])
    with pytest.raises(FramesError, match="differ in shape"):
        fit_plate_relation([np.zeros((4, 4), np.float32), np.zeros((4, 5), np.float32)], [0.0, 1.0])
    relation = fit_plate_relation(stack(), POSITIONS, order=3)
    with pytest.raises(FramesError, match="plate relation"):
        relation.position_mm(np.zeros((5, 5), np.float32))


def test_a_pixel_whose_phase_folds_back_jumps_or_leaves_a_gap_is_unknown():
    phases = stack()
    phases[:, 0, 0] = 100 + 0.01 * (POSITIONS - 100) ** 2
    phases[:, 0, 1] = np.random.default_rng(0).uniform(0, 400, POSITIONS.size)
    phases[5:20, 0, 2] = np.nan
    relation = fit_plate_relation(phases, POSITIONS, order=2)
    assert not relation.valid[0, :3].any()
    assert relation.valid.sum() == relation.valid.size - 3
    with pytest.raises(CalibrationError, match="does not change"):
        fit_plate_relation(np.zeros((21, 64, 64), np.float32), POSITIONS)


@pytest.mark.parametrize("order", [-1, 0, 1.5, "2"])
def test_an_impossible_order_is_refused(order):
    with pytest.raises(MeasurementError, match="order must be a whole number"):
        fit_plate_relation(stack(), POSITIONS, order=order)


def test_other_float_types_are_taken_and_others_refused():
    swapped = fit_plate_relation(stack().astype(">f8"), POSITIONS, order=3)
    np.testing.assert_array_equal(
        swapped.coefficients_mm, fit_plate_relation(stack(), POSITIONS, order=3).coefficients_mm
    )
    with pytest.raises(FramesError, match="floating-point"):
        fit_plate_relation(stack().astype(complex), POSITIONS, order=3)
    with pytest.raises(MeasurementError, match="threads"):
        fit_plate_relation(stack(), POSITIONS, order=3, threads=0)


@pytest.mark.parametrize(("phases", "positions"), [(None, [1, 2]), (np.zeros((4, 5, 5), np.float32), "abcd")])
def test_what_is_no_map_or_number_is_refused(phases, positions):
    with pytest.raises(FramesError, match="wants phase maps"):
        fit_plate_relation(phases, positions)
