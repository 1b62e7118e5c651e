"""Recipes as models: one class a kind; what a person writes in YAML, every field with its unit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from irpmd_rig.recipes.align import Align
from irpmd_rig.recipes.base import RecipeBase
from irpmd_rig.recipes.characterise import CHARACTERISED, Characterise, Characterised
from irpmd_rig.recipes.document import complaint
from irpmd_rig.recipes.fields import Fringes, Millimetres, Name, PositionsMm, RunId
from irpmd_rig.recipes.steps import Capture, Step

Method = Literal["depth-equation", "generalised", "triangulation", "facets"]
Positions = Annotated[PositionsMm, Field(min_length=2, max_length=20)]
GeometryPositions = Annotated[PositionsMm, Field(min_length=1, max_length=20)]
PlatePositions = Annotated[PositionsMm, Field(min_length=4, max_length=200)]


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
    """Reference plane, glass plane and their distance from the sprayed mirror; the whole rig from several positions.

    Attributes
    ----------
    kind : str
        ``calibrate-geometry``.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`); counts as in the calibration of the plate.
    positions_mm : list of float
        Positions s of stage1 in millimetres, 1 to 20, at least 0.1 apart. The paper's planes and d are taken at the
        first. From two on, camera, glass, stage axis and projector are calibrated together (the rig model), which every
        method but the depth equation needs: the glass is seen best at positions toward it (below 0).
    calibration : str
        The calibration of the plate to use: the id of a run, or ``active``.
    """

    kind: Literal["calibrate-geometry"]
    fringes: Fringes = Fringes()
    positions_mm: GeometryPositions = (0.0, -40.0, -80.0, 40.0)
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


def _different(methods: tuple[Method, ...]) -> tuple[Method, ...]:
    if len(set(methods)) < len(methods):
        raise complaint("names a method twice", "name each once")
    return methods


class Measure(RecipeBase):
    """Depth of an object from its fringes at two or more stage positions.

    Attributes
    ----------
    kind : str
        ``measure``.
    object : str
        What is measured, as the operator is asked to place it; on a simulated rig the name of an object of its world.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`); counts as in the calibrations. With orientations ``[x, y]`` the
        ray methods use both.
    positions_mm : list of float
        Positions s of stage1 in millimetres, 2 to 20, at least 0.1 apart: 0 is the reference position, + is away from
        the glass. The depth equation takes two; it and the generalised equation need a reference at the same ones.
    calibration : str
        The calibration of the geometry to use: the id of a run, or ``active``.
    reference : str
        The reference to use, where the method needs one: the id of a run, or ``active``.
    method : str
        ``depth-equation``: the paper's. ``generalised``: the same with the calibrated points of the glass.
        ``triangulation``: where camera ray and incident ray meet, pixel by pixel. ``facets``: planes and smooth
        surfaces through all phases of each facet. ``auto``: facets where the calibration has a rig model, else the
        depth equation.
    phase_filter : bool
        Whether the depth equation's phases are filtered first, each pixel with its neighbours on the same facet.
    compare : list of str
        More methods, computed beside the chosen one; what cannot be computed is said in the result.
    max_chi2 : float
        Largest chi2 per degree of freedom of the rig model with which it may be used, and up to which normals are
        trusted in the facets; 1 is a model that explains the data, above 1 to 1000.
    if_calibration_is_off : str
        A calibration or reference that is too old for the rig file or does not say when it was taken, or is of
        another camera; a rig model above ``max_chi2``; a reference that is older than the calibration of the geometry
        and goes with another one, where a method uses it: ``refuse`` the run, or ``mark`` the result.
    """

    kind: Literal["measure"]
    object: Name
    fringes: Fringes = Fringes()
    positions_mm: Positions = (0.0, 40.0)
    calibration: RunId = "active"
    reference: RunId = "active"
    method: Literal["auto", "depth-equation", "generalised", "triangulation", "facets"] = "auto"
    phase_filter: bool = False
    compare: Annotated[tuple[Method, ...], Field(max_length=4), AfterValidator(_different)] = ()
    max_chi2: Annotated[float, Field(gt=1, le=1000)] = 4.0
    if_calibration_is_off: Literal["refuse", "mark"] = "refuse"

    @model_validator(mode="after")
    def _two_for_the_depth_equation(self) -> Self:
        if self.method == "depth-equation" and len(self.positions_mm) > 2:
            raise complaint(
                f"has {len(self.positions_mm)} positions; the depth equation takes two",
                "leave out all but two, or choose another method",
                ("positions_mm", 2),
            )
        return self


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


Recipe = CalibrateCamera | CalibratePlate | CalibrateGeometry | Reference | Measure | Sequence | Align | Characterised

KINDS: dict[str, type[RecipeBase]] = {
    "calibrate-camera": CalibrateCamera,
    "calibrate-plate": CalibratePlate,
    "calibrate-geometry": CalibrateGeometry,
    "reference": Reference,
    "measure": Measure,
    "sequence": Sequence,
    "align": Align,
    "characterise": Characterise,
}


def model_of(values: Mapping[str, object]) -> type[RecipeBase]:
    """Model of what a recipe says that is of a known ``kind``: of a characterise it depends on ``what``, too."""
    kind, what = values.get("kind"), values.get("what")
    if kind == "characterise" and isinstance(what, str) and what in CHARACTERISED:
        return CHARACTERISED[what]
    return KINDS[str(kind)]
