"""What the computing needs to know of the rig: read from the rig part of `run.yaml`."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from irpmd_rig.core import Checkerboard, Drawing
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.store.record import RunRecord

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Pair = tuple[Finite, Finite]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class DrawingFacts(_Part):
    """Nominal places, as `irpmd_rig.core.Drawing`."""

    camera_xy_mm: Pair
    heading: Pair
    d_point_mm: Pair


class BoardFacts(_Part):
    """Checkerboard: squares along both sides and the side of one."""

    squares: tuple[Annotated[int, Field(ge=4)], Annotated[int, Field(ge=4)]]
    square_mm: Positive


class StageFacts(_Part):
    """How near a stage has to come to its target."""

    in_position_mm: Positive = 0.01


class ProjectorFacts(_Part):
    """The size of the projector's pictures: the paper's LightCommander's where nothing is said."""

    size_px: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = (1024, 768)


class CalibrationFacts(_Part):
    """How old a calibration may be (None: as old as it likes), and the RMS width of the blur in the camera's pictures.

    A lens in focus blurs by about 0.7 px; curved mirrors are corrected for it.
    """

    max_age_days: Positive | None = None
    blur_px: NotNegative = 0.7


class RigFacts(_Part):
    """The parts of a rig file that the computing reads; all else is ignored.

    Attributes
    ----------
    drawing, checkerboard
        None where the rig file says nothing; then the runs that need them are refused.
    stage1
        In-position window.
    projector
        Nominal.
    calibration
        Rules for calibrations.
    """

    drawing: DrawingFacts | None = None
    checkerboard: BoardFacts | None = None
    stage1: StageFacts = StageFacts()
    projector: ProjectorFacts = ProjectorFacts()
    calibration: CalibrationFacts = CalibrationFacts()

    def known_drawing(self) -> Drawing:
        """Nominal places of camera and glass; raises ProcessingError if the rig file has none."""
        if self.drawing is None:
            raise ProcessingError(
                "the rig's drawing is not known",
                "give rig.drawing in run.yaml, or drawing in the rig file: camera_xy_mm, heading and d_point_mm",
            )
        return Drawing(self.drawing.camera_xy_mm, self.drawing.heading, self.drawing.d_point_mm)

    def known_checkerboard(self) -> Checkerboard:
        """Inner corners and squares; raises ProcessingError if the rig file has none."""
        if self.checkerboard is None:
            raise ProcessingError(
                "the checkerboard is not known",
                "give rig.checkerboard in run.yaml, or checkerboard in the rig file: squares and square_mm",
            )
        columns, rows = self.checkerboard.squares
        return Checkerboard((rows - 1, columns - 1), self.checkerboard.square_mm)


def rig_facts(record: RunRecord) -> RigFacts:
    """Read the rig part of a run's record; raises ProcessingError if it is wrong."""
    try:
        return RigFacts.model_validate({key: value for key, value in record.rig.items() if value is not None})
    except ValidationError as error:
        problems = "; ".join(f"rig.{'.'.join(str(p) for p in e['loc'])}: {e['msg']}" for e in error.errors())
        raise ProcessingError(f"run.yaml: {problems}", "correct the rig part of run.yaml") from None
