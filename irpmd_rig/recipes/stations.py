"""What a plan is made of: frozen values that say, station by station, what the rig does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Role = Literal["fringes", "white", "black", "plain", "switched", "series"]
Orientation = Literal["x", "y"]
Location = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Scene:
    """What stands in front of the camera.

    Attributes
    ----------
    subject : str
        What is on the object support or on stage2: ``board``, ``board_on_plate``, ``plate``, ``mirror``, ``nothing``,
        or the name of an object.
    pose : int
        Which pose of the board, from 0.
    glass : bool
        Whether the ground glass is in place.
    lamp : bool
        Whether the room's lamp lights the scene.
    turn_deg : tuple of float or None
        By how much the ground glass is to be turned by its screws, about x and about y, from where it is.
    """

    subject: str
    pose: int = 0
    glass: bool = True
    lamp: bool = False
    turn_deg: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Prompt:
    """What a person is asked before a station.

    Attributes
    ----------
    text : str
        What to do.
    scene : Scene or None
        What the rig then looks like, for an operator who is a program; None: only a person can answer.
    """

    text: str
    scene: Scene | None = None


@dataclass(frozen=True, slots=True)
class Shot:
    """Frames taken in one go.

    Attributes
    ----------
    role : str
        ``fringes``: all sets and steps; ``white``, ``black``: one frame of a uniform picture; ``plain``: one frame with
        the projector dark; ``switched``: one frame a time after the order to go from black to white; ``series``: frames
        of the first of the fringes, one after the other, from the moment at which the stage has arrived.
    label : str
        What the frames are for, e.g. ``plate``: processing finds them by it.
    counts : tuple of float
        Fringe counts (periods across the projector), one set each; empty but for fringes.
    steps : int
        Phase steps of each set; 0 but for fringes.
    orientation : str
        ``x``: the phase grows along the projector's columns; ``y``: along its rows.
    view : int or None
        Number of the view (a board's pose, an exposure, a delay); None where there is only one.
    repeats : int
        Number of frames of a series.
    delay_s : float
        Of a switched picture: when its frame is taken.
    """

    role: Role
    label: str
    counts: tuple[float, ...] = ()
    steps: int = 0
    orientation: Orientation = "x"
    view: int | None = None
    repeats: int = 1
    delay_s: float = 0.0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.counts) * self.steps if self.role == "fringes" else self.repeats


@dataclass(frozen=True, slots=True)
class Station:
    """All frames at one place, in this order: prompt, motion, settling, exposure, shots.

    Attributes
    ----------
    index : int
        Its number in the plan, from 0.
    label : str
        What it is for, as its shots say.
    prompt : Prompt or None
        What a person does first.
    stage1_mm, stage2_mm : float or None
        Where the stages stand (s; 0 = reference position, + = away from the glass); None: wherever they are.
    exposure_us : float or "auto"
        Exposure time; ``auto``: measured here so that nothing saturates.
    lit : bool
        Whether the projector's light is on; False for shots with a dark projector.
    shots : tuple of Shot
        What is taken.
    wait_s : float
        Time to wait after the motion, beside the stage's own settle time.
    settle : str
        ``timed``: wait_s is all; ``measured``: go on only when two successive frames differ by no more than noise.
    source : tuple
        Path of keys and indices in the recipe that asked for it, for messages.
    decides : bool
        Whether what is computed from the frames so far decides if the run goes on, and what is asked before it does.
    """

    index: int
    label: str
    prompt: Prompt | None
    stage1_mm: float | None
    stage2_mm: float | None
    exposure_us: float | Literal["auto"]
    lit: bool
    shots: tuple[Shot, ...]
    wait_s: float = 0.0
    settle: Literal["timed", "measured"] = "timed"
    source: Location = ()
    decides: bool = False

    @property
    def frames(self) -> int:
        """Number of frames, exposures that are only tried not counted."""
        return sum(shot.frames for shot in self.shots)


@dataclass(frozen=True, slots=True)
class Plan:
    """What a recipe makes the rig do.

    Attributes
    ----------
    stations : tuple of Station
        In order; at least one.
    """

    stations: tuple[Station, ...]

    @property
    def frames(self) -> int:
        """Number of frames that are kept."""
        return sum(station.frames for station in self.stations)

    @property
    def steered(self) -> bool:
        """Whether its own results decide how it goes on."""
        return any(station.decides for station in self.stations)

    @property
    def needs_operator(self) -> bool:
        """Whether a person, or a program in his place, is asked anything."""
        return any(station.prompt is not None for station in self.stations)

    def prompt_in_force(self, index: int) -> Prompt | None:
        """Last prompt that set a scene at or before a station: what must be true when a run goes on from there."""
        prompts = [station.prompt for station in self.stations[: index + 1] if station.prompt is not None]
        scenes = [prompt for prompt in prompts if prompt.scene is not None]
        return scenes[-1] if scenes else prompts[-1] if prompts else None
