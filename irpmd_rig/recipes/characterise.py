"""Recipes that find out what the instruments do: one class for each thing that can be characterised."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field

from irpmd_rig.recipes.base import RecipeBase
from irpmd_rig.recipes.document import complaint
from irpmd_rig.recipes.fields import Fringes, Name, PositionsMm, RunId


def _rising(values: tuple[float, ...]) -> tuple[float, ...]:
    for index, (one, next_one) in enumerate(pairwise(values), 1):
        if next_one <= one:
            raise complaint(f"is {next_one:g} after {one:g}", "give them in rising order", (index,))
    return values


class Characterise(RecipeBase):
    """Something that is characterised; ``what`` tells which of the classes below a recipe is.

    Attributes
    ----------
    kind : str
        ``characterise``.
    what : str
        ``gamma``, ``delay``, ``settle``, ``stage-axis``, ``focus`` or ``exposure``.
    """

    # What else there may be is for the class of `what` to say.
    model_config = ConfigDict(extra="ignore")

    kind: Literal["characterise"]
    what: Literal["gamma", "delay", "settle", "stage-axis", "focus", "exposure"]


class _OfObject(Characterise):
    """What is seen while something is characterised.

    Attributes
    ----------
    object : str
        What stands on the object support: ``mirror``, or anything that sends the projector's light to the camera.
    """

    model_config = ConfigDict(extra="forbid")

    object: Name = "mirror"


class CharacteriseGamma(_OfObject):
    """Light of the projector against the level that it is told, and the table of levels that makes it linear.

    Attributes
    ----------
    fringes : mapping
        Few and wide fringes in many steps, 12 at least: every pixel then sees most levels, and blur changes none.
    """

    what: Literal["gamma"]
    fringes: Fringes = Fringes(counts=(8.0, 7.0), steps=24)


class CharacteriseDelay(_OfObject):
    """Time from the order to show a picture until all of its light is there.

    Attributes
    ----------
    delays_ms : list of float
        How long after the order from black to white a frame is taken, in milliseconds, rising: 3 to 100 of 0 to 5000.
        The last must be long enough for any display.
    """

    what: Literal["delay"]
    delays_ms: Annotated[
        tuple[Annotated[float, Field(ge=0, le=5000)], ...],
        Field(min_length=3, max_length=100),
        AfterValidator(_rising),
    ] = (0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0, 200.0, 300.0)


class CharacteriseSettle(_OfObject):
    """How long stage1 still moves after its controller says that a motion has ended.

    Attributes
    ----------
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`) by which small movements are seen.
    positions_mm : list of float
        Where the motion begins and where it ends, in millimetres, of stage1.
    frames : int
        Frames taken one after the other once the motion has ended, 10 to 100.
    still_um : float
        Movement, in micrometres, that counts as rest; 0.01 to 1000.
    """

    what: Literal["settle"]
    fringes: Fringes = Fringes()
    positions_mm: Annotated[PositionsMm, Field(min_length=2, max_length=2)] = (20.0, 0.0)
    frames: Annotated[int, Field(ge=10, le=100)] = 60
    still_um: Annotated[float, Field(ge=0.01, le=1000)] = 1.0


class CharacteriseStageAxis(Characterise):
    """Direction and scale of stage1 in frame M, from phases at several of its positions.

    Attributes
    ----------
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`); along y, too, or the direction across is hardly seen.
    positions_mm : list of float
        Positions s of stage1 in millimetres, 2 to 20, one of them 0: where the geometry was calibrated.
    calibration : str
        The calibration of the geometry to use: the id of a run, or ``active``.
    """

    model_config = ConfigDict(extra="forbid")

    what: Literal["stage-axis"]
    fringes: Fringes = Fringes(orientations=("x", "y"))
    positions_mm: Annotated[PositionsMm, Field(min_length=2, max_length=20)] = (0.0, -40.0, -80.0, 40.0)
    calibration: RunId = "active"


class CharacteriseFocus(_OfObject):
    """Contrast of fine fringes against wide ones: how sharp projector and camera are, and where.

    Attributes
    ----------
    counts : list of float
        Periods across the projector's width, rising: 2 to 8 of them, above 0 and at most 512.
    steps : int
        Phase steps of each, 4 to 32.
    """

    what: Literal["focus"]
    counts: Annotated[
        tuple[Annotated[float, Field(gt=0, le=512)], ...], Field(min_length=2, max_length=8), AfterValidator(_rising)
    ] = (16.0, 32.0, 64.0, 128.0)
    steps: Annotated[int, Field(ge=4, le=32)] = 8


class CharacteriseExposure(_OfObject):
    """Brightness against exposure time: what saturates, whether the camera is linear, and its noise.

    Attributes
    ----------
    exposures_us : list of float
        Exposure times in microseconds, rising: 3 to 30 of them, above 0 and at most 10 000 000. At each two frames are
        taken.
    """

    what: Literal["exposure"]
    exposures_us: Annotated[
        tuple[Annotated[float, Field(gt=0, le=10_000_000)], ...],
        Field(min_length=3, max_length=30),
        AfterValidator(_rising),
    ] = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)


Characterised = (
    CharacteriseGamma
    | CharacteriseDelay
    | CharacteriseSettle
    | CharacteriseStageAxis
    | CharacteriseFocus
    | CharacteriseExposure
)

CHARACTERISED: dict[str, type[Characterised]] = {
    "gamma": CharacteriseGamma,
    "delay": CharacteriseDelay,
    "settle": CharacteriseSettle,
    "stage-axis": CharacteriseStageAxis,
    "focus": CharacteriseFocus,
    "exposure": CharacteriseExposure,
}
