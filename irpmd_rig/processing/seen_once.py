"""Parts of the object that show the fringes at one stage position only: they have no depth, and that is said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from irpmd_rig.core.camera import rays_at
from irpmd_rig.processing.archive import Content
from irpmd_rig.processing.estimates import Check
from irpmd_rig.processing.object_views import ObjectViews, hidden_mask
from irpmd_rig.processing.optics import Optics
from irpmd_rig.processing.regions import Mask, Window

# Narrower strips are edges, whose blur one position shows and another does not.
_LEAST_WIDTH_PX = 5
# A patch is said if it is no smaller than the smallest facet that would be found.
_LEAST_SHARE, _FEWEST_PIXELS = 0.02, 100


@dataclass(frozen=True, slots=True)
class SeenOnce:
    """A patch of pixels whose phase is known at one position only.

    Attributes
    ----------
    seen_mm
        That position of stage 1.
    pixels
        How many.
    window
        Rows and columns of the picture around them.
    xy_mm
        Where their middle would lie on the reference plane, in frame M.
    """

    seen_mm: float
    pixels: int
    window: Window
    xy_mm: tuple[float, float]

    def content(self) -> Content:
        """As JSON."""
        rows, columns = self.window
        return {
            "seen_at_mm": self.seen_mm,
            "pixels": self.pixels,
            "rows": [rows.start, rows.stop],
            "columns": [columns.start, columns.stop],
            "near_mm": list(self.xy_mm),
        }

    def __str__(self) -> str:
        """In words."""
        rows, columns = self.window
        return (
            f"{self.pixels} pixels in rows {rows.start}..{rows.stop - 1}, columns {columns.start}..{columns.stop - 1} "
            f"(near x {self.xy_mm[0]:.0f} mm, y {self.xy_mm[1]:.0f} mm) show fringes at {self.seen_mm:g} mm only"
        )


def seen_once(seen: ObjectViews, optics: Optics) -> tuple[SeenOnce, ...]:
    """Find them; what shows the glass itself, or lies beyond the reference, is no part of the object.

    Parameters
    ----------
    seen
        Phases of the object.
    optics
        The calibrations.
    """
    known = [np.isfinite(phase.phase_rad) for phase in seen.phases]
    views = np.add.reduce(known, dtype=np.uint8)
    once = (views == 1) & _of_the_object(seen, optics, known[0].shape)
    fewest = max(_FEWEST_PIXELS, round(_LEAST_SHARE * np.count_nonzero(views > 1)))
    found = []
    for position_mm, mask in zip(seen.read_mm, known, strict=True):
        for pixels, window in _patches(mask & once, fewest):
            found.append(SeenOnce(position_mm, pixels, window, _place(window, optics)))
    return tuple(found)


def check_seen(patches: Sequence[SeenOnce], positions: int) -> Check:
    """Whether the whole object was seen twice, for the result."""
    says = "; ".join(str(patch) for patch in patches)
    return Check(
        "seen at two positions",
        not patches,
        f"no depth there, and facets may be missing: {says}; their reflection leaves the glass elsewhere, or they are "
        "shaded or too dark there"
        if patches
        else f"all of the object that shows fringes shows them at two or more of {positions} positions",
    )


def _of_the_object(seen: ObjectViews, optics: Optics, shape: tuple[int, ...]) -> Mask:
    if optics.rig is not None:
        return ~hidden_mask(optics.rig, seen.read_mm)
    mask = np.zeros(shape, np.bool_)
    mask[seen.window if optics.references is None else optics.references.window] = True
    return mask


def _patches(mask: Mask, fewest: int) -> list[tuple[int, Window]]:
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((_LEAST_WIDTH_PX,) * 2, np.uint8))
    statistics = cv2.connectedComponentsWithStats(opened, connectivity=4)[2][1:].tolist()
    return [
        (pixels, (slice(top, top + height), slice(left, left + width)))
        for left, top, width, height, pixels in statistics
        if pixels >= fewest
    ]


def _place(window: Window, optics: Optics) -> tuple[float, float]:
    rows, columns = window
    middle = np.array([(columns.start + columns.stop - 1) / 2, (rows.start + rows.stop - 1) / 2])
    frame = optics.geometry.frame
    along = frame.directions(rays_at(optics.intrinsics, middle))
    x, y, _ = frame.camera_mm - frame.camera_mm[2] / along[2] * along
    return float(x), float(y)
