"""Faults of a world's instruments by name, and the record of those that were injected."""

import inspect
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from sims.errors import SimulationError
from sims.process.complaints import complaint, one_of

if TYPE_CHECKING:
    from sims.process.instruments import Instruments

Times = Annotated[int, Field(ge=1, le=10_000)]
Share = Annotated[float, Field(ge=0, lt=1)]
Seconds = Annotated[float, Field(ge=0, le=3600)]
Millimetres = Annotated[float, Field(ge=-1000, le=1000)]
Stage = Literal["stage1", "stage2"]
Led = Literal["red", "green", "blue", "infrared"]
# Types are as written: "3" is no number of frames.
_CONFIG = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class Injected:
    """A fault that was injected at a time of the world."""

    time_s: float
    name: str
    arguments: dict[str, Any] = field(default_factory=dict)


class Faults:
    """Every fault that can be injected, by name, from any thread while the world runs.

    A fault of a device's next frames, moves, transfers or replies is spent by them; one that lasts has a partner
    that ends it (`camera_unplug` and `camera_replug`), or an argument (`stage_mute` with `on` false).

    Parameters
    ----------
    instruments : Instruments
    """

    def __init__(self, instruments: "Instruments") -> None:
        self._clock = instruments.clock
        self._injecting = threading.Lock()
        self._log: list[Injected] = []
        self._functions = {**_of_camera(instruments), **_of_projector(instruments), **_of_stages(instruments)}
        self._arguments = {name: _arguments_of(name, function) for name, function in self._functions.items()}

    @property
    def names(self) -> dict[str, dict[str, Any]]:
        """Every fault with its arguments and their defaults; one that has to be given has None."""
        return {
            name: {key: None if field.is_required() else field.default for key, field in model.model_fields.items()}
            for name, model in self._arguments.items()
        }

    @property
    def injected(self) -> list[Injected]:
        """What was injected, in order."""
        with self._injecting:
            return list(self._log)

    def check(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of a fault with those that were left out.

        Raises
        ------
        SimulationError
            There is no such fault, or it does not take such arguments.
        """
        model = self._arguments.get(name)
        if model is None:
            raise SimulationError(f"there is no fault {name!r}{one_of(name, self._arguments)}")
        try:
            return model.model_validate(dict(arguments)).model_dump()
        except ValidationError as error:
            raise SimulationError(f"fault {name!r}: {complaint(error)}") from None

    def inject(self, name: str, arguments: Mapping[str, Any]) -> None:
        """Inject a fault.

        Raises
        ------
        SimulationError
            There is no such fault, or it does not take such arguments.
        """
        complete = self.check(name, arguments)
        with self._injecting:
            self._log.append(Injected(self._clock.now(), name, complete))
            self._functions[name](**complete)


def _arguments_of(name: str, function: Callable[..., None]) -> type[BaseModel]:
    fields: dict[str, Any] = {
        known.name: (known.annotation, ... if known.default is known.empty else known.default)
        for known in inspect.signature(function).parameters.values()
    }
    return create_model(name, __config__=_CONFIG, **fields)


def _of_camera(instruments: "Instruments") -> dict[str, Callable[..., None]]:
    faults = instruments.camera.faults

    def frame_dropped(frames: Times = 1) -> None:
        faults.drop_next(frames)

    def frame_incomplete(frames: Times = 1, share: Share = 0.5) -> None:
        faults.incomplete_next(frames, share)

    def frame_late(frames: Times = 1, seconds: Seconds = 1.0) -> None:
        faults.late_next(frames, seconds)

    def trigger_missed(triggers: Times = 1) -> None:
        faults.miss_triggers(triggers)

    def camera_node_error(
        node: str = "ExposureTime", access: Literal["read", "write"] = "write", times: Times = 1
    ) -> None:
        (faults.fail_reads if access == "read" else faults.fail_writes)(node, times)

    def camera_overheat(temperature_c: Annotated[float, Field(ge=-50, le=200)] = 85.0) -> None:
        faults.overheat(temperature_c)

    def camera_slow(seconds: Seconds = 0.5) -> None:
        faults.answer_after(seconds)

    return {
        **{made.__name__: made for made in (frame_dropped, frame_incomplete, frame_late, trigger_missed)},
        "camera_unplug": faults.unplug,
        "camera_replug": faults.replug,
        "camera_hang": faults.hang,
        "camera_recover": faults.recover,
        "camera_overheat": camera_overheat,
        "camera_cool": faults.cool,
        "camera_node_error": camera_node_error,
        "camera_slow": camera_slow,
    }


def _of_projector(instruments: "Instruments") -> dict[str, Callable[..., None]]:
    faults = instruments.projector.faults

    def projector_stall(transfers: Times = 1) -> None:
        faults.usb.stall_next(transfers)

    def projector_timeout(transfers: Times = 1) -> None:
        faults.usb.time_out_next(transfers)

    def projector_garbled(replies: Times = 1) -> None:
        faults.usb.garble_next(replies)

    def projector_led_fault(led: Led = "infrared") -> None:
        faults.led = led

    def projector_mend() -> None:
        faults.led = None

    def sync_missed(edges: Times = 1) -> None:
        faults.miss_sync(edges)

    functions = (
        projector_stall,
        projector_timeout,
        projector_garbled,
        projector_led_fault,
        projector_mend,
        sync_missed,
    )
    return {
        "projector_unplug": faults.usb.unplug,
        "projector_replug": faults.usb.replug,
        "projector_overheat": faults.overheat,
        **{made.__name__: made for made in functions},
    }


def _of_stages(instruments: "Instruments") -> dict[str, Callable[..., None]]:
    faults = {name: twin.faults for name, twin in instruments.stages.items()}

    def stage_unplug(stage: Stage) -> None:
        faults[stage].unplug()

    def stage_replug(stage: Stage) -> None:
        faults[stage].replug()

    def stage_stall(stage: Stage, fraction: Share = 0.5) -> None:
        faults[stage].stall_next_move(fraction=fraction)

    def stage_limit(stage: Stage, fraction: Share = 0.5) -> None:
        faults[stage].limit_next_move(fraction=fraction)

    def stage_overshoot(stage: Stage, by_mm: Millimetres = 0.5) -> None:
        faults[stage].overshoot_next_move(by_mm=by_mm)

    def stage_lost_steps(stage: Stage, counts: Annotated[float, Field(ge=-1e6, le=1e6)] = 500.0) -> None:
        faults[stage].lose_steps(counts=counts)

    def stage_slow(stage: Stage, seconds: Seconds = 0.5) -> None:
        faults[stage].line.slow_s = seconds

    def stage_mute(stage: Stage, on: bool = True) -> None:
        faults[stage].line.mute = on

    def stage_garbled(stage: Stage, replies: Times = 1) -> None:
        faults[stage].line.garble_next(replies)

    def stage_endless(stage: Stage, on: bool = True) -> None:
        faults[stage].line.endless = on

    functions = (
        stage_unplug,
        stage_replug,
        stage_stall,
        stage_limit,
        stage_overshoot,
        stage_lost_steps,
        stage_slow,
        stage_mute,
        stage_garbled,
        stage_endless,
    )
    return {made.__name__: made for made in functions}
