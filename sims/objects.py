"""Objects that can stand in place of the mirror. All of them are solids: their walls hide and shade."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sims.instruments import Fraction, Part, PositiveLength, Signed, SmallTilt, Vector2, Vector3

# A facet's outline is a fixed-size record in the tracer.
MOST_SEGMENTS = 32


class _Stepped(Part):
    """Flat facets one above the other; their heights are centred on `centre_mm`.

    `rising` says whether the heights grow with or against the coordinate `along`; facets are numbered in the
    order in which they rise. `tilts_deg` turns every facet (about x, about y) about its centroid; null: none
    is turned. `base_mm` is the height at which the walls end.
    """

    steps_mm: Annotated[tuple[PositiveLength, ...], Field(min_length=1, max_length=50)]
    along: Literal["x", "y"]
    rising: Literal["positive", "negative"]
    centre_mm: Vector3
    tilts_deg: tuple[tuple[SmallTilt, SmallTilt], ...] | None
    base_mm: Signed
    reflectivity: Fraction

    @model_validator(mode="after")
    def _tilts_for_all(self) -> "_Stepped":
        facets = len(self.steps_mm) + 1
        if self.tilts_deg is not None and len(self.tilts_deg) != facets:
            raise ValueError(f"tilts_deg needs one pair for each of the {facets} facets")
        return self


class MirrorStep(_Stepped):
    """Parallel treads of equal width, side by side along `along`."""

    type: Literal["mirror_step"]
    size_mm: tuple[PositiveLength, PositiveLength]


class Fan(_Stepped):
    """Annular sectors of equal opening about a pivot `pivot_distance_mm` beside `centre_mm`.

    The pivot lies on the negative side of the centre, on the axis that `along` does not name, so that the
    sectors follow each other along `along`. The inner arc is a chord and the outer one `outer_segments`
    chords a sector: every facet is a convex polygon.
    """

    type: Literal["fan"]
    pivot_distance_mm: PositiveLength
    inner_radius_mm: PositiveLength
    outer_radius_mm: PositiveLength
    opening_deg: Annotated[float, Field(gt=0, lt=180)]
    outer_segments: Annotated[int, Field(ge=1, le=MOST_SEGMENTS)]

    @model_validator(mode="after")
    def _ring(self) -> "Fan":
        if self.inner_radius_mm >= self.outer_radius_mm:
            raise ValueError("inner_radius_mm must be below outer_radius_mm")
        return self


class FreeformMirror(Part):
    """One curved mirror over a rectangle of its own (tilted) frame, whose origin is `centre_mm`.

    Its height is the biconic sag of two radii (a sphere where they are equal; positive: hollow, the edges
    rise; null: flat) plus a Gaussian bump. The tilts turn it about x, then about y.
    """

    centre_mm: Vector3
    size_mm: tuple[PositiveLength, PositiveLength]
    radius_x_mm: Signed | None
    radius_y_mm: Signed | None
    tilt_about_x_deg: SmallTilt
    tilt_about_y_deg: SmallTilt
    bump_height_mm: Signed
    bump_width_mm: Annotated[float, Field(ge=1e-3, le=1e6)]
    bump_centre_mm: Vector2

    @model_validator(mode="after")
    def _sag_exists(self) -> "FreeformMirror":
        reach = 0.0
        for size, radius in zip(self.size_mm, (self.radius_x_mm, self.radius_y_mm), strict=True):
            if radius is not None:
                reach += math.inf if radius == 0 else (size / 2 / radius) ** 2
        if reach >= 0.9:
            raise ValueError("the mirror is larger than its radii of curvature allow")
        return self


class Freeform(Part):
    """Separate curved mirrors on one base; facets are numbered in the order given."""

    type: Literal["freeform"]
    mirrors: Annotated[tuple[FreeformMirror, ...], Field(min_length=1, max_length=20)]
    base_mm: Signed
    reflectivity: Fraction


WorldObject = Annotated[MirrorStep | Fan | Freeform, Field(discriminator="type")]
