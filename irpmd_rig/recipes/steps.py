"""Steps of a free sequence."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from irpmd_rig.recipes.document import Settings, complaint
from irpmd_rig.recipes.fields import ExposureUs, Fringes, Label, Millimetres, Name, Seconds


class Show(Settings):
    """Choose the picture that later captures take.

    Attributes
    ----------
    do : str
        ``show``.
    pattern : str
        ``fringes``: all sets and steps, one after the other; ``white``, ``black``: a uniform picture; ``plain``:
        nothing, the projector is dark.
    fringes : mapping or None
        Fringe patterns of this step; without it those of the recipe.
    """

    do: Literal["show"]
    pattern: Literal["fringes", "white", "black", "plain"]
    fringes: Fringes | None = None

    @model_validator(mode="after")
    def _fringes_for_fringes(self) -> Self:
        if self.fringes is not None and self.pattern != "fringes":
            raise complaint(
                f"are given, but the pattern is {self.pattern}",
                "write pattern: fringes, or leave them out",
                ("fringes",),
            )
        return self


class Capture(Settings):
    """Take the picture shown: one frame, or all frames of the fringes. Before any ``show`` the projector is dark.

    Attributes
    ----------
    do : str
        ``capture``.
    label : str
        What the frames are for: a letter, then a to z, 0 to 9, - and _, at most 40.
    """

    do: Literal["capture"]
    label: Label


class Move(Settings):
    """Move a stage.

    Attributes
    ----------
    do : str
        ``move``.
    stage : str
        ``stage1`` or ``stage2``.
    position_mm : float
        Where to, in millimetres: s for stage1 (0 = reference position, + = away from the glass).
    """

    do: Literal["move"]
    stage: Literal["stage1", "stage2"]
    position_mm: Millimetres


class Wait(Settings):
    """Wait before the next capture.

    Attributes
    ----------
    do : str
        ``wait``.
    time_s : float
        Seconds, 0 to 3600.
    """

    do: Literal["wait"]
    time_s: Seconds


class Ask(Settings):
    """Ask the operator to do something, and wait for the answer.

    Attributes
    ----------
    do : str
        ``prompt``.
    text : str
        What to do.
    subject : str or None
        What then stands before the camera: ``board``, ``board_on_plate``, ``plate``, ``mirror``, ``nothing`` or the
        name of an object. A simulated rig needs it to answer by itself.
    pose : int
        Which pose of the board, from 0 to 1000; other subjects have none.
    glass, lamp : bool
        Whether the ground glass is in place, and the room's lamp on; only with a subject.
    """

    do: Literal["prompt"]
    text: Annotated[str, Field(min_length=1, max_length=500)]
    subject: Name | None = None
    pose: Annotated[int, Field(ge=0, le=1000)] = 0
    glass: bool = True
    lamp: bool = False

    @model_validator(mode="after")
    def _whole_scene(self) -> Self:
        for key in ("pose", "glass", "lamp"):
            if key in self.model_fields_set and self.subject is None:
                raise complaint("is given without a subject", f"add subject, or leave {key} out", (key,))
        if self.pose and self.subject != "board":
            raise complaint(f"is for the board only, not for {self.subject!r}", "leave it out", ("pose",))
        return self


class Set(Settings):
    """Set the exposure of later captures.

    Attributes
    ----------
    do : str
        ``set``.
    exposure_us : float or "auto"
        Microseconds, or ``auto``.
    """

    do: Literal["set"]
    exposure_us: ExposureUs


Step = Annotated[Show | Capture | Move | Wait | Ask | Set, Field(discriminator="do")]
