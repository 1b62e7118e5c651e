"""What every recipe may say, whatever its kind."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from irpmd_rig.recipes.document import Settings
from irpmd_rig.recipes.fields import ExposureUs, Light, Millimetres, Name, NamedRun, Settle


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
    compensation : str or None
        Id of a run that characterised the gamma: all fringes are shown by its table of levels, so that their light is
        sinusoidal; without it as they are.
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
    compensation: NamedRun | None = None
    retries: Annotated[int, Field(ge=0, le=10)] = 2
