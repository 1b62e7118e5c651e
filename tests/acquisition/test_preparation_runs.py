"""Alignment and what is characterised, as whole runs on a small simulated rig whose operator really turns the glass."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemon_world import at_rest, ended

from irpmd_rig.acquisition.book import RecipeRefused
from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import RecipeText, RigDaemon
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.status import RunStatus
from irpmd_rig.processing import Announce, ProcessedRun, Worker
from irpmd_rig.shipped import world_file
from irpmd_rig.store.states import Reason, RunState
from sims.world import load_world
from tests.small_world import rig_file
from tests.small_world import world as served

CALIBRATION = (
    "{kind: calibrate-camera, name: camera, poses: 8}",
    "{kind: calibrate-plate, name: plate, positions_mm: [0, 50, 100, 150, 200]}",
)
SIZE_PX = 320
TRUTH = load_world(world_file("misaligned"))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    with served(tmp_path_factory.mktemp("world"), **{"size-px": SIZE_PX}) as world:
        yield world


@pytest.fixture(scope="module")
def daemon(world: WorldControl, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RigDaemon]:
    with RigDaemon(rig_file(world.folder, tmp_path_factory.mktemp("data"))) as daemon:
        yield daemon


@pytest.fixture(scope="module")
def calibrated(daemon: RigDaemon) -> RigDaemon:
    for recipe in CALIBRATION:
        _run(daemon, recipe)
    return daemon


def _ended(daemon: RigDaemon, recipe: str) -> RunStatus:
    submitted, _ = daemon.submit(RecipeText(recipe))
    daemon.queue_action("resume")
    return ended(daemon, submitted.id, 300.0)


def _run(daemon: RigDaemon, recipe: str) -> tuple[str, dict[str, Any]]:
    """Carry a recipe out; returns the run's id and its result, and activates a calibration."""
    status = _ended(daemon, recipe)
    assert status.state is RunState.SUCCEEDED, status.detail
    folder = daemon.store.run(status.id)
    if status.kind.startswith("calibrate"):
        daemon.activate(status.id)
        return status.id, folder.results.read_json("calibration.json")
    return status.id, folder.results.read_json("result.json")


def _tilt_deg(world: WorldControl) -> np.ndarray:
    """How the glass truly leans, about x and y."""
    turned = world.call("state")["glass_turn_deg"]
    return np.add(turned, [TRUTH.glass.tilt_about_x_deg, TRUTH.glass.tilt_about_y_deg])


def test_the_glass_is_turned_until_it_is_parallel(
    calibrated: RigDaemon, world: WorldControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed: list[Path] = []
    process = Worker.process

    def counted(worker: Worker, folder: Path, announce: Announce) -> ProcessedRun:
        computed.append(folder)
        return process(worker, folder, announce)

    monkeypatch.setattr(Worker, "process", counted)
    world.call("turn_glass", about_x_deg=-0.8, about_y_deg=1.2)
    run_id, result = _run(calibrated, "{kind: align, name: parallel, tolerance_deg: 0.1, rounds: 4}")
    at_rest(world)
    first, *_, last = result["rounds"]
    assert abs(first["about_x_deg"] + 0.8) < 0.2
    assert abs(first["about_y_deg"] - 1.3) < 0.2
    assert result["aligned"]
    assert result["next"] is None
    assert "parallel within the tolerance" in result["words"]
    assert np.abs(_tilt_deg(world)).max() < 0.2
    # Rounds that were not needed were not taken; what was asked is in the run's states.
    folder = calibrated.store.run(run_id)
    rounds = {entry.station for entry in folder.manifest() if entry.label == "mirror"}
    assert len(rounds) == len(result["rounds"]) < 4
    assert len(computed) == len(rounds)
    asked = [state.state for state in folder.states()].count(RunState.WAITING_FOR_OPERATOR)
    assert asked == 3 + len(rounds) - 1
    assert abs(last["about_x_deg"]) <= 0.1


def test_a_glass_that_is_out_of_tolerance_after_the_last_round_is_no_success(
    calibrated: RigDaemon, world: WorldControl
) -> None:
    world.call("turn_glass", about_x_deg=0.0, about_y_deg=1.0)
    before = _tilt_deg(world)
    status = _ended(calibrated, "{kind: align, name: parallel, tolerance_deg: 0.1, rounds: 1}")
    assert (status.state, status.reason) == (RunState.FAILED, Reason.REFUSED)
    assert "not parallel within the tolerance" in status.detail
    assert "Turn the ground glass: its +x side away from the mirror" in status.detail
    # Nothing is measured with a rig that is not as it was wanted.
    assert calibrated.queue_status().held
    # What was found is kept, and says of which round it is.
    result = calibrated.store.run(status.id).results.read_json("result.json")
    assert (result["of_round"], result["rounds_at_most"], result["over"]) == (1, 1, True)
    assert not result["aligned"]
    assert "not parallel" in result["words"]
    assert "+x side away from the mirror" in result["next"]
    assert np.array_equal(_tilt_deg(world), before)
    world.call("turn_glass", about_x_deg=0.0, about_y_deg=-1.0)


def test_the_axis_of_the_stage_is_found(calibrated: RigDaemon) -> None:
    _run(calibrated, "{kind: calibrate-geometry, name: geometry, positions_mm: [0]}")
    _, result = _run(calibrated, "{kind: characterise, what: stage-axis, name: axis, positions_mm: [0, -40, 40]}")
    truth = -np.tan(np.deg2rad(TRUTH.stage1.axis_tilt_about_y_deg))
    assert abs(result["drift"][0] - truth) < 2e-3
    assert abs(result["drift"][1]) < 2e-3
    assert result["scale"] == pytest.approx(1.0, abs=2e-3)
    assert result["uses"].keys() >= {"calibrate-geometry", "calibrate-camera"}
    assert "against the mirror's normal" in result["words"]


def test_gamma_is_found_and_taken_away_by_runs_that_name_it(daemon: RigDaemon) -> None:
    recipe = "{kind: characterise, what: gamma, name: gamma, fringes: {counts: [8, 7], steps: 12}%s}"
    run_id, result = _run(daemon, recipe % "")
    assert result["gamma"] == pytest.approx(TRUTH.projector.gamma, abs=0.01)
    assert len(result["table"]) == 256
    _, again = _run(daemon, recipe % f", compensation: {run_id}")
    assert abs(again["gamma"] - 1) < 0.01
    assert daemon.store.run(run_id).record().recipe["what"] == "gamma"


def test_a_compensation_that_is_none_is_refused_before_anything_moves(
    daemon: RigDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    homed: list[str] = []
    monkeypatch.setattr("irpmd_rig.acquisition.runner.has_zero", lambda _: False)
    monkeypatch.setattr(Rig, "find_zero", lambda _, name: homed.append(name))
    recipe = "{kind: characterise, what: settle, name: x, compensation: %s}"
    with pytest.raises(RecipeRefused, match="compensation 20200101-000000-abcdef cannot be used"):
        daemon.submit(RecipeText(recipe % "20200101-000000-abcdef"))
    # One that waits may serve when its turn has come: it does not.
    daemon.queue_action("hold")
    named, _ = daemon.submit(RecipeText("{kind: characterise, what: gamma, name: gamma}"))
    submitted, _ = daemon.submit(RecipeText(recipe % named.id))
    lease = daemon.take_lease("Ada", 60).id
    daemon.act(named.id, "abort", lease)
    daemon.release_lease(lease)
    daemon.queue_action("resume")
    status = ended(daemon, submitted.id)
    assert (status.state, status.reason) == (RunState.FAILED, Reason.REFUSED)
    assert f"compensation {named.id} cannot be used" in status.detail
    assert not status.frames
    # Not even a zero was looked for.
    assert homed == []


def test_focus_and_exposure(daemon: RigDaemon) -> None:
    _, focus = _run(daemon, "{kind: characterise, what: focus, name: focus, counts: [16, 64, 128], steps: 4}")
    assert np.all(np.diff(focus["contrast"]) < 0)
    # A camera of 320 px is as coarse as a blur of some pixels of the projector.
    assert 0.5 < focus["blur_px"] < 5
    times = [1000.0, 2000.0, 4000.0]
    _, exposure = _run(daemon, f"{{kind: characterise, what: exposure, name: e, exposures_us: {times}}}")
    assert exposure["exposures_us"] == times
    assert exposure["nonlinearity"] < 0.02
    assert 2000 < exposure["recommended_us"] < 20_000


def test_the_light_is_there_as_soon_as_a_picture_is_ordered(daemon: RigDaemon, world: WorldControl) -> None:
    _, result = _run(daemon, "{kind: characterise, what: delay, name: d, delays_ms: [0, 20, 100], exposure_us: 2000}")
    at_rest(world)
    assert len(result["after_ms"]) == 3
    assert result["light"][-1] == pytest.approx(1.0, abs=0.02)
    assert result["delay_ms"] <= result["after_ms"][-1]


def test_a_stage_that_rings_is_seen_to_settle(tmp_path_factory: pytest.TempPathFactory) -> None:
    # A slow world: a machine that is held up sees its ringing all the same.
    options = {"size-px": 192, "time-scale": 0.25}
    with (
        served(tmp_path_factory.mktemp("world"), **options) as world,
        RigDaemon(rig_file(world.folder, tmp_path_factory.mktemp("data"))) as daemon,
    ):
        _, result = _run(
            daemon, "{kind: characterise, what: settle, name: s, positions_mm: [6, 0], frames: 30, still_um: 4}"
        )
    # 20 um that decay to 0.5 um within 0.2 s of the world: 4 um after 0.09 s.
    assert result["settle_s"] is not None
    assert 0.1 < result["settle_s"] < 0.9
    assert 3 < result["largest_um"] < 25
    assert result["sigma_um"] < 1.0
