"""Loads the compiled kernels of the methods by a measurement in closed form: the first real one is as fast as any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpmd_rig.core import Intrinsics, ReferenceFrame
from irpmd_rig.core.phase.pattern_error import pattern_error
from irpmd_rig.core.reconstruction.depth_equation import equation_depth
from irpmd_rig.core.reconstruction.triangulation import triangulate
from irpmd_rig.core.reconstruction.views import Views
from irpmd_rig.core.rig_model import Projector, RigModel

_COUNTS, _STEPS = (64.0, 63.0, 56.0), 4
_SIZE_PX = 48
_POSITIONS_MM = (0.0, 40.0)


def warm_up_methods() -> None:
    """Remove a pattern error, triangulate and solve the depth equation once, of a plane mirror in the paper's rig."""
    model = _papers_rig()
    views = _plane_mirror(model)
    for phase in views.phases_rad:
        pattern_error(_COUNTS, _STEPS, model.projector.size_px[0]).remove(phase)
    triangulate(views, model)
    # The kernel of more than two views, and of fringes along y.
    triangulate(_thrice(views), model)
    triangulate(replace(views, phases_y_rad=views.phases_rad), model)
    equation_depth(views, views, d_mm=180.0)


def _thrice(views: Views) -> Views:
    """The same views, the last one once more."""
    return replace(
        views,
        positions_mm=(*views.positions_mm, views.positions_mm[-1]),
        phases_rad=(*views.phases_rad, views.phases_rad[-1]),
        sigmas_rad=(*views.sigmas_rad, views.sigmas_rad[-1]),
    )


def _papers_rig() -> RigModel:
    """The paper's rig by its drawing, with a camera of few pixels that sees the reference mirror."""
    sine, cosine = np.sin(np.deg2rad(37.0)), np.cos(np.deg2rad(37.0))
    # Columns are the camera's axes in frame M.
    axes = np.array([[cosine, 0.0, sine], [0.0, -1.0, 0.0], [sine, 0.0, -cosine]])
    lens = Intrinsics((_SIZE_PX, _SIZE_PX), (2355.0, 2355.0), (_SIZE_PX / 2, _SIZE_PX / 2))
    looking_down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    projector = Projector((1024, 768), looking_down, np.array([80.0, 0.0, 1850.0]), (4630.0, 4630.0), (511.5, 383.5))
    return RigModel(
        intrinsics=lens,
        frame=ReferenceFrame(axes, np.array([-200.0, 0.0, 330.0])),
        glass=(0.0, 0.0, 180.0),
        stage_axis=np.array([0.0, 0.0, -1.0]),
        projector=projector,
        count=max(_COUNTS),
    )


def _plane_mirror(model: RigModel) -> Views:
    directions = model.directions()
    reach = -model.frame.camera_mm[2] / directions[..., 2]
    points = model.frame.camera_mm + reach[..., None] * directions
    leaving = directions * (1.0, 1.0, -1.0)
    lit = [model.meet_glass(model.still(points, position), leaving) for position in _POSITIONS_MM]
    phases = tuple(model.phase_rad(points, on_glass=True).astype(np.float32) for points in lit)
    sigmas = tuple(np.full(phase.shape, 0.01, np.float32) for phase in phases)
    return Views(_POSITIONS_MM, phases, sigmas, (slice(0, _SIZE_PX), slice(0, _SIZE_PX)))
