"""What is looked at before anything moves: the whole recipe before the first motion, and every move again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from drivers.protocols import CameraCapabilities, InstrumentError, LimitReached, Refused, Stage, StageCondition
from drivers.registry import driver_class
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.patterns import longest_exposure_us
from irpmd_rig.acquisition.rig import DeviceCondition, Rig
from irpmd_rig.acquisition.rig_file import RigFile
from irpmd_rig.acquisition.runs import arriving
from irpmd_rig.processing.chain import check_uses, needs_of
from irpmd_rig.recipes.equipment import Axis, Equipment
from irpmd_rig.recipes.estimate import targets
from irpmd_rig.recipes.models import Recipe
from irpmd_rig.recipes.plan import Plan
from irpmd_rig.store.library import Library
from irpmd_rig.store.record import Fringes, Kind, Optics, RunRecord
from irpmd_rig.store.run_folder import RunFolder


class NotReady(AcquisitionError):
    """The rig cannot begin a run now."""


def equipment_of(rig: Rig) -> Equipment:
    """Tell what a rig can do, for checking recipes: what is not open or not known is left out, and not checked."""
    file = rig.file
    axes = {}
    for name, device in file.devices.items():
        if device.kind != "stage":
            continue
        lower_mm, upper_mm = device.settings.get("limits_mm", (-float("inf"), float("inf")))
        stage = rig.stages.get(name)
        if stage is not None:
            lower_mm, upper_mm = stage.limits().lower_mm, stage.limits().upper_mm
        speed = device.settings.get("speed_mm_per_s")
        reads = stage is None or stage.capabilities().reads_position
        axes[name] = Axis(lower_mm, upper_mm, speed, float(device.settings.get("settle_s", 0.2)), reads)
    known: dict[str, Any] = {"stages": axes, "trigger": file.trigger, **_camera(rig), **_projector(rig)}
    known["display_delay_s"] = _display_delay_s(file)
    if rig.operator is not None:
        known |= {"subjects": rig.operator.subjects, "board_poses": rig.operator.board_poses}
    return Equipment(**known)


def axes_of(plan: Plan) -> frozenset[str]:
    """Stages that a plan moves."""
    return frozenset(name for station in plan.stations for name in targets(station))


def instruments_of(plan: Plan) -> frozenset[str]:
    """Instruments that a plan needs."""
    return axes_of(plan) | {"camera", "projector"}


def check_start(rig: Rig, plan: Plan) -> None:
    """Refuse a run for which an instrument that it needs is not ready.

    Raises
    ------
    InstrumentError
        The instrument's own error, where it gave one; Refused where a stage is to be seen to arrive whose controller
        tells nothing.
    """
    needed = instruments_of(plan)
    for name, state in rig.devices.items():
        if name in needed and state.state is not DeviceCondition.READY:
            if state.error is not None:
                raise type(state.error)(name, state.detail, state.remedy)
            rig.instrument(name)
    for name in sorted(needed):
        rig.instrument(name)
    for station in plan.stations:
        for name in targets(station) if arriving(station) else ():
            if not rig.stage(name).capabilities().reads_position:
                what = "its controller does not say when it arrives, so the time cannot be measured"
                raise Refused(name, what, "use a stage whose controller tells its position")


def check_move(rig: Rig, name: str, target_mm: float) -> None:
    """Refuse a move, just before it is sent.

    Raises
    ------
    LimitReached
        It leaves the soft limits.
    Refused
        The axis has no zero, or still moves to somewhere else.
    InstrumentError
        There is no such stage, or it is lost.
    """
    stage = rig.stage(name)
    limits, state = stage.limits(), stage.state()
    if not limits.lower_mm <= target_mm <= limits.upper_mm:
        raise LimitReached(
            name,
            f"{target_mm:g} mm is outside its limits",
            f"give {limits.lower_mm:g} to {limits.upper_mm:g} mm",
        )
    if not has_zero(stage):
        raise Refused(name, "the axis has no zero", "home it, or zero it at a known place")
    if state.condition is StageCondition.MOVING and state.target_mm != target_mm:
        raise Refused(name, f"it still moves to {state.target_mm} mm", "wait for it, or stop it")


def has_zero(stage: Stage) -> bool:
    """Whether an axis has a zero; raises InstrumentError if it cannot be asked.

    Its condition does not tell: that may be about a move that failed before the zero was lost.
    """
    if stage.state().position is not None:
        return True
    try:
        stage.position()
    except Refused:
        return False
    return True


def rig_reasons(rig: Rig, needed: frozenset[str], without_zero: Iterable[str]) -> list[str]:
    """Why the instruments cannot begin a run: not ready, or without a zero that a person has to give.

    Parameters
    ----------
    rig
        The instruments; nothing is asked of them.
    needed
        Names of those that the run needs.
    without_zero
        Axes that have none.
    """
    reasons = [
        f"{name} is {state.state}: {state.detail or 'it is not open'}" + (f" ({state.remedy})" if state.remedy else "")
        for name, state in rig.devices.items()
        if name in needed and state.state is not DeviceCondition.READY
    ]
    return reasons + [
        f"{name} has no zero and cannot home: zero it at a known place"
        for name in without_zero
        if name in needed and rig.operator is None and not _can_home(rig, name)
    ]


def record_of(recipe: Recipe, rig_file: RigFile) -> RunRecord:
    """Write down what a run is to be, as `run.yaml` has it."""
    needs = needs_of(recipe.kind, getattr(recipe, "what", None))
    uses: dict[Kind, str] = {}
    calibration, reference = getattr(recipe, "calibration", None), getattr(recipe, "reference", None)
    if needs and calibration is not None:
        uses[needs[0]] = calibration
    if reference is not None:
        uses["reference"] = reference
    fringes = getattr(recipe, "fringes", None)
    return RunRecord(
        kind=recipe.kind,
        name=recipe.name,
        operator=recipe.operator or "",
        sample=recipe.sample or "",
        notes=recipe.notes,
        nominal_steps_mm=recipe.nominal_steps_mm,
        fringes=None if fringes is None else Fringes(counts=fringes.counts, steps=fringes.steps),
        positions_mm=getattr(recipe, "positions_mm", ()),
        uses=uses,
        recipe=recipe.model_dump(mode="json"),
        rig=rig_part(rig_file),
    )


def rig_part(rig_file: RigFile) -> dict[str, Any]:
    """Write down the rig as it was, filled in, for `run.yaml`."""
    drawing, board = rig_file.drawing, rig_file.checkerboard
    part: dict[str, Any] = {
        "name": rig_file.name,
        "light": rig_file.light.model_dump(mode="json"),
        "trigger": rig_file.trigger,
        "calibration": rig_file.calibration.model_dump(mode="json"),
    }
    if rig_file.world is not None:
        part |= {"world": str(rig_file.world), "simulation": rig_file.simulation.model_dump(mode="json")}
    if drawing is not None:
        part["drawing"] = {name: list(getattr(drawing, name)) for name in ("camera_xy_mm", "heading", "d_point_mm")}
    if board is not None:
        part["checkerboard"] = board.model_dump(mode="json")
    for name, device in rig_file.devices.items():
        part[name] = {"driver": device.driver, **{key: _plain(value) for key, value in device.settings.items()}}
    return part


def settle_uses(rig: Rig, folder: RunFolder, library: Library) -> None:
    """Find and check the calibrations and the reference that a run will use, and write them down.

    Raises
    ------
    irpmd_rig.processing.errors.Refused
        One is missing or does not fit.
    """
    capabilities = rig.camera.capabilities()
    optics = Optics(camera_serial=capabilities.serial_number, size_px=capabilities.sensor_size_px)
    part = rig_part(rig.file)
    # The fringes are known by it: what their rounding does to the phase is computed.
    part["projector"] |= {"size_px": list(rig.projector.capabilities().size_px)}
    record = folder.record().model_copy(update={"optics": optics, "rig": part})
    uses = check_uses(record, library)
    optics = optics.model_copy(update={"intrinsics": uses.get("calibrate-camera")})
    folder.amend(optics=optics, rig=record.rig, uses=uses)


# --- inside


def _camera(rig: Rig) -> dict[str, Any]:
    try:
        can: CameraCapabilities = rig.camera.capabilities()
    except InstrumentError:
        return {}
    known: dict[str, Any] = {
        "camera_size_px": can.sensor_size_px,
        "exposure_range_us": can.exposure_range_us,
        "pixel_formats": can.pixel_formats or None,
        "triggers": tuple(trigger for trigger in can.triggers if trigger != "free"),
    }
    if can.frame_rate_range_hz is not None and can.frame_rate_range_hz[1] > 0.0:
        known["frame_period_s"] = 1.0 / can.frame_rate_range_hz[1]
    return known


def _projector(rig: Rig) -> dict[str, Any]:
    try:
        can = rig.projector.capabilities()
    except InstrumentError:
        return {}
    longest_us = longest_exposure_us(can, rig.file.light.led)
    return {
        "projector_size_px": can.size_px,
        "pattern_limit": can.pattern_limit,
        "leds": tuple(str(led) for led in can.leds) or None,
        "longest_pattern_us": longest_us if longest_us != float("inf") and rig.file.trigger == "hardware" else None,
    }


def _display_delay_s(file: RigFile) -> float | None:
    projector = file.devices.get("projector")
    if projector is None:
        return None
    try:
        fields = driver_class(projector.kind, projector.driver, device=projector.name).Settings.model_fields
    except InstrumentError:
        return None
    if "display_delay_s" not in fields:
        return None
    return float(projector.settings.get("display_delay_s", fields["display_delay_s"].default))


def _can_home(rig: Rig, name: str) -> bool:
    stage = rig.stages.get(name)
    return stage is not None and stage.capabilities().can_home


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
