"""Every subject as a list of patches: heights over convex polygons, with walls or without."""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sims.boards import FlatPose, board_on_plate_pose, board_pose, plate_pose
from sims.errors import SimulationError
from sims.frames import Matrix, Vector, attitude, slopes, turn
from sims.objects import Fan, Freeform, FreeformMirror, MirrorStep
from sims.setup import Setup

if TYPE_CHECKING:
    from sims.instruments import Camera, Stage1
    from sims.world import World

NONE, SPECULAR, DIFFUSE, GLASS = 0, 1, 2, 3
SUBJECTS = ("mirror", "plate", "board", "board_on_plate", "nothing")
_UPRIGHT = np.eye(3)
_FLAT = (0.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Patch:
    """One facet.

    Attributes
    ----------
    origin, axes
        Its frame in frame M (axes as rows).
    polygon : array (n, 2)
        Outline in that frame, convex, counter-clockwise seen from +z.
    slope : (dz/dx, dz/dy); curvature : (1/mm along x, along y); bump : (height, width, x, y)
        Its height: plane + biconic sag + Gaussian.
    base_mm : float
        Local z at which its walls end; NaN: a thin sheet.
    kind : int
        SPECULAR or DIFFUSE.
    reflectance : float
        Reflectivity or albedo.
    chequered : bool
        Whether the board's squares are painted on it (in its own frame).
    """

    origin: Vector
    axes: Matrix
    polygon: NDArray[np.float64]
    slope: tuple[float, float] = (0.0, 0.0)
    curvature: tuple[float, float] = (0.0, 0.0)
    bump: tuple[float, float, float, float] = _FLAT
    base_mm: float = float("nan")
    kind: int = SPECULAR
    reflectance: float = 1.0
    chequered: bool = False

    @property
    def is_flat(self) -> bool:
        """Whether its height is a plane."""
        return self.curvature == (0.0, 0.0) and self.bump[0] == 0.0

    def height_range_mm(self) -> tuple[float, float]:
        """Local heights that its surface never leaves."""
        tilted = self.polygon @ np.array(self.slope)
        reach = np.abs(self.polygon).max(axis=0) ** 2
        root = np.sqrt(1.0 - float(np.square(self.curvature) @ reach))
        high = float(np.maximum(self.curvature, 0.0) @ reach) / (1.0 + root) + max(self.bump[0], 0.0)
        low = float(np.minimum(self.curvature, 0.0) @ reach) / (1.0 + root) + min(self.bump[0], 0.0)
        return float(tilted.min()) + low, float(tilted.max()) + high

    def top_vertices(self) -> NDArray[np.float64]:
        """Points (n, 3) in frame M that are at least as high as the surface over its outline."""
        _, high = self.height_range_mm()
        z = self.polygon @ np.array(self.slope) if self.is_flat else np.full(len(self.polygon), high)
        return self.origin + np.column_stack([self.polygon, z]) @ self.axes


def stage1_axis(stage: "Stage1") -> Vector:
    """Find the unit vector in W along which stage1 moves frame M: away from the glass."""
    turned = turn(stage.axis_tilt_about_x_deg, stage.axis_tilt_about_y_deg) @ np.array([0.0, 0.0, -1.0])
    return np.asarray(turned, dtype=np.float64)


def subject_patches(world: "World", setup: Setup) -> list[Patch]:
    """Describe what the camera looks at, in frame M.

    Raises
    ------
    SimulationError
        The world has no such subject.
    """
    match setup.subject:
        case "nothing":
            return []
        case "mirror":
            return _mirror(world)
        case "plate":
            pose = _fixed_in_world(world, setup, plate_pose(world, setup.stage2_mm))
            return [_sheet(world.camera, pose, np.array(world.plate.size_mm), world.plate.albedo)]
        case "board":
            size = _board_size(world)
            pose = board_pose(world, setup.pose)
            return [_sheet(world.camera, pose, size, world.board.white_albedo, chequered=True)]
        case "board_on_plate":
            return [_board_on_plate(world, setup)]
    if setup.subject not in world.objects:
        known = ", ".join((*SUBJECTS, *world.objects))
        raise SimulationError(f"there is no subject '{setup.subject}': this world has {known}")
    return object_patches(world, setup.subject)


def object_patches(world: "World", name: str) -> list[Patch]:
    """Describe the facets of an object, in rising order (freeform: in the order given)."""
    item = world.objects[name]
    if isinstance(item, Freeform):
        return [_freeform(mirror, item) for mirror in item.mirrors]
    polygons = _treads(item) if isinstance(item, MirrorStep) else _sectors(item)
    if item.rising == "negative":
        polygons.reverse()
    heights = np.concatenate([[0.0], np.cumsum(item.steps_mm)])
    heights += item.centre_mm[2] - heights[-1] / 2
    patches = []
    for number, (polygon, height) in enumerate(zip(polygons, heights, strict=True)):
        centre = _centroid(polygon)
        tilt = (0.0, 0.0) if item.tilts_deg is None else item.tilts_deg[number]
        patches.append(
            Patch(
                origin=np.array([*centre, height]),
                axes=_UPRIGHT,
                polygon=polygon - centre,
                slope=slopes(*tilt),
                base_mm=item.base_mm - height,
                reflectance=item.reflectivity,
            )
        )
    return patches


def _mirror(world: "World") -> list[Patch]:
    mirror = world.mirror
    bare = mirror.x_mm
    if mirror.sprayed_x_mm is not None:
        low, high = mirror.sprayed_x_mm
        bare = (high, bare[1]) if low == bare[0] else (bare[0], low)
    origin = np.zeros(3)
    patches = [Patch(origin, _UPRIGHT, _rectangle(bare, mirror.y_mm), reflectance=mirror.reflectivity)]
    if mirror.sprayed_x_mm is not None:
        sprayed = _rectangle(mirror.sprayed_x_mm, mirror.y_mm)
        patches.append(Patch(origin, _UPRIGHT, sprayed, kind=DIFFUSE, reflectance=mirror.sprayed_albedo))
    return patches


def _sheet(
    camera: "Camera", pose: FlatPose, size: NDArray[np.float64], albedo: float, *, chequered: bool = False
) -> Patch:
    axes = attitude(camera.axis, camera.roll_deg)
    half = size / 2
    return Patch(
        origin=np.array(camera.position_mm) + pose.centre_mm @ axes,
        axes=pose.axes @ axes,
        polygon=_rectangle((-half[0], half[0]), (-half[1], half[1])),
        kind=DIFFUSE,
        reflectance=albedo,
        chequered=chequered,
    )


def _board_on_plate(world: "World", setup: Setup) -> Patch:
    # One sheet in the board's frame with the plate's outline: two coplanar ones would fight for every ray.
    pose = _fixed_in_world(world, setup, board_on_plate_pose(world, setup.stage2_mm))
    plate = _fixed_in_world(world, setup, plate_pose(world, setup.stage2_mm))
    sheet = _sheet(world.camera, pose, np.array(world.plate.size_mm), world.plate.albedo, chequered=True)
    corners = np.column_stack([sheet.polygon, np.zeros(4)]) @ plate.axes + plate.centre_mm
    outline = (corners - pose.centre_mm) @ pose.axes.T
    return Patch(sheet.origin, sheet.axes, outline[:, :2], kind=DIFFUSE, reflectance=sheet.reflectance, chequered=True)


def _fixed_in_world(world: "World", setup: Setup, pose: FlatPose) -> FlatPose:
    # Stage2 stands in the world: seen from the camera, what it carries moves against stage1.
    axes = attitude(world.camera.axis, world.camera.roll_deg)
    moved = setup.stage1_mm * (axes @ stage1_axis(world.stage1))
    return FlatPose(pose.centre_mm - moved, pose.axes)


def _board_size(world: "World") -> NDArray[np.float64]:
    return np.array(world.board.squares) * world.board.square_mm + 2 * world.board.border_mm


def _treads(item: MirrorStep) -> list[NDArray[np.float64]]:
    count = len(item.steps_mm) + 1
    (cx, cy), (sx, sy) = item.centre_mm[:2], item.size_mm
    if item.along == "x":
        edges = cx + sx * (np.arange(count + 1) / count - 0.5)
        return [_rectangle((edges[k], edges[k + 1]), (cy - sy / 2, cy + sy / 2)) for k in range(count)]
    edges = cy + sy * (np.arange(count + 1) / count - 0.5)
    return [_rectangle((cx - sx / 2, cx + sx / 2), (edges[k], edges[k + 1])) for k in range(count)]


def _sectors(item: Fan) -> list[NDArray[np.float64]]:
    count = len(item.steps_mm) + 1
    edges = np.radians(item.opening_deg) * (np.arange(count + 1) / count - 0.5)
    polygons = []
    for first, last in pairwise(edges):
        arc = np.linspace(first, last, item.outer_segments + 1)
        outer = item.outer_radius_mm * np.stack([np.cos(arc), np.sin(arc)], axis=1)
        inner = item.inner_radius_mm * np.array([[np.cos(a), np.sin(a)] for a in (last, first)])
        polygon = np.concatenate([outer, inner]) - [item.pivot_distance_mm, 0.0]
        if item.along == "x":
            # Swapping x and y keeps the order along the coordinate named, and turns the outline's sense
            # round.
            polygon = polygon[::-1, ::-1]
        polygons.append(polygon + item.centre_mm[:2])
    return polygons


def _freeform(mirror: FreeformMirror, item: Freeform) -> Patch:
    half = np.array(mirror.size_mm) / 2
    radii = (mirror.radius_x_mm, mirror.radius_y_mm)
    return Patch(
        origin=np.array(mirror.centre_mm),
        axes=turn(mirror.tilt_about_x_deg, mirror.tilt_about_y_deg).T,
        polygon=_rectangle((-half[0], half[0]), (-half[1], half[1])),
        curvature=(0.0 if radii[0] is None else 1 / radii[0], 0.0 if radii[1] is None else 1 / radii[1]),
        bump=(mirror.bump_height_mm, mirror.bump_width_mm, *mirror.bump_centre_mm),
        base_mm=item.base_mm - mirror.centre_mm[2],
        reflectance=item.reflectivity,
    )


def _rectangle(x: tuple[float, float], y: tuple[float, float]) -> NDArray[np.float64]:
    return np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])


def _centroid(polygon: NDArray[np.float64]) -> NDArray[np.float64]:
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1]
    return np.asarray(((polygon + following) * cross[:, None]).sum(axis=0) / (3 * cross.sum()))
