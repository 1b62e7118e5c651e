"""Recipes as models: one class a kind; what a person writes in YAML, every field with its unit."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from irpmd_rig.recipes.document import Settings, complaint
from irpmd_rig.recipes.fields import ExposureUs, Fringes, Light, Millimetres, Name, PositionsMm, RunId, Settle
from irpmd_rig.recipes.steps import Capture, Step

Positions = Annotated[PositionsMm, Field(min_length=2, max_length=20)]
PlatePositions = Annotated[PositionsMm, Field(min_length=4, max_length=200)]


class RecipeBase(Settings):
    """What every recipe may say.

    Attributes
    ----------
    name : str
        What the run is called: one line, at most 100 characters.
    operator : str or None
        Who runs it.
    sample : str or None
        Id of the sample.
    notes : str
        Anything worth keeping, several lines if wanted; at most 5000 characters.
    nominal_steps_mm : list of float
        Heights in millimetres of the object's steps as they should be, in order: reported beside the measured ones.
    light : mapping or None
        ``led`` and ``intensity`` of the projector (`irpmd_rig.recipes.fields.Light`); without it the rig's.
    exposure_us : float or "auto"
        Exposure time of the camera in microseconds, above 0 and at most 10 000 000; ``auto`` measures at each station
        what does not saturate.
    pixel_format : str
        ``Mono8`` or ``Mono10``: bits of a pixel.
    trigger : str or None
        ``hardware``: the projector's sync output triggers the camera; ``software``: each frame is asked for; without it
        the rig's.
    settle : mapping, "measured" or None
        ``time_s``: seconds to wait after a motion beside the stage's own settle time; ``measured``: wait until
        successive frames no longer differ.
    retries : int
        How often a set of frames that is dropped, late, stale or saturated is taken again; 0 to 10.
    """

    name: Name
    operator: Name | None = None
    sample: Name | None = None
    notes: Annotated[str, Field(max_length=5000)] = ""
    nominal_steps_mm: Annotated[tuple[Millimetres, ...], Field(max_length=100)] = ()
    light: Light | None = None
    exposure_us: ExposureUs = "auto"
    pixel_format: Literal["Mono8", "Mono10"] = "Mono8"
    trigger: Literal["hardware", "software"] | None = None
    settle: Settle | Literal["measured"] | None = None
    retries: Annotated[int, Field(ge=0, le=10)] = 2


class CalibrateCamera(RecipeBase):
    """Intrinsics from a checkerboard, first of the calibrations: board poses without glass, the last on the plate.

    Attributes
    ----------
    kind : str
        ``calibrate-camera``.
    poses : int
        Pictures of the board, 3 to 100, the one on the plate included; the paper takes 30.
    plate_mm : float
        Position of stage2 in millimetres at which the board lies on the white plate, in the last picture.
    """

    kind: Literal["calibrate-camera"]
    poses: Annotated[int, Field(ge=3, le=100)] = 30
    plate_mm: Millimetres = 100.0


class CalibratePlate(RecipeBase):
    """Absolute phase against the position of the white plate on stage2, without glass.

    Attributes
    ----------
    kind : str
        ``calibrate-plate``.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`).
    positions_mm : list of float
        Positions of stage2 in millimetres, 4 to 200 of them; 0, 10, ... 200 as in the paper.
    calibration : str
        The calibration of the camera that it belongs to: the id of a run, or ``active``.
    """

    kind: Literal["calibrate-plate"]
    fringes: Fringes = Fringes()
    positions_mm: PlatePositions = tuple(10.0 * k for k in range(21))
    calibration: RunId = "active"


class CalibrateGeometry(RecipeBase):
    """Reference plane, glass plane and their distance from the sprayed mirror at stage1 = 0.

    Attributes
    ----------
    kind : str
        ``calibrate-geometry``.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`); counts as in the calibration of the plate.
    calibration : str
        The calibration of the plate to use: the id of a run, or ``active``.
    """

    kind: Literal["calibrate-geometry"]
    fringes: Fringes = Fringes()
    calibration: RunId = "active"


class Reference(RecipeBase):
    """Phase of the reference mirror at each stage position.

    Attributes
    ----------
    kind : str
        ``reference``.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`).
    positions_mm : list of float
        Positions s of stage1 in millimetres, 2 to 20, at least 0.1 apart: 0 is the reference position, + is away from
        the glass. Measurements must use the same.
    calibration : str
        The calibration of the geometry that it belongs to: the id of a run, or ``active``.
    """

    kind: Literal["reference"]
    fringes: Fringes = Fringes()
    positions_mm: Positions = (0.0, 40.0)
    calibration: RunId = "active"


def _two(positions_mm: tuple[float, ...]) -> tuple[float, ...]:
    if len(positions_mm) > 2:
        raise complaint(
            f"has {len(positions_mm)} positions; the depth equation takes two", "leave out all but two", (2,)
        )
    return positions_mm


class Measure(RecipeBase):
    """Depth of an object from its fringes at two stage positions.

    Attributes
    ----------
    kind : str
        ``measure``.
    object : str
        What is measured, as the operator is asked to place it; on a simulated rig the name of an object of its world.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`); counts as in the reference.
    positions_mm : list of float
        The two positions s of stage1 in millimetres, at least 0.1 apart: 0 is the reference position, + is away from
        the glass. The reference must have the same.
    calibration : str
        The calibration of the geometry to use: the id of a run, or ``active``.
    reference : str
        The reference to use: the id of a run, or ``active``.
    method : str
        ``depth-equation``: the paper's.
    """

    kind: Literal["measure"]
    object: Name
    fringes: Fringes = Fringes()
    positions_mm: Annotated[Positions, AfterValidator(_two)] = (0.0, 40.0)
    calibration: RunId = "active"
    reference: RunId = "active"
    method: Literal["depth-equation"] = "depth-equation"


def _captures(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    if not any(isinstance(step, Capture) for step in steps):
        raise complaint("has no capture: the run would keep no frame", "add a step with do: capture")
    return steps


class Sequence(RecipeBase):
    """A free sequence of steps; its frames are kept, nothing is computed.

    Attributes
    ----------
    kind : str
        ``sequence``.
    fringes : mapping
        Patterns of ``show`` steps (`irpmd_rig.recipes.fields.Fringes`) that bring none of their own.
    steps : list of mapping
        1 to 1000 steps (`irpmd_rig.recipes.steps`), at least one of them a capture.
    """

    kind: Literal["sequence"]
    fringes: Fringes = Fringes()
    steps: Annotated[tuple[Step, ...], Field(min_length=1, max_length=1000), AfterValidator(_captures)]


Recipe = CalibrateCamera | CalibratePlate | CalibrateGeometry | Reference | Measure | Sequence

KINDS: dict[str, type[Recipe]] = {
    "calibrate-camera": CalibrateCamera,
    "calibrate-plate": CalibratePlate,
    "calibrate-geometry": CalibrateGeometry,
    "reference": Reference,
    "measure": Measure,
    "sequence": Sequence,
}

LATER = ("align", "characterise")
"""Kinds that are planned and refused until they can be run."""
