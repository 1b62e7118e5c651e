"""The numbers that a self-calibration estimates, and the rig that they describe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.self_freeform import Freeform
from irpmd_rig.core.calibration.self_prior import INTRINSICS
from irpmd_rig.core.camera import Intrinsics
from irpmd_rig.core.frame import ReferenceFrame, reference_frame
from irpmd_rig.core.planes import Plane
from irpmd_rig.core.rig_model import Projector, RigModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Unknown:
    """One number.

    Attributes
    ----------
    name, unit : str
        What it is.
    weak_sigma : float
        How far it can be off before the data are looked at; for those that another measurement knows (intrinsics,
        stage offsets) that measurement's sigma takes its place.
    if_unknown : str
        What to say where the data leave it open.
    """

    name: str
    unit: str
    weak_sigma: float
    if_unknown: str = ""


_ALONG_ROWS = "the projector's place along its own rows (across the fringes' gradient): fringes along y would tell"
_ROWS_CENTRE = "the row of the projector's principal point: fringes along y would tell"
_ASPECT = "the height of the projector's pixels over their width: fringes along y would tell"
_LENS = "the projector lens's {}: it bends too little of the picture to be seen here"

RIG = (
    *(Unknown(f"camera.{name}", "px", 1.0) for name in ("fx", "fy", "cx", "cy")),
    *(Unknown(f"camera.{name}", "1", 0.01) for name in ("k1", "k2", "p1", "p2")),
    Unknown("camera.inclination", "rad", 0.05, "the angle of the camera to the mirror's normal"),
    Unknown("camera.roll", "rad", 0.05, "the camera's turn about its axis"),
    Unknown("camera.height", "mm", 20.0, "the camera's distance to the mirror"),
    Unknown("glass.slope_x", "1", 0.05, "the glass's slope along x"),
    Unknown("glass.slope_y", "1", 0.05, "the glass's slope along y"),
    Unknown("glass.height", "mm", 20.0, "the distance of the glass"),
    Unknown("stage.axis_x", "1", 0.05, "the stage's axis in x"),
    Unknown("stage.axis_y", "1", 0.05, "the stage's axis in y"),
    Unknown("projector.turn_x", "rad", 0.1, "the projector's turn about x"),
    Unknown("projector.turn_y", "rad", 0.1, "the projector's turn about y"),
    Unknown("projector.turn_z", "rad", 0.1, "the projector's turn about z"),
    Unknown("projector.aim_column", "px", 100.0, "where the projector is aimed at"),
    Unknown("projector.aside", "mm", 200.0, _ALONG_ROWS),
    Unknown("projector.magnification", "px/mm", 0.5, "the pitch of the fringes"),
    Unknown("projector.focal", "px", 1000.0, "the projector's focal length and with it its distance"),
    Unknown("projector.aspect", "1", 0.2, _ASPECT),
    Unknown("projector.cx", "px", 150.0, "the column of the projector's principal point"),
    Unknown("projector.cy", "px", 300.0, _ROWS_CENTRE),
    Unknown("projector.k1", "1", 1.0, _LENS.format("k1")),
    Unknown("projector.k2", "1", 2.0, _LENS.format("k2")),
    Unknown("projector.p1", "1", 0.01, _LENS.format("tangential p1")),
    Unknown("projector.p2", "1", 0.01, _LENS.format("tangential p2")),
)
PLACES = {unknown.name: place for place, unknown in enumerate(RIG)}
STOOD_FOR = tuple(
    f"projector.{name}" for name in ("turn_x", "turn_y", "aside", "focal", "aspect", "cx", "cy", "k1", "k2", "p1", "p2")
)
_HELD = 1e-4  # of the weak sigmas
_FOCAL_SHARE = 0.3  # the first guess is twice as near


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """All numbers of one calibration, and how they make a rig.

    Attributes
    ----------
    start : ndarray, (P,)
        Where the fit begins, and the middle of the weak assumptions.
    prior_root : ndarray, (P, P)
        R with R (values - start) of unit variance and independent.
    names, units : tuple of str
        P of them.
    origin : RigModel
        Carries what is not estimated: sizes, count, the drawing's place and heading of the camera.
    attitude : ndarray, (3, 3)
        Axes of the projector at no turn: along the axes of M.
    aim_mm : ndarray, (3,)
        Point of the glass on which the projector's numbers are based: the column that a pinhole would show it, the
        magnification there, and how far aside of the projector, along the rows, it lies. What fringes tell precisely
        (column, magnification) stands apart from what they hardly tell, and the fit goes straight.
    views : int
        Number of stage offsets; they follow the rig's numbers, the free-form coefficients come last.
    freeform : Freeform or None
        Free-form terms.
    """

    start: Array
    prior_root: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    origin: RigModel
    attitude: Array
    aim_mm: Array
    views: int
    freeform: Freeform | None = None

    def __len__(self) -> int:
        return len(self.start)

    @property
    def sigmas(self) -> Array:
        """Standard deviations of the numbers before the data are looked at."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.prior_root.T @ self.prior_root))))

    @property
    def offsets(self) -> slice:
        """Where the stage offsets are."""
        return slice(len(RIG), len(RIG) + self.views)

    @property
    def coefficients(self) -> slice:
        """Where the free-form coefficients are."""
        return slice(len(RIG) + self.views, len(self.start))

    def model(self, values: Array) -> RigModel:
        """The rig that these values describe."""
        aimed_at, lens = values[_from("projector.aim_column", 3)], values[_from("projector.focal", 8)]
        column, aside, magnification = aimed_at.tolist()
        focal, aspect, cx, cy, k1, k2, p1, p2 = lens.tolist()
        axes = self.attitude @ _rotation(values[_from("projector.turn_x", 3)]).T
        across, ahead = (column - cx) / magnification, focal / magnification
        along = axes @ self.attitude[1]
        # The place along the rows is counted along an axis of M: what tells it does not depend on the turn.
        rest = (aside - along[0] * across - along[2] * ahead) / along[1]
        aimed = np.array([across, rest, ahead])
        projector = Projector(
            self.origin.projector.size_px,
            axes,
            self.aim_mm - aimed @ axes,
            (focal, aspect * focal),
            (cx, cy),
            (k1, k2, p1, p2, 0.0),
        )
        x, y = values[_from("stage.axis_x", 2)]
        a, b, c = (float(value) for value in values[_from("glass.slope_x", 3)])
        rig = RigModel(
            _intrinsics(values, self.origin.intrinsics),
            _frame(values, self.origin.frame),
            (a, b, c),
            np.array([x, y, -np.sqrt(1 - x * x - y * y)]),
            projector,
            self.origin.count,
        )
        return rig if self.freeform is None else self.freeform.added_to(rig, values[self.coefficients])

    def with_freeform(self, freeform: Freeform, values: Array) -> Unknowns:
        """The same numbers about other values, and free-form coefficients after them.

        On the glass alone the projector is a function of two coordinates: what of its numbers the free-form correction
        can stand for is held where it is, or the fit would wander along curved valleys.
        """
        bounds = freeform.sigmas
        size = len(self)
        held = self.holding(STOOD_FOR, values)
        root = np.zeros((size + len(bounds), size + len(bounds)))
        root[:size, :size] = held.prior_root
        root[size:, size:] = np.diag(1 / bounds)
        return replace(
            self,
            start=np.concatenate([held.start, np.zeros(len(bounds))]),
            prior_root=root,
            names=self.names + freeform.names,
            units=self.units + freeform.units,
            freeform=freeform,
        )

    def holding(self, names: tuple[str, ...], values: Array) -> Unknowns:
        """The same numbers, some of the rig's (none of the camera's lens) held where they are in `values`."""
        root, start = self.prior_root.copy(), self.start.copy()
        for name in names:
            root[PLACES[name], PLACES[name]] /= _HELD
            start[PLACES[name]] = values[PLACES[name]]
        return replace(self, start=start, prior_root=root)


def unknowns_about(
    guess: RigModel,
    aim_mm: Array,
    intrinsics_covariance: Array,
    stage_sigmas_mm: Array,
) -> Unknowns:
    """The numbers about a first guess, without free-form terms.

    Parameters
    ----------
    guess : RigModel
        Where to begin.
    aim_mm : ndarray, (3,)
        Middle of what is lit of the glass.
    intrinsics_covariance : ndarray, (8, 8)
        Of the camera calibration.
    stage_sigmas_mm : ndarray, (views,)
        Accuracy of each stage position.
    """
    attitude = _nearest_axes(guess.projector.axes)
    projector, lens = guess.projector, guess.intrinsics
    views = len(stage_sigmas_mm)
    aimed = projector.axes @ (aim_mm - projector.centre_mm)
    magnification = projector.focal_px[0] / aimed[2]
    column = magnification * aimed[0] + projector.principal_point_px[0]
    turn = np.ravel(cv2.Rodrigues(projector.axes.T @ attitude)[0])
    normal = guess.frame.axes[2]
    start = np.concatenate(
        [
            [*lens.focal_px, *lens.principal_point_px, *lens.distortion[:4]],
            [np.arccos(-normal[2]), np.arctan2(normal[1], normal[0]), guess.frame.camera_mm[2]],
            guess.glass,
            guess.stage_axis[:2] / np.linalg.norm(guess.stage_axis),
            turn,
            [column, attitude[1] @ (aim_mm - projector.centre_mm), magnification],
            [projector.focal_px[0], projector.focal_px[1] / projector.focal_px[0]],
            [*projector.principal_point_px, *projector.distortion[:4]],
            np.zeros(views),
        ]
    )
    sigmas = np.concatenate([[unknown.weak_sigma for unknown in RIG], stage_sigmas_mm])
    sigmas[PLACES["projector.focal"]] = _FOCAL_SHARE * projector.focal_px[0]
    sigmas[PLACES["projector.aspect"]] *= projector.focal_px[1] / projector.focal_px[0]
    root = np.diag(1 / sigmas)
    root[:INTRINSICS, :INTRINSICS] = np.linalg.cholesky(np.linalg.inv(intrinsics_covariance)).T
    names = tuple(unknown.name for unknown in RIG) + tuple(f"stage.offset_{k + 1}" for k in range(views))
    units = tuple(unknown.unit for unknown in RIG) + ("mm",) * views
    return Unknowns(start, root, names, units, guess, attitude, aim_mm, views)


def _from(name: str, count: int) -> slice:
    return slice(PLACES[name], PLACES[name] + count)


def _rotation(vector: Array) -> Array:
    return np.asarray(cv2.Rodrigues(np.ascontiguousarray(vector))[0])


def _intrinsics(values: Array, origin: Intrinsics) -> Intrinsics:
    fx, fy, cx, cy, k1, k2, p1, p2 = (float(value) for value in values[:INTRINSICS])
    return Intrinsics(origin.size_px, (fx, fy), (cx, cy), (k1, k2, p1, p2, origin.distortion[4]))


def _frame(values: Array, origin: ReferenceFrame) -> ReferenceFrame:
    inclination, roll, height = values[_from("camera.inclination", 3)]
    across = np.sin(inclination)
    normal = np.array([across * np.cos(roll), across * np.sin(roll), -np.cos(inclination)])
    mirror = Plane(-normal / height, np.zeros((3, 3)), 0.0, 0)
    x, y = origin.camera_mm[:2]
    heading = float(origin.axes[0, 2]), float(origin.axes[1, 2])
    return reference_frame(mirror, camera_xy_mm=(float(x), float(y)), heading=heading)


def _nearest_axes(axes: Array) -> Array:
    """Axes of M, with signs, that are nearest to the projector's."""
    nearest = np.zeros((3, 3))
    free = [0, 1, 2]
    for row in (2, 0, 1):
        best = max(free, key=lambda k: abs(axes[row, k]))
        nearest[row, best] = np.sign(axes[row, best])
        free.remove(best)
    return nearest
