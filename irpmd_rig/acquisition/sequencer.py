"""Carries a plan out: prompt, motion, exposure, frames, station by station, each frame on disk before it counts."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from drivers.protocols import DeviceLost, Position, Refused
from irpmd_rig.acquisition.arriving import await_arrival, check_away
from irpmd_rig.acquisition.capture import Photographer
from irpmd_rig.acquisition.captured import CapturedFrame, FrameQuality, FringeFrames
from irpmd_rig.acquisition.conduct import Ending, RunEnded
from irpmd_rig.acquisition.interlocks import check_move, has_zero
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.runs import Run, arriving, first_incomplete
from irpmd_rig.acquisition.settling import wait_until_still
from irpmd_rig.recipes.estimate import targets
from irpmd_rig.recipes.plan import Prompt, Shot, Station
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.states import Reason, RunState

_log = logging.getLogger(__name__)
PROMPT_LIMIT_S = 3600.0
ABORT_ANSWER = "abort"


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a sequencer works with beside rig and run.

    Attributes
    ----------
    photographer
        Makes a photographer that knows nothing of what the instruments are set to.
    at_ease
        Lets others look through the camera while the run waits for a person.
    station_done
        Told the number of each station whose frames are all on disk.
    decide
        Computes what the frames on disk tell, after a station that decides; returns what is asked before the run goes
        on, None: it need not go on.
    prompt_limit_s
        How long a person is waited for.
    """

    photographer: Callable[[], Photographer]
    at_ease: Callable[[], AbstractContextManager[None]]
    station_done: Callable[[int], None]
    decide: Callable[[], Prompt | None]
    prompt_limit_s: float = PROMPT_LIMIT_S


class Sequencer:
    """One attempt of one run.

    While the stage moves on to the next station, the frames of the last one are checked and written. Where the check
    finds anything the stage moves back, and the whole station is taken again.

    Parameters
    ----------
    rig
        Opened instruments.
    run
        What to do; it is in the state `preparing`.
    surroundings
        What it works with.
    """

    def __init__(self, rig: Rig, run: Run, surroundings: Surroundings) -> None:
        self._rig = rig
        self._run = run
        self._around = surroundings
        self._photographer = surroundings.photographer()
        self._prompts = 0
        self._positions: dict[str, Position] = {}
        self._begun: set[str] = set()

    def execute(self, first: int) -> None:
        """Take all stations from `first` on; returns when every frame of the plan is on disk and passed its checks.

        Raises
        ------
        RunEnded
            Somebody wanted it, or nobody answered a prompt.
        InstrumentError, AcquisitionError, FramesError, StoreError
            What went wrong with instruments, frames or disk.
        """
        plan, end = self._run.plan, len(self._run.plan.stations)
        self._run.begin_at(first)
        for station in plan.stations[first:]:
            self._run.conduct.pause_if_wanted(self._paused, self._resumed)
            prompts = [station.prompt]
            if station.index == first:
                # Whatever stood before the camera in an earlier attempt may have been taken away since.
                prompts = list(dict.fromkeys([plan.prompt_in_force(first), station.prompt]))
            for prompt in prompts:
                if prompt is not None:
                    self._ask(prompt)
            self._take_station(station)
            self._run.stations_done(station.index + 1)
            self._around.station_done(station.index)
            if station.decides:
                self._run.conduct.check()
                wanted = self._around.decide()
                if wanted is None:
                    end = station.index + 1
                    break
                self._ask(wanted)
        missing = first_incomplete(plan, self._run.folder.manifest())
        if missing < end:
            what = f"station {missing} is not complete on disk"
            raise RunEnded(Ending(RunState.FAILED, Reason.FRAMES_LOST, f"{what}: retry the run"))

    # --- people

    def _paused(self) -> None:
        for name in tuple(self._begun):
            self._finish_move(name)
        self._photographer.dark()
        self._run.become(RunState.PAUSED)

    def _resumed(self) -> None:
        self._photographer = self._around.photographer()
        self._run.become(RunState.RUNNING)

    def _ask(self, prompt: Prompt) -> None:
        run, operator = self._run, self._rig.operator
        self._prompts += 1
        if operator is not None and prompt.scene is not None:
            run.become(RunState.WAITING_FOR_OPERATOR)
            run.doing(f"{operator.name}: {prompt.text}")
            operator.arrange(prompt.scene)
            run.conduct.check()
            run.become(RunState.RUNNING)
            return
        self._photographer.dark()
        limit_s = self._around.prompt_limit_s
        run.ask(self._prompts, prompt.text, limit_s)
        try:
            run.become(RunState.WAITING_FOR_OPERATOR)
            with self._around.at_ease():
                answer = run.conduct.await_answer(limit_s)
        finally:
            run.asked_no_more()
        if answer is None:
            what = f"nobody answered within {limit_s:g} s: {prompt.text}"
            raise RunEnded(Ending(RunState.FAILED, Reason.PROMPT_EXPIRED, what))
        if answer == ABORT_ANSWER:
            raise RunEnded(Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, f"answered with abort: {prompt.text}"))
        self._photographer = self._around.photographer()
        run.become(RunState.RUNNING)

    # --- stations

    def _take_station(self, station: Station) -> None:
        retries = self._run.recipe.retries
        for left in reversed(range(retries + 1)):
            try:
                self._take_once(station)
                return
            except FrameQuality as quality:
                if not left:
                    raise
                _log.warning("run %s: station %d is taken again: %s", self._run.id, station.index, quality.what)

    def _take_once(self, station: Station) -> None:
        run = self._run
        if not arriving(station):
            self._move(station)
        if station.wait_s:
            run.doing(f"{station.label}: waits {station.wait_s:g} s")
            run.conduct.sleep(station.wait_s)
        run.doing(f"{station.label}: exposure")
        if station.shots:
            self._photographer.expose("white" if station.lit else "plain", station.exposure_us)
        if station.settle == "measured":
            shoot = self._photographer.white if station.lit else self._photographer.plain
            wait_until_still(lambda: shoot().frame)
        places = self._places()
        run.doing(f"{station.label}: {station.frames} frames")
        taken = [self._arrive(station, shot) if arriving(station) else self._shoot(shot) for shot in station.shots]
        if arriving(station):
            # Before its shots the stage stood at another place.
            places = self._places()
        following = self._begin_next(station)
        self._keep(station, taken, places)
        if following is not None:
            self._prepare(following)

    def _move(self, station: Station) -> None:
        for name, target_mm in targets(station).items():
            self._run.conduct.check()
            self._finish_move(name)
            self._may_move(name, target_mm)
            self._run.doing(f"{name} to {target_mm:g} mm")
            self._positions[name] = self._photographer.move(name, target_mm)

    def _may_move(self, name: str, target_mm: float) -> None:
        try:
            check_move(self._rig, name, target_mm)
        except Refused as error:
            if not has_zero(self._rig.stage(name)):
                # It had one when the run began.
                what = "the axis lost its zero during the run: its line or its controller was away"
                raise DeviceLost(name, what, "look at cable and power, then retry the run") from error
            raise

    def _finish_move(self, name: str) -> None:
        """Wait for a move that was begun ahead: whatever went wrong with it is told, also if it ended elsewhere."""
        if name in self._begun:
            self._begun.discard(name)
            self._rig.stage(name).wait()

    def _begin_next(self, station: Station) -> Station | None:
        """Let the stages go on to the next station, unless a person is to come near them first; returns it."""
        following = self._run.plan.stations[station.index + 1 : station.index + 2]
        if not following or following[0].prompt is not None or self._run.conduct.asked is not None:
            return None
        if station.decides or arriving(following[0]):
            return None
        for name, target_mm in targets(following[0]).items():
            self._may_move(name, target_mm)
            self._begun.add(name)
            self._photographer.begin_move(name, target_mm)
        return following[0]

    def _prepare(self, station: Station) -> None:
        """Load, order and arm for a station while its stage moves, where nothing else is shown there before."""
        shot = station.shots[0] if station.shots else None
        if shot is not None and shot.role == "fringes" and station.exposure_us != "auto" and station.settle == "timed":
            self._photographer.expose(exposure_us=station.exposure_us)
            self._photographer.prepare_fringes(shot.counts, shot.steps, shot.orientation)

    def _places(self) -> dict[str, Any]:
        """Where the stages stand, for the manifest: also those that this plan does not move."""
        places: dict[str, Any] = {}
        for name, stage in self._rig.stages.items():
            position = self._positions.get(name) or stage.state().position
            if position is not None:
                places |= {f"{name}_mm": position.position_mm, f"{name}_measured": position.measured}
        return places

    def _shoot(self, shot: Shot) -> tuple[Shot, Sequence[CapturedFrame]]:
        self._run.conduct.check()
        if shot.role == "fringes":
            return shot, self._photographer.take_fringes(shot.counts, shot.steps, shot.orientation)
        if shot.role == "switched":
            return shot, (self._photographer.switched(shot.delay_s),)
        take = {"white": self._photographer.white, "black": self._photographer.black, "plain": self._photographer.plain}
        return shot, (take[shot.role](),)

    def _arrive(self, station: Station, shot: Shot) -> tuple[Shot, Sequence[CapturedFrame]]:
        """Take a series from the moment at which the stage's motion ends; then wait until it has settled."""
        photographer = self._photographer
        photographer.prepare_series(shot.counts, shot.steps, shot.repeats)
        since_s = time.monotonic()
        for name, target_mm in targets(station).items():
            self._finish_move(name)
            self._may_move(name, target_mm)
            check_away(self._rig.stage(name), target_mm)
            photographer.begin_move(name, target_mm)
            since_s = await_arrival(self._rig.stage(name), target_mm, self._run.conduct)
        frames = photographer.series(shot.counts, shot.steps, shot.repeats, since_s)
        self._move(station)
        return shot, frames

    # --- frames

    def _keep(
        self, station: Station, taken: list[tuple[Shot, Sequence[CapturedFrame]]], places: Mapping[str, Any]
    ) -> None:
        """Check the frames, and write them when all are good."""
        checked = [
            (shot, self._photographer.check(frames) if isinstance(frames, FringeFrames) else frames)
            for shot, frames in taken
        ]
        folder, run = self._run.folder, self._run
        done = sum(earlier.frames for earlier in run.plan.stations[: station.index])
        for shot, frames in checked:
            for frame in frames:
                self._run.conduct.check()
                folder.write_frame(frame.frame.image, self._entry(station, shot, frame, places))
                done += 1
        folder.flush()
        run.frames_done(done)

    def _entry(self, station: Station, shot: Shot, captured: CapturedFrame, places: Mapping[str, Any]) -> ManifestEntry:
        frame = captured.frame
        age = timedelta(seconds=time.monotonic() - frame.received_s)
        return ManifestEntry(
            station=station.index,
            label=shot.label,
            role=shot.role,
            orientation=shot.orientation if shot.role == "fringes" else "x",
            set=captured.set,
            step=captured.step,
            view=shot.view,
            counts=captured.counts or None,
            steps=captured.steps or None,
            exposure_us=captured.exposure_us,
            led=captured.led,
            intensity=captured.intensity,
            bits=frame.bits,
            time=datetime.now(UTC) - age,
            frame_id=frame.frame_id,
            checks={**_as_json(captured.checks), "taken": captured.attempt},
            attempt=self._run.attempt,
            **places,
        )


def _as_json(value: Any) -> Any:
    """Values of a check as JSON has them: what is not finite is unknown."""
    if isinstance(value, Mapping):
        return {str(key): _as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
