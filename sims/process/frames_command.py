"""Frames of a whole run without the wire: stations, pictures and exposures out of a file, frames as arrays."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from sims.errors import SimulationError
from sims.instruments import Part, Positive, Signed
from sims.process.complaints import complaint
from sims.rig import SimulatedRig

if TYPE_CHECKING:
    from sims.world import World

INDEX = "frames.json"
_TARGET = 0.85
_BRIGHT_PERCENTILE = 99.5


class Scene(Part):
    """What stands in front of the camera (`SimulatedRig.place`), and the room's lamp."""

    subject: str
    pose: int = 0
    glass: bool = True
    lamp: bool = False


class Station(Part):
    """Frames at one place.

    `scene`, `stage1_mm` and `stage2_mm` stay what they were where they are None; a stage that already is where it is
    sent does not move. `pictures` are indices into the patterns, None for black. Without `exposure_us` it is metered
    on the picture `metered_on`, so that the brightest parts reach 85 % of full scale.
    """

    scene: Scene | None = None
    stage1_mm: Signed | None = None
    stage2_mm: Signed | None = None
    light: Literal["infrared", "visible"] = "infrared"
    exposure_us: Positive | None = None
    metered_on: int | None = None
    pictures: tuple[int | None, ...] = Field(min_length=1)


class Request(Part):
    """Stations in order; `patterns` is an .npy file beside the request, uint8 (patterns, rows, columns)."""

    patterns: str
    stations: tuple[Station, ...] = Field(min_length=1)


def write_frames(world: "World", request: Path, out: Path) -> None:
    """Take the frames of a request and write them: one .npy of (pictures, H, W) a station, and `frames.json`.

    The index lists, station by station, the file, the commanded `stage1_mm` and `stage2_mm`, `exposure_us` and `bits`.
    Noise of frames and stages begins with the world's seed: requests of one measurement want different seeds.

    Raises
    ------
    SimulationError
        The request does not hold, asks for what the world has not, or the frames cannot be written.
    """
    wanted = _read(request)
    patterns = _patterns(request.parent / wanted.patterns)
    taker = _Taker(SimulatedRig(world), patterns)
    try:
        out.mkdir(parents=True, exist_ok=True)
        index = []
        for number, station in enumerate(wanted.stations):
            taker.arrange(station)
            name = f"{number:05d}.npy"
            np.save(out / name, taker.frames(station))
            index.append({"file": name, **taker.state})
        (out / INDEX).write_text(json.dumps({"seed": world.seed, "stations": index}))
    except OSError as error:
        raise SimulationError(f"{out} cannot be written: {error}") from None


def _read(path: Path) -> Request:
    try:
        return Request.model_validate_json(path.read_bytes())
    except OSError as error:
        raise SimulationError(f"{path} cannot be read: {error}") from None
    except ValidationError as error:
        raise SimulationError(f"{path}: {complaint(error)}") from None


def _patterns(path: Path) -> NDArray[np.uint8]:
    try:
        patterns: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise SimulationError(f"patterns {path} cannot be read: {error}") from None
    if patterns.ndim != 3 or patterns.dtype != np.uint8:
        raise SimulationError(
            f"patterns {path} are {patterns.dtype} of shape {patterns.shape}, not uint8 of (patterns, rows, columns)"
        )
    return patterns


class _Taker:
    """A rig, and where it was sent."""

    def __init__(self, rig: SimulatedRig, patterns: NDArray[np.uint8]) -> None:
        self._rig = rig
        self._patterns = patterns
        self._at_mm = {"stage1": 0.0, "stage2": 0.0}
        self._exposure_us = rig.world.camera.exposure_us

    @property
    def state(self) -> dict[str, float]:
        """What a lab would know of the last frames."""
        positions = {f"{name}_mm": value for name, value in self._at_mm.items()}
        return {**positions, "exposure_us": self._exposure_us, "bits": self._rig.world.camera.bits}

    def arrange(self, station: Station) -> None:
        """Put everything where a station wants it."""
        rig, scene = self._rig, station.scene
        if scene is not None:
            rig.place(scene.subject, pose=scene.pose)
            rig.set_glass(scene.glass)
            rig.set_lamp(scene.lamp)
        for name, target in (("stage1", station.stage1_mm), ("stage2", station.stage2_mm)):
            if target is not None and target != self._at_mm[name]:
                getattr(rig, f"move_{name}")(target)
                self._at_mm[name] = target
        rig.set_light(station.light)
        self._expose(self._rig.world.camera.exposure_us if station.exposure_us is None else station.exposure_us)
        if station.exposure_us is None:
            self._meter(station.metered_on)

    def frames(self, station: Station) -> NDArray[Any]:
        """Take the frames of a station, (pictures, H, W)."""
        return np.stack([self._frame(picture) for picture in station.pictures])

    def _meter(self, picture: int | None) -> None:
        full_scale = 2**self._rig.world.camera.bits - 1
        while (bright := float(np.percentile(self._frame(picture), _BRIGHT_PERCENTILE))) >= full_scale:
            self._expose(self._exposure_us / 4)
        self._expose(self._exposure_us * _TARGET * full_scale / max(bright, 1.0))

    def _expose(self, exposure_us: float) -> None:
        self._exposure_us = exposure_us
        self._rig.set_exposure(exposure_us)

    def _frame(self, picture: int | None) -> NDArray[Any]:
        if picture is not None and not 0 <= picture < len(self._patterns):
            raise SimulationError(f"there is no picture {picture}: the request has {len(self._patterns)} patterns")
        self._rig.show(None if picture is None else np.asarray(self._patterns[picture]))
        return self._rig.capture()
