"""The order of things within a run, with instruments that only note what they are told."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.protocols import (
    DeviceLost,
    Frame,
    LimitReached,
    MotionFailed,
    Position,
    Refused,
    StageCondition,
    StageState,
    TravelLimits,
)
from irpmd_rig.acquisition.captured import CapturedFrame, FrameQuality, FringeFrames
from irpmd_rig.acquisition.conduct import Ending, RunEnded
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.runs import Run, entered_at, first_incomplete
from irpmd_rig.acquisition.sequencer import Sequencer, Surroundings
from irpmd_rig.core.quality import FrameReport
from irpmd_rig.recipes.equipment import Equipment
from irpmd_rig.recipes.estimate import estimate
from irpmd_rig.recipes.plan import Plan, Prompt, Scene, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.store.record import RunRecord
from irpmd_rig.store.states import Reason, RunState, Transition
from irpmd_rig.store.store import Store

HEAD = "kind: sequence\nname: test\nretries: 2\nfringes: {counts: [8, 7], steps: 3}\nexposure_us: 1000.0\nsteps:\n"
TWO = """
  - {do: prompt, text: Place the mirror., subject: mirror}
  - {do: show, pattern: fringes}
  - {do: move, stage: stage1, position_mm: 10}
  - {do: capture, label: near}
  - {do: move, stage: stage1, position_mm: 20}
  - {do: capture, label: far}
"""
SETTLE = (
    "kind: characterise\nwhat: settle\nname: s\nfringes: {counts: [8, 7], steps: 3}\nexposure_us: 1000.0\n"
    "positions_mm: [20, 0]\nframes: 10\n"
)
PERSON = "  - {do: prompt, text: Turn it.}\n  - {do: capture, label: turned}\n"
REPORT = FrameReport((), 1.0, (50.0,), 0.9, float("nan"), 100, True, True, ())


class StageFake:
    """A stage that arrives at once; `fails` is raised by the next wait."""

    name = "stage1"

    def __init__(self, log: list[str]) -> None:
        self.log = log
        self.at_mm: float | None = 0.0
        self.condition = StageCondition.READY
        self.fails: Exception | None = None

    def limits(self) -> TravelLimits:
        return TravelLimits(0.0, 100.0)

    def state(self) -> StageState:
        position = None if self.at_mm is None else Position(self.at_mm, measured=True)
        return StageState(self.condition, position, self.at_mm, 1.0)

    def position(self) -> Position:
        raise Refused("stage1", "it has no zero", "home it")

    def wait(self) -> Position:
        self.log.append("wait")
        fails, self.fails = self.fails, None
        if fails is not None:
            raise fails
        return Position(self.at_mm or 0.0, measured=True)


class PhotographerFake:
    """Takes frames without a camera; `faulty` says which fringe sets fail their check."""

    def __init__(self, log: list[str], stage: StageFake, faulty: list[bool]) -> None:
        self.log, self.stage, self.faulty = log, stage, faulty
        self.during: list[Any] = []

    def expose(self, role: str = "white", exposure_us: float | str = "auto") -> float:
        self.log.append(f"expose {role} {exposure_us}")
        return 1000.0

    def dark(self) -> None:
        self.log.append("dark")

    def begin_move(self, _: str, position_mm: float) -> None:
        self.log.append(f"begin {position_mm:g}")
        self.stage.at_mm = position_mm

    def move(self, _: str, position_mm: float) -> Position:
        self.log.append(f"move {position_mm:g}")
        self.stage.at_mm = position_mm
        return Position(position_mm, measured=True)

    def prepare_fringes(self, *_: object) -> None:
        self.log.append(f"prepare on the way to {self.stage.at_mm:g}")

    def take_fringes(self, counts: tuple[float, ...], steps: int, _: str) -> FringeFrames:
        self.log.append(f"fringes at {self.stage.at_mm:g}")
        for call in self.during:
            call()
        images = np.zeros((len(counts), steps, 4, 4), np.uint8)
        frames = tuple(
            self._captured("fringes", images[number, step], set=number, step=step, counts=counts, steps=steps)
            for number in range(len(counts))
            for step in range(steps)
        )
        return FringeFrames(frames, images)

    def prepare_series(self, *_: object) -> None:
        self.log.append(f"series is prepared at {self.stage.at_mm:g}")

    def series(self, _counts: object, _steps: int, frames: int, _since_s: float) -> tuple[CapturedFrame, ...]:
        self.log.append(f"series at {self.stage.at_mm:g}")
        return tuple(self._captured("series", np.zeros((4, 4), np.uint8)) for _ in range(frames))

    def check(self, taken: FringeFrames) -> FringeFrames:
        if self.faulty and self.faulty.pop(0):
            self.log.append("faulty")
            raise FrameQuality(REPORT)
        self.log.append("good")
        return taken

    def plain(self) -> CapturedFrame:
        self.log.append("plain")
        return self._captured("plain", np.zeros((4, 4), np.uint8))

    def _captured(self, role: Any, image: Any, **more: Any) -> CapturedFrame:
        frame = Frame(image, 8, 0, 0, None, 0.0, 1000.0)
        return CapturedFrame(
            frame, role, 1000.0, None, 0.0, 1, checks={"noise_dn": float("nan"), "set": (1, 2)}, **more
        )


class Operator:
    name = "operator"

    def __init__(self, log: list[str]) -> None:
        self.log = log

    def arrange(self, scene: Scene) -> None:
        self.log.append(f"arrange {scene.subject}")


class Bench:
    """A run on such instruments."""

    def __init__(self, folder: Path, steps: str, faulty: list[bool] | None = None) -> None:
        self.log: list[str] = []
        self.stage = StageFake(self.log)
        self.photographer = PhotographerFake(self.log, self.stage, faulty or [])
        self.rig = SimpleNamespace(
            stages={"stage1": self.stage}, stage=lambda _: self.stage, operator=Operator(self.log)
        )
        recipe, _ = read_recipe(HEAD + steps)
        laid_out = plan(recipe)
        store = Store(folder)
        made = store.create_run(RunRecord(kind="sequence"), Transition(RunState.QUEUED, order=1))
        self.run = Run(made, recipe, laid_out, estimate(recipe, laid_out, Equipment()), EventLog())
        self.done: list[int] = []
        self.asked: list[Prompt | None] = []
        self.person: Callable[[], object] = lambda: None
        self.at_done: Callable[[], object] = lambda: None
        self.run.become(RunState.PREPARING)
        self.run.become(RunState.RUNNING)

    @contextmanager
    def at_ease(self) -> Iterator[None]:
        self.log.append("at ease")
        self.person()
        yield

    def station_done(self, station: int) -> None:
        self.done.append(station)
        self.at_done()

    def execute(self, first: int = 0, prompt_limit_s: float = 5.0) -> None:
        around = Surroundings(
            lambda: self.photographer,  # type: ignore[arg-type, return-value]
            self.at_ease,
            self.station_done,
            lambda: self.asked.pop(0) if self.asked else None,
            prompt_limit_s,
        )
        Sequencer(self.rig, self.run, around).execute(first)  # type: ignore[arg-type]

    @property
    def kept(self) -> list[tuple[int, int | None, float | None]]:
        return [(entry.station, entry.set, entry.stage1_mm) for entry in self.run.folder.manifest()]


def test_frames_are_checked_and_written_while_the_stage_goes_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    bench.execute()
    assert bench.log == [
        "arrange mirror",
        "move 10", "expose white 1000.0", "fringes at 10", "begin 20", "good",
        "expose white 1000.0", "prepare on the way to 20",
        "wait", "move 20", "expose white 1000.0", "fringes at 20", "good",
    ]  # fmt: skip
    assert bench.done == [0, 1]
    assert bench.kept == [(0, k, 10.0) for k in (0, 0, 0, 1, 1, 1)] + [(1, k, 20.0) for k in (0, 0, 0, 1, 1, 1)]
    entry = bench.run.folder.manifest()[0]
    assert entry.checks == {"noise_dn": None, "set": [1, 2], "taken": 1}
    assert (entry.label, entry.counts, entry.steps, entry.stage1_measured) == ("near", (8.0, 7.0), 3, True)


def test_a_station_whose_frames_are_faulty_is_taken_again_at_its_own_place(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO, faulty=[True, False, False])
    bench.execute()
    assert bench.log[1:11] == [
        "move 10", "expose white 1000.0", "fringes at 10", "begin 20", "faulty",
        "wait", "move 10", "expose white 1000.0", "fringes at 10", "begin 20",
    ]  # fmt: skip
    # Nothing of the faulty set is on disk, and every frame of the station is of one motion.
    assert bench.kept == [(0, k, 10.0) for k in (0, 0, 0, 1, 1, 1)] + [(1, k, 20.0) for k in (0, 0, 0, 1, 1, 1)]


def test_nothing_is_prepared_where_the_exposure_is_measured_first(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    recipe, _ = read_recipe(HEAD.replace("exposure_us: 1000.0\n", "") + TWO)
    bench.run.plan = plan(recipe)
    bench.execute()
    assert not any(entry.startswith("prepare") for entry in bench.log)


def test_a_wait_is_told(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path,
        TWO.replace("  - {do: capture, label: far}", "  - {do: wait, time_s: 0.01}\n  - {do: capture, label: far}"),
    )
    told: list[str] = []
    doing = bench.run.doing
    bench.run.doing = lambda what: (told.append(what), doing(what))[1]  # type: ignore[method-assign]
    bench.execute()
    assert "far: waits 0.01 s" in told


def test_faulty_frames_end_the_run_after_a_bounded_number_of_attempts(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO, faulty=[True] * 10)
    with pytest.raises(FrameQuality):
        bench.execute()
    assert bench.log.count("faulty") == 3
    assert bench.kept == []
    assert bench.done == []


def test_a_move_begun_ahead_that_fails_is_told(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)

    def fail() -> None:
        bench.stage.fails = MotionFailed("stage1", "it stalled", "look")

    bench.photographer.during.append(fail)
    with pytest.raises(MotionFailed, match="stalled"):
        bench.execute()
    assert first_incomplete(bench.run.plan, bench.run.folder.manifest()) == 1


def test_every_move_is_checked_just_before_it(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO.replace("20", "200"))
    with pytest.raises(LimitReached, match="200 mm is outside"):
        bench.execute()
    assert "begin 200" not in bench.log


def test_a_zero_that_is_lost_during_the_run_is_a_lost_instrument(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)

    def lose() -> None:
        bench.stage.at_mm = None

    bench.photographer.during.append(lose)
    with pytest.raises(DeviceLost, match="lost its zero"):
        bench.execute()
    assert "begin 20" not in bench.log


def test_what_stood_before_the_camera_is_arranged_again_when_a_run_goes_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    with pytest.raises(RunEnded) as raised:
        bench.execute(first=1)
    assert bench.log[:2] == ["arrange mirror", "move 20"]
    # Its first station was never taken: that is no success.
    assert raised.value.ending.reason is Reason.FRAMES_LOST


def test_nothing_moves_ahead_while_a_person_is_asked(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO.replace("  - {do: move, stage: stage1, position_mm: 20}\n", PERSON))
    bench.person = lambda: bench.run.conduct.answer("done")
    bench.execute()
    assert not any(entry.startswith("begin") for entry in bench.log)
    at = bench.log.index("at ease")
    assert bench.log[at - 1] == "dark"
    states = [state.state for state in bench.run.folder.states()]
    assert states.count(RunState.WAITING_FOR_OPERATOR) == 2
    assert bench.run.status().prompt is None


def test_a_prompt_expires(tmp_path: Path) -> None:
    bench = Bench(tmp_path, PERSON)
    with pytest.raises(RunEnded) as raised:
        bench.execute(prompt_limit_s=0.05)
    assert raised.value.ending.state is RunState.FAILED
    assert raised.value.ending.reason is Reason.PROMPT_EXPIRED
    assert "Turn it." in raised.value.ending.detail


def test_a_run_that_is_to_end_takes_nothing_more(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    ending = Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, "Ada")
    bench.photographer.during.append(lambda: bench.run.conduct.end(ending))
    with pytest.raises(RunEnded, match="Ada"):
        bench.execute()
    assert bench.log.count("fringes at 10") == 1
    assert not any(entry.startswith("begin") for entry in bench.log)
    assert bench.kept == []


def test_pause_waits_for_the_stage_and_turns_the_light_off(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    bench.photographer.during.append(bench.run.conduct.pause)
    later = threading.Timer(0.1, bench.run.conduct.resume)
    later.start()
    bench.photographer.during.append(lambda: bench.photographer.during.clear())
    bench.execute()
    later.join()
    assert "begin 20" not in bench.log
    at = bench.log.index("dark")
    assert bench.log[at + 1] == "move 20"
    states = [state.state for state in bench.run.folder.states()]
    assert states[-2:] == [RunState.PAUSED, RunState.RUNNING]


def test_frames_of_an_arrival_are_recorded_where_the_stage_arrived(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    bench.run.plan = plan(read_recipe(SETTLE)[0])
    bench.execute()
    assert [entry for entry in bench.log if entry.startswith("series")] == ["series is prepared at 20", "series at 0"]
    found = {(entry.station, entry.stage1_mm, entry.stage1_measured) for entry in bench.run.folder.manifest()}
    assert found == {(0, 20.0, True), (1, 0.0, True), (3, 0.0, True)}


def test_an_arrival_is_not_believed_where_nothing_moves(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    bench.run.plan = plan(read_recipe(SETTLE)[0])
    with pytest.raises(Refused, match="stands at 0 mm already"):
        bench.execute(first=3)
    assert "series at 0" not in bench.log
    # Taken up again where the stage comes from.
    assert [entered_at(bench.run.plan, first) for first in range(5)] == [0, 1, 2, 2, 4]


def test_a_run_that_was_ended_meanwhile_decides_nothing(tmp_path: Path) -> None:
    bench = Bench(tmp_path, TWO)
    first, *others = bench.run.plan.stations
    bench.run.plan = Plan((replace(first, decides=True), *others))
    bench.asked.append(None)
    ending = Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, "Ada")
    bench.at_done = lambda: bench.run.conduct.end(ending)
    with pytest.raises(RunEnded, match="Ada"):
        bench.execute()
    assert bench.asked == [None]
