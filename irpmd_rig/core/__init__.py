"""The measurement as pure functions on arrays: fringes, phases, calibration, reconstruction, evaluation.

No devices, no files, no clock: what comes in are numpy arrays and frozen values, what goes out too.
"""

from irpmd_rig.core.calibration.geometry import Drawing, RigGeometry, calibrate_geometry
from irpmd_rig.core.calibration.intrinsics import (
    BoardPose,
    CameraCalibration,
    Checkerboard,
    calibrate_camera,
    find_corners,
)
from irpmd_rig.core.calibration.plate import PlatePlacement, PlateRelation, fit_plate_relation, place_plate
from irpmd_rig.core.camera import Intrinsics, rays
from irpmd_rig.core.evaluation.facets import Facets, find_facets
from irpmd_rig.core.evaluation.influences import AlignmentTolerance, depth_influences
from irpmd_rig.core.evaluation.planes import FacetPlane, fit_facets
from irpmd_rig.core.evaluation.steps import DEFINITION, Influence, Step, step_heights
from irpmd_rig.core.frame import ReferenceFrame, reference_frame
from irpmd_rig.core.fringes import fringe_images
from irpmd_rig.core.phase import AbsolutePhase, CameraResponse, WrappedPhases, decode, wrapped_phases
from irpmd_rig.core.planes import Plane, fit_plane
from irpmd_rig.core.quality import FrameFinding, FrameReport, check_frames
from irpmd_rig.core.reconstruction.direct_depth import direct_depth
from irpmd_rig.core.reconstruction.smooth_reference import SmoothPhase, smooth_reference

__all__ = [
    "DEFINITION",
    "AbsolutePhase",
    "AlignmentTolerance",
    "BoardPose",
    "CameraCalibration",
    "CameraResponse",
    "Checkerboard",
    "Drawing",
    "FacetPlane",
    "Facets",
    "FrameFinding",
    "FrameReport",
    "Influence",
    "Intrinsics",
    "Plane",
    "PlatePlacement",
    "PlateRelation",
    "ReferenceFrame",
    "RigGeometry",
    "SmoothPhase",
    "Step",
    "WrappedPhases",
    "calibrate_camera",
    "calibrate_geometry",
    "check_frames",
    "decode",
    "depth_influences",
    "direct_depth",
    "find_corners",
    "find_facets",
    "fit_facets",
    "fit_plane",
    "fit_plate_relation",
    "fringe_images",
    "place_plate",
    "rays",
    "reference_frame",
    "smooth_reference",
    "step_heights",
    "wrapped_phases",
]
