"""Recipes that set the ground glass parallel to the reference mirror."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from irpmd_rig.recipes.base import RecipeBase
from irpmd_rig.recipes.fields import Fringes, RunId


class Align(RecipeBase):
    """Ground glass parallel to the mirror: measured, turned by the operator as he is told, and measured again.

    Attributes
    ----------
    kind : str
        ``align``.
    fringes : mapping
        Patterns (`irpmd_rig.recipes.fields.Fringes`); counts as in the calibration of the plate.
    calibration : str
        The calibration of the plate to use: the id of a run, or ``active``.
    tolerance_deg : float
        Largest tilt of the glass about x and about y, in degrees, that is left alone; 0.001 to 5.
    rounds : int
        Measurements at most, 1 to 20: after the last nothing more is turned, and a run whose glass is then still out
        of tolerance has failed.
    """

    kind: Literal["align"]
    fringes: Fringes = Fringes()
    calibration: RunId = "active"
    tolerance_deg: Annotated[float, Field(ge=0.001, le=5)] = 0.03
    rounds: Annotated[int, Field(ge=1, le=20)] = 5
