"""The shipped rig with write-only stages: a zero from the operator's word, moves at their real pace, no stop."""

import time

import pytest

from drivers.errors import Refused
from drivers.values import Position, StageCondition
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.rig_file import read_rig


@pytest.fixture(scope="module")
def rig():
    with Rig(read_rig("sim-gcd").with_simulation(private=True, size_px=64)) as rig:
        yield rig


def truth_mm(rig: Rig) -> float:
    return rig.operator.control.call("state")["stages"]["stage1"]["position_mm"]


def test_the_operator_gives_the_zero_at_the_start(rig):
    for stage in rig.stages.values():
        assert stage.state().condition is StageCondition.READY
        assert stage.position() == Position(0.0, measured=False)
    assert not rig.stage("stage1").capabilities().can_home


def test_two_moves_end_where_they_should_and_are_said_to_be_estimated(rig):
    stage = rig.stage("stage1")
    for target_mm in (4.0, -1.0):
        started_s = time.monotonic()
        stage.move_to(target_mm)
        assert stage.wait() == Position(target_mm, measured=False)
        # Four commands, paced as the box needs, and two seconds after the last.
        assert time.monotonic() - started_s > 3.5
        assert truth_mm(rig) == pytest.approx(target_mm, abs=0.02)


def test_after_opening_again_the_zero_is_read_off_the_scale(rig):
    before_mm = truth_mm(rig)
    rig.reopen("stage1")
    with pytest.raises(Refused, match="no zero"):
        rig.stage("stage1").move_to(0.0)
    assert rig.find_zeros() == {"stage1": Position(round(before_mm, 2), measured=False)}
    assert round(before_mm, 2) == pytest.approx(-1.0, abs=0.02)


def test_making_safe_says_when_a_move_will_have_ended(rig):
    stage = rig.stage("stage1")
    stage.move_to(9.0)
    answer = rig.make_safe()["stage1"]
    assert not answer.stopped
    # 10 mm at 20 mm/s, with its commands and ramps; how much of that is over is the machine's business.
    assert 0.0 < answer.ends_in_s < 4.0
    assert truth_mm(rig) != pytest.approx(9.0, abs=0.02)
    # The world is another process, which may have heard of the start a moment later.
    time.sleep(answer.ends_in_s + 0.5)
    assert truth_mm(rig) == pytest.approx(9.0, abs=0.02)
