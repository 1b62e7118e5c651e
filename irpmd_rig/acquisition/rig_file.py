"""Rig files: which instruments a rig has, how each is reached, and what it stands on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field, create_model

from drivers.errors import ConfigurationError
from drivers.registry import Kind, driver_class, make
from drivers.values import LED_INTENSITY_LIMIT, Led
from irpmd_rig.core import Drawing
from irpmd_rig.recipes.document import (
    Document,
    DocumentError,
    Problem,
    Settings,
    check_document,
    complaint,
    parse_document,
    problem_at,
)
from irpmd_rig.shipped import rig_file as found_rig_file

KINDS: dict[str, Kind] = {"camera": "camera", "projector": "projector", "stage1": "stage", "stage2": "stage"}

# What a running world fills in, by kind; the values stand for it while the rest is checked.
_PENDING: dict[Kind, dict[str, Any]] = {
    "camera": {"producer": "pending.cti"},
    "projector": {"backend": "pending:pending", "backend_argument": "pending", "sequences": ("pending.bf",)},
    "stage": {
        "port": "pending",
        "limits_mm": (0.0, 1.0),
        "counts_per_mm": 1000.0,
        "home_position_mm": 0.0,
        "sign": 1,
    },
}
# Keys whose values name something that can be looked up before a world runs.
_NAMES = ("dialect", "profile", "library")
_PATH_KEYS = ("producer", "library", "sequences", "profile", "dialect")
_PATH_SUFFIXES = (".yaml", ".yml", ".cti", ".bf")

Pair = tuple[float, float]


class Simulation(Settings):
    """How the simulated world of a rig file is run.

    Attributes
    ----------
    time_scale
        How much faster than the real clock its clock runs; None: 1, or what a running world has.
    replay
        Frames of one rehearsal are shown again: for measuring speed, never accuracy.
    seed, size_px
        Of the noise, and pixels along a side of the camera; None: as the world file says.
    stages
        What the controllers of the stages speak; None: gsc.
    folder
        Folder of the running world to use; None: where `irpmd-rig sim` puts it.
    private
        Start a world for this rig alone, whatever runs.
    """

    time_scale: Annotated[float, Field(gt=0, le=1000)] | None = None
    replay: bool | None = None
    seed: Annotated[int, Field(ge=0)] | None = None
    size_px: Annotated[int, Field(ge=64, le=8192)] | None = None
    stages: Literal["gsc", "gcd-0301m", "gcd-040101m"] | None = None
    folder: Annotated[Path, Field(strict=False)] | None = None
    private: bool = False


class Light(Settings):
    """The light that is measured in: an LED and its intensity as a fraction of the full drive."""

    led: Annotated[Led, Field(strict=False)] = Led.INFRARED
    intensity: Annotated[float, Field(gt=0, le=LED_INTENSITY_LIMIT)] = LED_INTENSITY_LIMIT


class DrawingPlaces(Settings):
    """What is read off the drawing of the rig: see `irpmd_rig.core.Drawing`."""

    camera_xy_mm: Pair
    heading: Pair
    d_point_mm: Pair


class Checkerboard(Settings):
    """The board that the camera is calibrated with: squares along both sides, and their size."""

    squares: tuple[Annotated[int, Field(ge=3, le=100)], Annotated[int, Field(ge=3, le=100)]]
    square_mm: Annotated[float, Field(gt=0)]


class Storage(Settings):
    """Where runs are kept.

    Attributes
    ----------
    root
        Folder of the runs; a relative one lies in the folder in which the program is started.
    reserve_gb
        Space that a run must leave free.
    retention_days
        Ended runs that are older are deleted; None: none ever.
    """

    root: Annotated[Path, Field(strict=False)] = Path("data")
    reserve_gb: Annotated[float, Field(ge=0)] = 2.0
    retention_days: Annotated[int, Field(ge=1)] | None = None


class Service(Settings):
    """Where the daemon listens; allowed_hosts: names by which it may be called besides the loopback's."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8321
    allowed_hosts: tuple[str, ...] = ()


class CalibrationLimits(Settings):
    """What calibrations are taken for.

    Attributes
    ----------
    max_age_days
        How old one may be to be used; None: as old as it is.
    blur_px
        RMS width of the blur in the camera's pictures: curved mirrors are corrected for it.
    """

    max_age_days: Annotated[float, Field(gt=0)] | None = None
    blur_px: Annotated[float, Field(ge=0, le=10)] = 0.7


class _Entry(BaseModel):
    """An instrument before its driver's own settings are looked at."""

    driver: str


class _Rig(Settings):
    """A rig file but for its instruments."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    world: str | None = None
    simulation: Simulation = Simulation()
    light: Light = Light()
    trigger: Literal["hardware", "software"] = "hardware"
    drawing: DrawingPlaces | None = None
    checkerboard: Checkerboard | None = None
    storage: Storage = Storage()
    service: Service = Service()
    calibration: CalibrationLimits = CalibrationLimits()


@dataclass(frozen=True, slots=True)
class Device:
    """One instrument of a rig file: what makes its driver (`drivers.registry.make`)."""

    name: str
    kind: Kind
    driver: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RigFile:
    """A rig file, checked; paths in it are resolved.

    Attributes
    ----------
    document
        The file as read, with the places of its values.
    world
        File of the simulated world, if it has one; then `drawing`, `checkerboard` and some settings of the
        instruments may be missing until a world is attached.
    devices
        By name: camera, projector, stage1 and, if there is one, stage2.
    light, trigger
        What recipes use that do not say otherwise.
    drawing, checkerboard
        What calibrations need; None: recipes that need it are refused.
    """

    document: Document
    name: str
    devices: Mapping[str, Device]
    world: Path | None
    simulation: Simulation
    light: Light
    trigger: Literal["hardware", "software"]
    drawing: Drawing | None
    checkerboard: Checkerboard | None
    storage: Storage
    service: Service
    calibration: CalibrationLimits

    def with_simulation(self, **changes: Any) -> RigFile:
        """Return it with other values of `simulation`, by their names in the rig file."""
        changed = self.simulation.model_dump() | changes
        return replace(self, simulation=Simulation.model_validate(changed))

    def problem(self, error: ConfigurationError) -> Problem:
        """Say where in the file the setting is that a driver complains about."""
        return _placed(self.document, error)


def read_rig(path: str | Path, *, deep: bool = True) -> RigFile:
    """Read a rig file, or the shipped one of that name.

    Parameters
    ----------
    path
        Path of the file, or name of a shipped one.
    deep
        Make the drivers, too (no device is touched), so that a dialect, profile or sequence file that cannot be
        used is found. Without, each instrument tells that when it is opened.

    Raises
    ------
    FileNotFoundError
        There is neither such a file nor a shipped one.
    DocumentError
        All that is wrong, each with file, line, column and remedy.
    """
    file = found_rig_file(str(path))
    document = parse_document(file)
    complete = _with_pending(document) if _simulated(document) else document
    problems: list[Problem] = []
    checked: _Rig | None = None
    try:
        checked = check_document(complete, _model(complete))
    except DocumentError as error:
        problems += error.problems
    devices = _devices(document, file)
    problems += _world_problems(document, file)
    if deep:
        problems += _made(document, devices, only_named=checked is None)
    if problems or checked is None:
        raise DocumentError(problems)
    folder, places = checked.simulation.folder, checked.drawing
    return RigFile(
        document=document,
        name=checked.name,
        devices=devices,
        world=None if checked.world is None else _world(checked.world, file),
        simulation=checked.simulation.model_copy(update={"folder": folder and (file.parent / folder).resolve()}),
        light=checked.light,
        trigger=checked.trigger,
        drawing=Drawing(**places.model_dump()) if places else None,
        checkerboard=checked.checkerboard,
        storage=checked.storage,
        service=checked.service,
        calibration=checked.calibration,
    )


def _simulated(document: Document) -> bool:
    return document.values.get("world") is not None


def _world(written: str, file: Path) -> Path:
    return (file.parent / Path(written).expanduser()).resolve()


def _placed(document: Document, error: ConfigurationError) -> Problem:
    location = (error.device, *error.location) if error.device in KINDS else error.location
    return problem_at(document, location, f"{error.device}: {error.what}", error.remedy)


def _world_problems(document: Document, file: Path) -> Iterable[Problem]:
    written = document.values.get("world")
    if isinstance(written, str) and not _world(written, file).is_file():
        what = f"there is no world file {_world(written, file)}"
        yield problem_at(document, ("world",), what, "correct the path: it is relative to the rig file")
    if written is None and "simulation" in document.values:
        what = "'simulation' is there without a 'world'"
        yield problem_at(document, ("simulation",), what, "add world, or take simulation away")


def _with_pending(document: Document) -> Document:
    """Put stand-ins for what a world fills in where the file says nothing."""
    values = dict(document.values)
    for name, kind in KINDS.items():
        entry = values.get(name)
        if isinstance(entry, dict) and isinstance(entry.get("driver"), str):
            try:
                pending = _pending(kind, entry["driver"], entry)
            except ConfigurationError:
                continue
            values[name] = pending | entry
    return replace(document, values=values)


def _pending(kind: Kind, driver: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Stand-ins for the settings that this driver takes, that a world fills in, and that are not given."""
    fields = driver_class(kind, driver, device=kind).Settings.model_fields
    return {
        key: value
        for key, value in _PENDING[kind].items()
        if key in fields and key not in entry and not is_idle(key, entry)
    }


def is_idle(key: str, entry: Mapping[str, Any]) -> bool:
    """Whether a projector's setting has no place beside what else is set."""
    by_library = entry.get("transport", "usb") != "usb"
    return (key == "sequences" and entry.get("video") is not None) or (key.startswith("backend") and by_library)


def _model(document: Document) -> type[_Rig]:
    """Model of this rig file: with the settings of the drivers that it names."""
    instruments: dict[str, Any] = {}
    for name, kind in KINDS.items():
        entry = _entry_model(document, name, kind)
        instruments[name] = (entry, ...) if name != "stage2" else (entry | None, None)
    return create_model("RigDocument", __base__=_Rig, **instruments)


def _entry_model(document: Document, name: str, kind: Kind) -> type[BaseModel]:
    entry = document.values.get(name)
    driver = entry.get("driver") if isinstance(entry, dict) else None
    if not isinstance(driver, str):
        return _Entry
    try:
        settings = driver_class(kind, driver, device=name).Settings
    except ConfigurationError:
        # The registry's own complaint, once: `driver` is refused, and nothing else can be judged.
        return create_model(
            f"{name}Settings", __base__=_Entry, driver=(Annotated[str, AfterValidator(_refuse(name, kind))], ...)
        )
    return create_model(f"{name}Settings", __base__=settings, driver=(str, ...))


def _refuse(name: str, kind: Kind) -> Callable[[str], str]:
    def refuse(driver: str) -> str:
        try:
            driver_class(kind, driver, device=name)
        except ConfigurationError as error:
            raise complaint(f"{name}: {error.what}", error.remedy) from None
        return driver

    return refuse


def _devices(document: Document, file: Path) -> dict[str, Device]:
    """Instruments of the file, as far as they are written well enough to have a driver."""
    devices = {}
    for name, kind in KINDS.items():
        entry = document.values.get(name)
        if isinstance(entry, dict) and isinstance(entry.get("driver"), str):
            settings = {key: _resolved(key, value, file.parent) for key, value in entry.items() if key != "driver"}
            devices[name] = Device(name, kind, entry["driver"], settings)
    return devices


def _resolved(key: str, value: Any, folder: Path) -> Any:
    """Take a path in a driver's settings as relative to the rig file."""
    if key not in _PATH_KEYS:
        return value
    if isinstance(value, tuple):
        return tuple(_resolved(key, item, folder) for item in value)
    if not isinstance(value, str) or not ("/" in value or value.endswith(_PATH_SUFFIXES)):
        return value
    return str(folder / Path(value).expanduser())


def _made(document: Document, devices: Mapping[str, Device], *, only_named: bool) -> Iterable[Problem]:
    """Make every driver, and tell what each complains about; only_named: the model has refused something already."""
    for device in devices.values():
        pending: dict[str, Any] = {}
        try:
            if _simulated(document):
                pending = _pending(device.kind, device.driver, device.settings)
            make(device.kind, device.driver, device.name, pending | dict(device.settings))
        except ConfigurationError as error:
            # With stand-ins only what is named can be judged; a world tells the rest.
            named = bool(error.location) and error.location[0] in _NAMES
            if named or not (pending or only_named):
                yield _placed(document, error)
