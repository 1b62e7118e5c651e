"""Opens every instrument of a rig, each for itself, and writes down what it tells."""

from __future__ import annotations

from collections.abc import Callable

from drivers.errors import ConfigurationError, InstrumentError
from drivers.protocols import Camera, Projector, Stage
from irpmd_rig.acquisition.rig import DeviceCondition, DeviceState, Rig
from irpmd_rig.doctor.machine import lacking, rights
from irpmd_rig.doctor.report import DeviceReport, Finding, Report

Found = tuple[dict[str, str], tuple[str, ...], tuple[Finding, ...]]


def examine(rig: Rig) -> Report:
    """Report on a rig that was opened."""
    devices = tuple(_device(rig, name, state) for name, state in rig.devices.items())
    suspects = [
        rig.file.devices[n] for n, state in rig.devices.items() if not rig.simulated and _may_lack_something(state)
    ]
    return Report(rig.file.name, rig.file.document.name, rig.simulated, devices, rights(suspects))


def _device(rig: Rig, name: str, state: DeviceState) -> DeviceReport:
    found: dict[str, str] = {}
    unverified: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    if state.state is DeviceCondition.READY:
        try:
            found, unverified, findings = _LOOK[state.kind](rig, name)
        except InstrumentError as error:
            findings = (Finding(error.what, error.remedy),)
    else:
        findings = (Finding(state.detail, state.remedy),)
        if not rig.simulated and _may_lack_something(state):
            told = {state.remedy}
            findings += tuple(more for more in lacking(rig.file.devices[name]) if more.remedy not in told)
    return DeviceReport(name, state.kind, state.driver, state.state.value, found, unverified, findings)


def _may_lack_something(state: DeviceState) -> bool:
    """Whether the machine may be to blame: not for a wrong value in the rig file."""
    wrong_value = isinstance(state.error, ConfigurationError) and state.error.location not in ((), ("driver",))
    return state.state in (DeviceCondition.MISSING, DeviceCondition.MISCONFIGURED) and not wrong_value


def _camera(rig: Rig, name: str) -> Found:  # noqa: ARG001 - one form for all
    camera: Camera = rig.camera
    can = camera.capabilities()
    found = {
        "model": f"{can.vendor} {can.model}",
        "serial number": can.serial_number or "not told",
        "sensor": "{} x {} px".format(*can.sensor_size_px),
        "pixel formats": ", ".join(can.pixel_formats),
        "triggers": ", ".join(can.triggers),
        "exposure": _range(can.exposure_range_us, "us"),
        "gain": _range(can.gain_range_db, "dB"),
        "frame rate": _range(can.frame_rate_range_hz, "Hz"),
        "region": "yes" if can.has_region else "no",
        "temperature": f"{camera.temperature_c():.1f} C" if can.has_temperature else "not told",
    }
    return found, can.unverified, ()


def _projector(rig: Rig, name: str) -> Found:  # noqa: ARG001 - one form for all
    projector: Projector = rig.projector
    can, status = projector.capabilities(), projector.status()
    found = {
        "model": can.model,
        "serial number": "not told",
        "size": "{} x {} px".format(*can.size_px),
        "LEDs": ", ".join(can.leds) or "not under software's control",
        "patterns": _patterns(can.can_load, can.pattern_limit),
        "sequences": "on its own clock" if can.self_paced else "paced by this computer",
        "sync output": "yes" if can.has_sync else "no",
        "park": "yes" if can.can_park else "no",
        "condition": status.condition.value,
    }
    faults = tuple(
        Finding(f"it reports {fault}", "let it cool, look at its LEDs, then retry") for fault in status.faults
    )
    return found, can.unverified, faults


def _stage(rig: Rig, name: str) -> Found:
    stage: Stage = rig.stage(name)
    can, limits, state = stage.capabilities(), stage.limits(), stage.state()
    position = "unknown: no zero yet"
    if state.position is not None:
        position = f"{state.position.position_mm:.3f} mm, {'measured' if state.position.measured else 'estimated'}"
    found = {
        "model": can.model,
        "serial number": "not told",
        "speed": _range(can.speed_range_mm_per_s, "mm/s"),
        "homes": "yes" if can.can_home else "no: a person says where it stands",
        "stops": "yes" if can.can_stop else "no: have an emergency switch within reach",
        "tells its position": "yes" if can.reads_position else "no: positions are estimated",
        "tells its limit switches": "yes" if can.reads_limits else "no",
        "soft limits": f"{limits.lower_mm:g} to {limits.upper_mm:g} mm",
        "position": position,
    }
    # Its line can be opened, and that is all: nothing was heard from it, and never will be.
    silent = () if can.reads_position else (f"that a controller is there: {name} never answers; move it and look",)
    return found, (*silent, *can.unverified), ()


_LOOK: dict[str, Callable[[Rig, str], Found]] = {"camera": _camera, "projector": _projector, "stage": _stage}


def _range(limits: tuple[float, float] | None, unit: str) -> str:
    return "not told" if limits is None else f"{limits[0]:g} to {limits[1]:g} {unit}"


def _patterns(can_load: bool, limit: int | None) -> str:
    if not can_load:
        return "in the box's flash"
    return "any number" if limit is None else f"up to {limit}"
