"""What the camera sees: projector, stages, lamp and subject at the time of an exposure, made into a frame.

Everything is looked up for the time of the exposure, not for the time at which somebody asks: threads are late,
above all where the world's clock is fast.
"""

import threading
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sims.boards import board_pose
from sims.errors import SimulationError
from sims.maps import LightMaps
from sims.process.pictures import Pictures
from sims.process.replay import Image, Recording
from sims.projector.player import Player
from sims.render import exposure, render
from sims.setup import Setup, turned_glass
from sims.surfaces import SUBJECTS

if TYPE_CHECKING:
    from sims.clock import WorldClock
    from sims.world import World

# The level of an LED at which the projector has the radiant intensity of the world file.
NOMINAL_LEVEL = 0.60
INFRARED = "infrared"
_REMEMBERED = 256
# Positions and weights that make no other frame of a rehearsal.
_REPLAY_PARTS_A_MM = 100
_REPLAY_DIGITS = 3


@dataclass(frozen=True, slots=True)
class Subject:
    """What people put in place, how they turned the glass, whether the lamp is on; `pose` is the free board's."""

    name: str = "mirror"
    pose: int = 0
    glass: bool = True
    lamp: bool = False
    glass_turn_deg: tuple[float, float] = (0.0, 0.0)


class Places(NamedTuple):
    """Where the stages' carriages are, in mm of their axes."""

    stage1_mm: float
    stage2_mm: float


@dataclass(frozen=True, slots=True)
class _Part:
    """A picture's share in an exposure: its length times its level, both relative to nominal."""

    weight: float
    image: NDArray[np.uint8] | None


class Physics:
    """Renders what a camera that exposes at some time sees.

    Parameters
    ----------
    world : World
    clock : WorldClock
        The clock that all instruments live by.
    player : Player
        What the projector shows.
    places : callable
        Where the stages were at a time.
    replay : bool
        Give a frame that was rendered once back instead of rendering it again: its noise is then the same, too.
    """

    def __init__(
        self,
        world: "World",
        clock: "WorldClock",
        player: Player,
        places: Callable[[float], Places],
        *,
        replay: bool = False,
    ) -> None:
        self.world = world
        self._clock, self._player, self._places = clock, player, places
        self._lock = threading.Lock()
        self._times: list[float] = [float("-inf")]
        self._subjects: list[Subject] = [Subject()]
        self._frames = 0
        self._maps = LightMaps(world)
        self._pictures = Pictures(world.projector)
        self._recording = Recording() if replay else None

    @property
    def subject(self) -> Subject:
        """What is in place now."""
        return self._subjects[-1]

    def place(self, name: str, pose: int = 0) -> None:
        """Put a subject in front of the camera (`sims.rig.SimulatedRig.place`).

        Raises
        ------
        SimulationError
            The world has no such subject or pose.
        WorldError
            The board's ranges leave no room for this pose in the image.
        """
        known = (*SUBJECTS, *self.world.objects)
        if name not in known:
            raise SimulationError(f"there is no subject {name!r}: this world has {', '.join(known)}")
        poses = self.world.board.poses if name == "board" else 1
        if not 0 <= pose < poses:
            raise SimulationError(f"{name!r} has poses 0 to {poses - 1}, not {pose}")
        if name == "board":
            board_pose(self.world, pose)
        self._change(name=name, pose=pose)

    def set_glass(self, present: bool) -> None:
        """Put the ground glass in or take it away."""
        self._change(glass=present)

    def turn_glass(self, about_x_deg: float, about_y_deg: float) -> None:
        """Turn the ground glass by its screws (`sims.rig.SimulatedRig.turn_glass`); raises SimulationError."""
        self._change(glass_turn_deg=turned_glass(self.subject.glass_turn_deg, about_x_deg, about_y_deg))

    def set_lamp(self, on: bool) -> None:
        """Turn the flood light on or off."""
        self._change(lamp=on)

    def expose(self, start_s: float, exposure_us: float, bits: int) -> Callable[[], Image]:
        """Take note of an exposure; what is returned makes its frame once it is over (one at a time)."""
        frame = self._frames
        self._frames += 1
        return lambda: self._develop(frame, start_s, exposure_us, bits)

    def _change(self, **what: object) -> None:
        with self._lock:
            self._times.append(self._clock.now())
            self._subjects.append(replace(self._subjects[-1], **what))  # type: ignore[arg-type]
            del self._times[:-_REMEMBERED], self._subjects[:-_REMEMBERED]

    def _subject_at(self, time_s: float) -> Subject:
        with self._lock:
            return self._subjects[max(bisect_right(self._times, time_s) - 1, 0)]

    def _develop(self, frame: int, start_s: float, exposure_us: float, bits: int) -> Image:
        end_s = start_s + exposure_us * 1e-6
        # A stage that moves is seen where it is half way: motion is not blurred.
        middle_s = (start_s + end_s) / 2
        subject, places = self._subject_at(middle_s), self._places(middle_s)
        # The filter is changed with the LED; light of the other band does not reach the sensor.
        infrared = INFRARED in (self._player.lit_last(end_s) or INFRARED).split("+")
        parts = self._parts(start_s, end_s, infrared=infrared)

        def rendered() -> Image:
            setup = Setup(
                subject.name,
                subject.pose,
                subject.glass,
                places.stage1_mm * (1 + self.world.stage1.scale_error_ppm * 1e-6),
                places.stage2_mm,
                subject.glass_turn_deg,
            )
            light = self.world.lights.infrared if infrared else self.world.lights.visible
            shot = exposure(self.world, light, exposure_us=exposure_us, bits=bits, lamp=subject.lamp, frame=frame)
            picture, weight = self._mixed(parts)
            shot = replace(shot, projector_e=shot.projector_e * weight)
            frame_seen: Image = render(self.world.camera, picture, self._maps.of(setup), shot)
            return frame_seen

        if self._recording is None:
            return rendered()
        shown = tuple((self._pictures.digest(part.image), round(part.weight, _REPLAY_DIGITS)) for part in parts)
        at = tuple(round(place_mm * _REPLAY_PARTS_A_MM) for place_mm in places)
        return self._recording.frame((subject, at, infrared, shown, exposure_us, bits), rendered)

    def _parts(self, start_s: float, end_s: float, *, infrared: bool) -> list[_Part]:
        """Return the pictures that lit an exposure, each once."""
        weights: dict[str, _Part] = {}
        for from_s, to_s, shown in self._player.intervals(start_s, end_s):
            if shown.level <= 0 or (INFRARED in shown.led.split("+")) != infrared:
                continue
            weight = (to_s - from_s) / (end_s - start_s) * shown.level / NOMINAL_LEVEL
            digest = self._pictures.digest(shown.image)
            before = weights[digest].weight if digest in weights else 0.0
            weights[digest] = _Part(before + weight, shown.image)
        return list(weights.values())

    def _mixed(self, parts: list[_Part]) -> tuple[NDArray[np.float32], float]:
        """Return the mean light of some pictures and its weight."""
        if not parts:
            return self._pictures.light(None), 0.0
        whole = sum(part.weight for part in parts)
        if len(parts) == 1:
            return self._pictures.light(parts[0].image), whole
        mean = sum(np.float32(part.weight / whole) * self._pictures.light(part.image) for part in parts)
        return np.asarray(mean, np.float32), whole
