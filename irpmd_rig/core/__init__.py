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
from irpmd_rig.core.calibration.rig_calibrate import calibrate_rig
from irpmd_rig.core.calibration.rig_calibration import NominalProjector, RigCalibration, RigView
from irpmd_rig.core.camera import Intrinsics, rays
from irpmd_rig.core.evaluation.facets import Facets, find_facets
from irpmd_rig.core.evaluation.influences import AlignmentTolerance, Influence, depth_influences
from irpmd_rig.core.evaluation.planes import FacetPlane, fit_facets
from irpmd_rig.core.evaluation.step_report import StepReport, steps_of
from irpmd_rig.core.evaluation.steps import DEFINITION, Step, step_heights
from irpmd_rig.core.frame import ReferenceFrame, reference_frame
from irpmd_rig.core.fringes import fringe_images
from irpmd_rig.core.phase import AbsolutePhase, CameraResponse, WrappedPhases, decode, wrapped_phases
from irpmd_rig.core.phase.pattern_error import PatternError, pattern_error
from irpmd_rig.core.planes import Plane, fit_plane
from irpmd_rig.core.quality import FrameFinding, FrameReport, check_frames
from irpmd_rig.core.reconstruction.direct_depth import direct_depth
from irpmd_rig.core.reconstruction.facet_estimate import Doubts, SurfaceEstimate, estimate_surfaces
from irpmd_rig.core.reconstruction.generalised import generalised_depth
from irpmd_rig.core.reconstruction.phase_filter import filter_phase
from irpmd_rig.core.reconstruction.smooth_reference import SmoothPhase, smooth_reference
from irpmd_rig.core.reconstruction.triangulation import RigTables, rig_tables, triangulate
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.rig_model import Projector, RigModel

__all__ = [
    "DEFINITION",
    "AbsolutePhase",
    "AlignmentTolerance",
    "BoardPose",
    "CameraCalibration",
    "CameraResponse",
    "Checkerboard",
    "DepthMap",
    "Doubts",
    "Drawing",
    "FacetPlane",
    "Facets",
    "FrameFinding",
    "FrameReport",
    "Influence",
    "Intrinsics",
    "NominalProjector",
    "PatternError",
    "Plane",
    "PlatePlacement",
    "PlateRelation",
    "Projector",
    "ReferenceFrame",
    "RigCalibration",
    "RigGeometry",
    "RigModel",
    "RigTables",
    "RigView",
    "SmoothPhase",
    "Step",
    "StepReport",
    "SurfaceEstimate",
    "Views",
    "WrappedPhases",
    "calibrate_camera",
    "calibrate_geometry",
    "calibrate_rig",
    "check_frames",
    "decode",
    "depth_influences",
    "direct_depth",
    "estimate_surfaces",
    "filter_phase",
    "find_corners",
    "find_facets",
    "fit_facets",
    "fit_plane",
    "fit_plate_relation",
    "fringe_images",
    "generalised_depth",
    "pattern_error",
    "place_plate",
    "rays",
    "reference_frame",
    "rig_tables",
    "smooth_reference",
    "step_heights",
    "steps_of",
    "triangulate",
    "wrapped_phases",
]
