"""What recipes say about the computing of their runs, and the method that follows from a measurement's."""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.recipes.align import Align
from irpmd_rig.recipes.characterise import CharacteriseSettle
from irpmd_rig.recipes.models import Measure, Method
from irpmd_rig.store.record import RunRecord

NEED_A_REFERENCE: tuple[Method, ...] = ("depth-equation", "generalised")
_DEFAULT = Measure.model_fields
_ALIGN, _SETTLE = Align.model_fields, CharacteriseSettle.model_fields
_Model = TypeVar("_Model", bound=BaseModel)


class Wishes(BaseModel):
    """The parts of a measurement's recipe that the computing reads; a folder written by hand need not have them.

    Attributes
    ----------
    method, phase_filter, compare, max_chi2, if_calibration_is_off
        As `irpmd_rig.recipes.models.Measure`.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    method: Literal["auto"] | Method = _DEFAULT["method"].default
    phase_filter: bool = _DEFAULT["phase_filter"].default
    compare: tuple[Method, ...] = _DEFAULT["compare"].default
    max_chi2: Annotated[float, Field(gt=1)] = _DEFAULT["max_chi2"].default
    if_calibration_is_off: Literal["refuse", "mark"] = _DEFAULT["if_calibration_is_off"].default

    def chosen(self, *, has_model: bool) -> tuple[Method, str]:
        """Method, and why this one.

        Parameters
        ----------
        has_model
            Whether the calibration of the geometry has a rig model.
        """
        if self.method != "auto":
            return self.method, "the recipe names it"
        if has_model:
            return "facets", "the calibration has a rig model"
        return "depth-equation", "the calibration has no rig model: it was taken at one stage position"


class AlignWishes(BaseModel):
    """The parts of an alignment's recipe that the computing reads.

    Attributes
    ----------
    tolerance_deg, rounds
        As `irpmd_rig.recipes.align.Align`.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    tolerance_deg: Annotated[float, Field(gt=0)] = _ALIGN["tolerance_deg"].default
    rounds: Annotated[int, Field(ge=1)] = _ALIGN["rounds"].default


class SettleWishes(BaseModel):
    """The part of a settle characterisation's recipe that the computing reads.

    Attributes
    ----------
    still_um
        As `irpmd_rig.recipes.characterise.CharacteriseSettle`.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    still_um: Annotated[float, Field(gt=0)] = _SETTLE["still_um"].default


def wishes(record: RunRecord) -> Wishes:
    """Read what a measurement's record says; raises ProcessingError if it is wrong."""
    return _read(Wishes, record)


def align_wishes(record: RunRecord) -> AlignWishes:
    """Read what an alignment's record says; raises ProcessingError if it is wrong."""
    return _read(AlignWishes, record)


def settle_wishes(record: RunRecord) -> SettleWishes:
    """Read what a settle characterisation's record says; raises ProcessingError if it is wrong."""
    return _read(SettleWishes, record)


def _read(model: type[_Model], record: RunRecord) -> _Model:
    try:
        return model.model_validate(record.recipe)
    except ValidationError as error:
        problems = "; ".join(f"recipe.{'.'.join(str(p) for p in e['loc'])}: {e['msg']}" for e in error.errors())
        raise ProcessingError(f"run.yaml: {problems}", "correct the recipe part of run.yaml") from None
