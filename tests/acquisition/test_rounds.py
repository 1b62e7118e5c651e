"""Runs that are steered by their own results: rounds, the prompt between them, and their early end."""

from dataclasses import replace
from pathlib import Path

import pytest
from test_sequencer import TWO, Bench

from irpmd_rig.acquisition.conduct import RunEnded
from irpmd_rig.acquisition.rounds import aim_missed, asked_next
from irpmd_rig.processing import ProcessedRun
from irpmd_rig.recipes.plan import Plan, Prompt, Scene
from irpmd_rig.store.states import Reason, RunState

TURN = Prompt("Turn it.", Scene("mirror", turn_deg=(0.0, -0.1)))


def _rounds(folder: Path) -> Bench:
    """Two stations, each of which decides."""
    bench = Bench(folder, TWO)
    bench.run.plan = Plan(tuple(replace(station, decides=True) for station in bench.run.plan.stations))
    return bench


def test_a_run_ends_as_soon_as_its_results_say_so(tmp_path: Path) -> None:
    bench = _rounds(tmp_path)
    bench.execute()
    assert bench.done == [0]
    assert {station for station, *_ in bench.kept} == {0}


def test_the_operator_is_asked_between_rounds_and_nothing_moves_meanwhile(tmp_path: Path) -> None:
    bench = _rounds(tmp_path)
    bench.asked.append(TURN)
    bench.execute()
    assert bench.done == [0, 1]
    assert not any(entry.startswith("begin") for entry in bench.log)
    assert bench.log.index("arrange mirror", 1) < bench.log.index("move 20")


def test_a_round_that_lacks_frames_is_no_success(tmp_path: Path) -> None:
    bench = _rounds(tmp_path)
    with pytest.raises(RunEnded) as raised:
        bench.execute(first=1)
    assert raised.value.ending.reason is Reason.FRAMES_LOST


def test_what_is_asked_is_what_was_computed() -> None:
    done = ProcessedRun("x", "align", {}, (), {"aligned": 1})
    assert asked_next(done) is None
    summary = {"ask": "Turn it.", "turn_about_x_deg": 0.0, "turn_about_y_deg": -0.1}
    assert asked_next(ProcessedRun("x", "align", {}, (), {**summary})) == TURN


def test_what_the_last_round_leaves_to_do_is_no_success() -> None:
    assert aim_missed(ProcessedRun("x", "align", {}, (), {"aligned": 1})) is None
    missed = aim_missed(ProcessedRun("x", "align", {}, (), {"aligned": 0, "left": "Turn it on."}))
    assert missed is not None
    assert (missed.state, missed.reason, missed.detail) == (RunState.FAILED, Reason.REFUSED, "Turn it on.")
