"""Worlds that cannot be: parts that do not fit together."""

import math
from typing import TYPE_CHECKING

import numpy as np

from sims.camera_rays import monotone_reach, undistorted
from sims.frames import turn
from sims.objects import Freeform
from sims.projection import lens_numbers, projector_frame, projector_pixel
from sims.surfaces import SUBJECTS, Patch, object_patches, stage1_axis

if TYPE_CHECKING:
    from sims.world import World

Fault = tuple[tuple[str | int, ...], str]


class GeometryError(ValueError):
    """Every way in which a world's parts do not fit together."""

    def __init__(self, faults: list[Fault]) -> None:
        super().__init__("; ".join(f"{'.'.join(map(str, place))}: {message}" for place, message in faults))
        self.faults = faults


def impossibilities(world: "World") -> list[Fault]:
    """All faults of a world, each with the place in the file that it is about."""
    faults = [*_optics(world), *_mirror(world)]
    for name in world.objects:
        faults += _object(world, name)
    return faults


def _above_glass(world: "World", points: np.ndarray) -> np.ndarray:
    """Heights in mm of points of W (frame M at stage1 = 0) over the glass's surface, toward the projector."""
    glass = world.glass
    local = (points - np.array(glass.centre_mm)) @ turn(glass.tilt_about_x_deg, glass.tilt_about_y_deg)
    bow = glass.bow_um * 1e-3 * ((local[..., :2] / (np.array(glass.size_mm) / 2)) ** 2).sum(axis=-1)
    return np.asarray(local[..., 2] - bow)


def _optics(world: "World") -> list[Fault]:
    faults: list[Fault] = []
    camera = world.camera
    if camera.position_mm[2] <= 0:
        faults.append((("camera", "position_mm"), "the camera is behind the reference plane z = 0"))
    if camera.axis[2] >= 0:
        faults.append((("camera", "axis"), "the camera looks away from the reference plane"))
    if world.glass.centre_mm[2] <= 0:
        faults.append((("glass", "centre_mm"), "the glass is behind the reference plane z = 0"))
    position, axes = projector_frame(world.projector)
    if _above_glass(world, position) <= 0:
        faults.append((("projector", "position_mm"), "the glass is not between the projector and the mirror"))
    ahead = axes @ (np.array(world.glass.centre_mm) - position)
    if ahead[2] <= 0:
        faults.append((("projector", "axis"), "the projector looks away from the glass"))
    elif math.isnan(projector_pixel(lens_numbers(world.projector), *ahead)[0]):
        faults.append((("projector", "axis"), "the projector does not light the glass's centre"))
    if not _lens_is_invertible(world):
        faults.append((("camera", "kc"), "this distortion folds the image: some pixels have no direction"))
    projector = world.projector
    half = np.array(projector.size_px) / 2 * projector.pixel_um * 1e-3 / projector.focal_mm
    reach = monotone_reach(projector.distortion)
    k1, k2, _, _, k3 = projector.distortion
    if math.isfinite(reach) and math.sqrt(reach) * (1 + reach * (k1 + reach * (k2 + reach * k3))) < math.hypot(*half):
        faults.append((("projector", "distortion"), "this distortion folds the picture before its corners"))
    if projector.warp_amplitude_px * 2 * math.pi >= projector.warp_period_px:
        faults.append((("projector", "warp_amplitude_px"), "this warp folds the picture: at most period / 2 pi"))
    return faults


def _lens_is_invertible(world: "World") -> bool:
    camera = world.camera
    edge = np.linspace(0, 1, 17)
    rim = [(t, e) for t in edge for e in (0.0, 1.0)] + [(e, t) for t in edge for e in (0.0, 1.0)]
    for across, down in rim:
        xd = (across * (camera.size_px[0] - 1) - camera.cc_px[0]) / camera.fc_px[0]
        yd = (down * (camera.size_px[1] - 1) - camera.cc_px[1]) / camera.fc_px[1]
        x, y = undistorted(xd, yd, camera.kc)
        if math.isnan(x) or x * x + y * y >= monotone_reach(camera.kc):
            return False
    return True


def _mirror(world: "World") -> list[Fault]:
    (x0, x1), (y0, y1) = world.mirror.x_mm, world.mirror.y_mm
    corners = np.array([[x, y, 0.0] for x in (x0, x1) for y in (y0, y1)])
    if np.any(_above_glass(world, corners) >= 0):
        return [(("mirror",), "the mirror reaches through the plane of the glass")]
    return _travel(world, corners, "the mirror")


def _travel(world: "World", points: np.ndarray, what: str) -> list[Fault]:
    stage = world.stage1
    for end in stage.travel_mm:
        if np.any(_above_glass(world, points + end * stage1_axis(stage)) >= 0):
            return [(("stage1", "travel_mm"), f"stage1 drives {what} through the glass at {end} mm")]
    return []


def _object(world: "World", name: str) -> list[Fault]:
    place = ("objects", name)
    if name in SUBJECTS:
        return [(place, f"this name is taken: choose another than {', '.join(SUBJECTS)}")]
    faults: list[Fault] = []
    patches = object_patches(world, name)
    tops = np.concatenate([patch.top_vertices() for patch in patches])
    if np.any(_above_glass(world, tops) >= 0):
        faults.append((place, "the object reaches behind the glass (at stage1 = 0)"))
    else:
        faults += _travel(world, tops, f"the object '{name}'")
    for number, patch in enumerate(patches):
        if patch.base_mm >= patch.height_range_mm()[0]:
            faults.append(((*place, "base_mm"), f"the base is not below facet {number}"))
        if _holds(patch, np.array(world.camera.position_mm)):
            faults.append((place, "the camera is inside the object"))
    if isinstance(world.objects[name], Freeform):
        faults += [
            ((*place, "mirrors", b), f"this mirror stands in mirror {a}")
            for b in range(len(patches))
            for a in range(b)
            if _overlap(patches[a], patches[b])
        ]
    return faults


def _holds(patch: Patch, point: np.ndarray) -> bool:
    x, y, z = patch.axes @ (point - patch.origin)
    side = np.roll(patch.polygon, -1, axis=0) - patch.polygon
    inward = side[:, 0] * (y - patch.polygon[:, 1]) - side[:, 1] * (x - patch.polygon[:, 0])
    return bool(np.all(inward >= 0) and patch.base_mm <= z <= patch.height_range_mm()[1])


def _overlap(a: Patch, b: Patch) -> bool:
    """Whether two solids' outlines, seen from above, share some area (separating axes of convex outlines)."""
    outlines = [np.asarray(patch.top_vertices()[:, :2]) for patch in (a, b)]
    for outline in outlines:
        for side in np.roll(outline, -1, axis=0) - outline:
            normal = np.array([side[1], -side[0]])
            spans = [(o @ normal).min() for o in outlines], [(o @ normal).max() for o in outlines]
            if spans[1][0] <= spans[0][1] + 1e-9 or spans[1][1] <= spans[0][0] + 1e-9:
                return False
    return True
