"""Maps the `driver:` of a rig file to a driver class; entry points add those of third parties.

A distribution adds a driver by an entry point in the group ``irpmd_rig.drivers`` whose name is the kind and
the driver's name, for example::

    [project.entry-points."irpmd_rig.drivers"]
    "camera.mycamera" = "mypackage.camera:MyCamera"

A driver class has ``Settings``, a pydantic model, and is made by ``Class(name, settings)``.
"""

import importlib
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, Protocol, overload

from pydantic import BaseModel

from drivers.errors import ConfigurationError
from drivers.protocols import Camera, Instrument, Projector, Stage
from drivers.settings import checked, nearest

ENTRY_POINT_GROUP = "irpmd_rig.drivers"

Kind = Literal["camera", "projector", "stage"]

_PROTOCOLS: dict[Kind, type] = {"camera": Camera, "projector": Projector, "stage": Stage}

# Named, not imported: a driver's libraries are needed only where it is used.
_BUILT_IN = {
    "camera.harvesters": "drivers.camera.camera:HarvestersCamera",
    "camera.aravis": "drivers.camera.aravis_backend:AravisCamera",
    "projector.video": "drivers.projector.video:VideoProjector",
    "projector.lightcommander": "drivers.projector.lightcommander:LightCommander",
    "projector.dlpc350": "drivers.projector.dlpc350:Dlpc350",
    "stage.serial": "drivers.stage.engine:SerialStage",
}


class DriverClass(Protocol):
    """What a driver's name stands for."""

    Settings: type[BaseModel]

    def __call__(self, name: str, settings: Any) -> Instrument:
        """Make the driver of the instrument `name`; touches no device."""


def driver_names(kind: Kind) -> tuple[str, ...]:
    """Names that a rig file may give as `driver:` of a camera, projector or stage."""
    prefix = f"{kind}."
    names = {*_BUILT_IN, *(entry.name for entry in entry_points(group=ENTRY_POINT_GROUP))}
    return tuple(sorted(name.removeprefix(prefix) for name in names if name.startswith(prefix)))


def driver_class(kind: Kind, driver: str, *, device: str) -> DriverClass:
    """Load the class that a driver's name stands for.

    Raises
    ------
    ConfigurationError
        No such driver, two of that name, or a library that it needs is missing.
    """
    full_name = f"{kind}.{driver}"
    found = [entry for entry in entry_points(group=ENTRY_POINT_GROUP) if entry.name == full_name]
    if full_name in _BUILT_IN:
        found.append(EntryPoint(full_name, _BUILT_IN[full_name], ENTRY_POINT_GROUP))
    if not found:
        raise ConfigurationError(
            device, f"there is no {kind} driver {driver!r}", nearest(driver, driver_names(kind)), ("driver",)
        )
    if len({entry.value for entry in found}) > 1:
        raise ConfigurationError(
            device,
            f"several packages offer the {kind} driver {driver!r}: "
            + ", ".join(sorted(entry.value for entry in found)),
            "uninstall all but one",
            ("driver",),
        )
    return _load(found[0], device)


@overload
def make(kind: Literal["camera"], driver: str, name: str, values: Mapping[str, Any]) -> Camera: ...  # pragma: no cover
@overload
def make(
    kind: Literal["projector"], driver: str, name: str, values: Mapping[str, Any]
) -> Projector: ...  # pragma: no cover
@overload
def make(kind: Literal["stage"], driver: str, name: str, values: Mapping[str, Any]) -> Stage: ...  # pragma: no cover
def make(kind: Kind, driver: str, name: str, values: Mapping[str, Any]) -> Instrument:
    """Make one instrument of a rig file; nothing is opened.

    Parameters
    ----------
    kind, driver
        What it is and the `driver:` of the rig file.
    name
        Its name in the rig file.
    values
        Its settings, as plain values.

    Raises
    ------
    ConfigurationError
        No such driver, settings that it does not take, or a third party's driver that lacks an operation.
    """
    found = driver_class(kind, driver, device=name)
    instrument: Instrument = found(name, checked(found.Settings, values, device=name))
    if not isinstance(instrument, _PROTOCOLS[kind]):
        raise ConfigurationError(
            name,
            f"the driver {driver!r} is no {kind}: it lacks {', '.join(_lacking(instrument, kind))}",
            "update the package that it comes from",
            ("driver",),
        )
    return instrument


def _load(entry: EntryPoint, device: str) -> DriverClass:
    try:
        found: DriverClass = getattr(importlib.import_module(entry.module), entry.attr)
    except (ImportError, AttributeError) as error:
        package = getattr(error, "name", None)
        remedy = f"install what provides the module {package!r}" if package else "reinstall its package"
        raise ConfigurationError(
            device, f"the driver {entry.value} cannot be loaded: {error}", remedy, ("driver",)
        ) from error
    if not callable(found) or not isinstance(getattr(found, "Settings", None), type):
        raise ConfigurationError(
            device,
            f"the driver {entry.value} is no driver class",
            "it must be a class with `Settings`, a pydantic model",
            ("driver",),
        )
    return found


def _lacking(instrument: object, kind: Kind) -> list[str]:
    operations = [name for name in dir(_PROTOCOLS[kind]) if not name.startswith("_")]
    return [name for name in operations if not hasattr(instrument, name)]
