"""The rig's calls: what they change, what they refuse, and that a seed repeats everything."""

import numpy as np
import pytest

from sims.errors import SimulationError, WorldError
from sims.optics import trace
from sims.rig import SimulatedRig
from sims.setup import Setup
from sims.world import World


def test_it_begins_at_home_in_front_of_the_mirror_in_the_dark(aligned: World) -> None:
    rig = SimulatedRig(aligned)
    assert rig.setup == Setup("mirror")
    frame = rig.capture()
    assert frame.shape == (256, 256)
    assert frame.dtype == np.uint8


def test_the_same_calls_give_the_same_frames(aligned: World) -> None:
    def run(seed: int | None) -> list[np.ndarray]:
        rig = SimulatedRig(aligned, seed=seed)
        rig.place("fan_y")
        rig.move_stage1(40.0)
        rig.show(np.full((768, 1024), 200, np.uint8))
        return [rig.capture(), rig.capture()]

    first, second, other = run(None), run(None), run(99)
    assert np.array_equal(first, second)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], other[0])


def test_every_move_has_an_error_of_its_own(aligned: World) -> None:
    rig = SimulatedRig(aligned)
    stops = []
    for _ in range(200):
        rig.move_stage1(40.0)
        stops.append(rig.setup.stage1_mm)
    assert np.std(stops) == pytest.approx(1e-3, rel=0.2)
    assert np.mean(stops) == pytest.approx(40.0, abs=4e-4)
    rig.move_stage2(100.0)
    assert rig.setup.stage2_mm == pytest.approx(100.0, abs=6e-3)
    assert rig.setup.stage2_mm != 100.0


def test_scale_error_grows_with_the_move(ideal: World) -> None:
    stage = ideal.stage1.model_copy(update={"scale_error_ppm": 50.0})
    rig = SimulatedRig(ideal.model_copy(update={"stage1": stage}))
    rig.move_stage1(-60.0)
    assert rig.setup.stage1_mm == pytest.approx(-60.003, abs=1e-12)


def test_trace_is_the_truth_of_the_present_setup(misaligned: World) -> None:
    rig = SimulatedRig(misaligned)
    rig.place("mirror_step_x")
    rig.move_stage1(-20.0)
    ours = rig.trace()
    truth = trace(misaligned, Setup("mirror_step_x", stage1_mm=rig.setup.stage1_mm))
    assert np.array_equal(ours.projector_px, truth.projector_px, equal_nan=True)


def test_known_setups_are_not_traced_again_and_others_are_forgotten(ideal: World) -> None:
    rig = SimulatedRig(ideal)
    first = rig.light_map()
    rig.place("plate")
    rig.light_map()
    rig.place("mirror")
    assert rig.light_map() is first
    for pose in range(3):
        rig.place("board", pose=pose)
        rig.light_map()
    rig.place("mirror")
    assert rig.light_map() is not first


def test_ten_bits_come_as_uint16(ideal: World, aligned: World) -> None:
    rig = SimulatedRig(aligned)
    rig.set_bits(10)
    rig.show(np.full((768, 1024), 255, np.uint8))
    frame = rig.capture()
    assert frame.dtype == np.uint16
    assert 255 < frame.max() <= 1023
    assert SimulatedRig(ideal).capture().dtype == np.uint16


def test_bad_requests_are_one_clear_error(ideal: World) -> None:
    rig = SimulatedRig(ideal)
    refused = [
        (lambda: rig.place("mirror_step_z"), "no subject 'mirror_step_z'.*mirror_step_y"),
        (lambda: rig.place("board", pose=30), "poses 0 to 29, not 30"),
        (lambda: rig.place("mirror", pose=1), "poses 0 to 0, not 1"),
        (lambda: rig.move_stage1(-81.0), "from -80.0 to 220.0 mm, not to -81.0"),
        (lambda: rig.move_stage1(float("nan")), "not to nan"),
        (lambda: rig.move_stage2(201.0), "from 0.0 to 200.0 mm"),
        (lambda: rig.set_light("ultraviolet"), "infrared and visible"),
        (lambda: rig.set_exposure(0), "positive number of microseconds"),
        (lambda: rig.set_bits(12), "8 or 10 bits, not 12"),
        (lambda: rig.show(np.zeros((1024, 768), np.uint8)), r"shape \(768, 1024\)"),
        (lambda: rig.show(np.zeros((768, 1024))), "not float64"),
        (lambda: rig.place(None), "no subject 'None'"),
        (lambda: rig.place("board", pose=1.5), "poses 0 to 29, not 1.5"),
        (lambda: rig.place("board", pose="1"), "poses 0 to 29, not '1'"),
        (lambda: rig.move_stage1("a"), "from -80.0 to 220.0 mm, not to 'a'"),
        (lambda: rig.move_stage1(None), "not to None"),
        (lambda: rig.move_stage2("a"), "from 0.0 to 200.0 mm, not to 'a'"),
        (lambda: rig.move_stage2(None), "not to None"),
        (lambda: rig.move_stage2(float("nan")), "not to nan"),
        (lambda: rig.set_exposure("a"), "microseconds, at most 1e9, not 'a'"),
        (lambda: rig.set_exposure(10**400), "at most 1e9"),
        (lambda: rig.set_bits(8.0), "8 or 10 bits, not 8.0"),
        (lambda: rig.show("a"), "shows arrays, not a str"),
        (lambda: rig.show(5), "shows arrays, not a int"),
        (lambda: rig.show([[0]]), "shows arrays, not a list"),
    ]
    before = rig.setup
    for call, message in refused:
        with pytest.raises(SimulationError, match=message):
            call()
    assert rig.setup == before


@pytest.mark.parametrize("seed", [-1, 2**63, 1.5, "1", True, [1]])
def test_bad_seeds_are_refused_at_construction(ideal: World, seed: object) -> None:
    with pytest.raises(SimulationError, match="a seed is a whole number"):
        SimulatedRig(ideal, seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("change", [{"square_mm": 1000.0}, {"margin_px": 5000.0}])
def test_a_board_that_does_not_fit_is_refused_when_placed(ideal: World, change: dict[str, float]) -> None:
    board = ideal.board.model_copy(update=change)
    rig = SimulatedRig(ideal.model_copy(update={"board": board}))
    with pytest.raises(WorldError, match="no pose 3 fits"):
        rig.place("board", pose=3)
    assert rig.setup == Setup("mirror")
