"""Faults that a world injects by itself: at given times, or at random from a seed."""

import heapq
import itertools
import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from sims import yaml_source
from sims.errors import SimulationError, WorldError
from sims.instruments import Part
from sims.process.complaints import one_of

if TYPE_CHECKING:
    from sims.clock import Clock
    from sims.process.faults import Faults

_log = logging.getLogger(__name__)

Draw = Callable[[np.random.Generator], dict[str, Any]]
# A lasting fault lasts so long, in the world's seconds.
LASTS_S = (0.5, 3.0)


def _nothing(_chance: np.random.Generator) -> dict[str, Any]:
    return {}


def _stage(chance: np.random.Generator) -> dict[str, Any]:
    return {"stage": str(chance.choice(["stage1", "stage2"]))}


def _few(name: str) -> Draw:
    return lambda chance: {name: int(chance.integers(1, 4))}


@dataclass(frozen=True, slots=True)
class _Kind:
    """How a fault's arguments are drawn, and what ends it if it lasts (with the arguments that it shares)."""

    draw: Draw = _nothing
    ended_by: str | None = None
    end: Mapping[str, Any] = field(default_factory=dict)


_KINDS: dict[str, _Kind] = {
    "frame_dropped": _Kind(_few("frames")),
    "frame_incomplete": _Kind(lambda chance: {"frames": 1, "share": float(chance.uniform(0, 0.95))}),
    "frame_late": _Kind(lambda chance: {"frames": 1, "seconds": float(chance.uniform(0.1, 2.0))}),
    "trigger_missed": _Kind(_few("triggers")),
    "camera_unplug": _Kind(ended_by="camera_replug"),
    "camera_hang": _Kind(ended_by="camera_recover"),
    "camera_overheat": _Kind(ended_by="camera_cool"),
    "camera_node_error": _Kind(lambda chance: {"access": str(chance.choice(["read", "write"]))}),
    "camera_slow": _Kind(lambda chance: {"seconds": float(chance.uniform(0.05, 0.5))}, "camera_slow", {"seconds": 0.0}),
    "projector_unplug": _Kind(ended_by="projector_replug"),
    "projector_stall": _Kind(_few("transfers")),
    "projector_timeout": _Kind(_few("transfers")),
    "projector_garbled": _Kind(_few("replies")),
    "projector_led_fault": _Kind(ended_by="projector_mend"),
    "projector_overheat": _Kind(),
    "sync_missed": _Kind(_few("edges")),
    "stage_unplug": _Kind(_stage, "stage_replug"),
    "stage_stall": _Kind(_stage),
    "stage_limit": _Kind(_stage),
    "stage_overshoot": _Kind(lambda chance: _stage(chance) | {"by_mm": float(chance.uniform(0.05, 2.0))}),
    "stage_lost_steps": _Kind(lambda chance: _stage(chance) | {"counts": float(chance.integers(50, 2000))}),
    "stage_slow": _Kind(_stage, "stage_slow", {"seconds": 0.0}),
    "stage_mute": _Kind(_stage, "stage_mute", {"on": False}),
    "stage_garbled": _Kind(_stage),
    "stage_endless": _Kind(_stage, "stage_endless", {"on": False}),
}


class RandomFaults(Part):
    """Faults at random times, `rate_per_s` a second of the world on average; `names` None: all kinds."""

    seed: Annotated[int, Field(ge=0, lt=2**63)]
    rate_per_s: Annotated[float, Field(gt=0, le=100)]
    names: Annotated[tuple[str, ...], Field(min_length=1)] | None = None


class TimedFault(Part):
    """One fault, `at_s` seconds of the world after the start."""

    at_s: Annotated[float, Field(ge=0, le=1e7)]
    fault: str
    arguments: Annotated[dict[str, Any], Field(default_factory=dict)]


class _ScriptFile(Part):
    random: RandomFaults | None = None
    script: tuple[TimedFault, ...] = ()


Events = Iterator[TimedFault]


def random_events(settings: RandomFaults) -> Events:
    """Yield faults for ever, in order of time; what lasts is followed by what ends it. The seed decides all.

    Raises
    ------
    SimulationError
        A name is none of a fault that can come at random.
    """
    names = settings.names or tuple(_KINDS)
    for name in names:
        if name not in _KINDS:
            raise SimulationError(f"no fault {name!r} can come at random{one_of(name, _KINDS)}")
    return _drawn(settings, names)


def _drawn(settings: RandomFaults, names: tuple[str, ...]) -> Events:
    chance = np.random.default_rng([settings.seed, 0xFA17])
    ends: list[tuple[float, int, TimedFault]] = []
    number = itertools.count()
    at_s = 0.0
    while True:
        at_s += float(chance.exponential(1 / settings.rate_per_s))
        while ends and ends[0][0] <= at_s:
            yield heapq.heappop(ends)[2]
        name = names[int(chance.integers(len(names)))]
        event = TimedFault(at_s=at_s, fault=name, arguments=_KINDS[name].draw(chance))
        yield event
        end = ending(event, at_s + float(chance.uniform(*LASTS_S)))
        if end is not None:
            heapq.heappush(ends, (end.at_s, next(number), end))


def ending(event: TimedFault, at_s: float) -> TimedFault | None:
    """Return what ends a fault, or None for one that does not last."""
    kind = _KINDS.get(event.fault)
    if kind is None or kind.ended_by is None:
        return None
    shared = {key: value for key, value in event.arguments.items() if key == "stage"}
    return TimedFault(at_s=at_s, fault=kind.ended_by, arguments={**shared, **kind.end})


def read_script(path: Path, faults: "Faults") -> Events:
    """Read a script of faults: a YAML file with `script`, `random`, or both.

    `script` is a list of {at_s, fault, arguments}; `random` has seed, rate_per_s and, if only some are to come,
    names. Times are the world's, from its start.

    Raises
    ------
    WorldError
        With every complaint, one a line: `file:line:column: what is wrong`.
    """
    source = yaml_source.read(path)
    try:
        found = _ScriptFile.model_validate(source.content)
    except ValidationError as error:
        raise WorldError(
            "\n".join(f"{source.position(source.keys_at(detail['loc']))}: {detail['msg']}" for detail in error.errors())
        ) from None
    complaints = []
    for number, event in enumerate(found.script):
        try:
            faults.check(event.fault, event.arguments)
        except SimulationError as error:
            complaints.append(f"{source.position(('script', number, 'fault'))}: {error}")
    drawn: Events = iter(())
    if found.random is not None:
        try:
            drawn = random_events(found.random)
        except SimulationError as error:
            complaints.append(f"{source.position(('random', 'names'))}: {error}")
    if complaints:
        raise WorldError("\n".join(complaints))
    timed = sorted(found.script, key=lambda event: event.at_s)
    return heapq.merge(timed, drawn, key=lambda event: event.at_s)


class Script:
    """Injects faults at their times, from a thread of its own, until it is stopped.

    Parameters
    ----------
    faults : Faults
    clock : Clock
    """

    def __init__(self, faults: "Faults", clock: "Clock") -> None:
        self._faults, self._clock = faults, clock
        self._switching = threading.RLock()
        self._running: tuple[threading.Thread, threading.Event] | None = None

    def start_random(self, settings: RandomFaults) -> None:
        """Inject faults at random from now on, instead of any other script."""
        self.start(random_events(settings))

    def start(self, events: Events) -> None:
        """Inject these from now on, instead of any other script."""
        with self._switching:
            self.stop()
            ended = threading.Event()
            thread = threading.Thread(target=self._run, args=(events, ended), name="faults", daemon=True)
            self._running = thread, ended
            thread.start()

    def stop(self) -> None:
        """Inject nothing more; what the script began and what lasts still is ended."""
        with self._switching:
            running, self._running = self._running, None
            if running is not None:
                running[1].set()
                running[0].join()

    def _run(self, events: Events, ended: threading.Event) -> None:
        start_s = self._clock.now()
        lasting: dict[tuple[str, object], TimedFault] = {}
        for event in events:
            left_s = event.at_s - (self._clock.now() - start_s)
            if ended.wait(max(0.0, left_s) / self._clock.time_scale):
                break
            self._inject(event)
            end = ending(event, event.at_s)
            same = lasting.get(_key(event))
            if same is not None and same.arguments == event.arguments:
                del lasting[_key(event)]
            elif end is not None:
                lasting[_key(end)] = end
        ended.wait()
        for end in lasting.values():
            self._inject(end)

    def _inject(self, event: TimedFault) -> None:
        try:
            self._faults.inject(event.fault, event.arguments)
        except Exception:
            _log.exception("the fault %s could not be injected", event.fault)


def _key(event: TimedFault) -> tuple[str, object]:
    return event.fault, event.arguments.get("stage")
