"""The self-calibrated rig as files: in `calibration.json` what a person reads, in `rig_variations.json` the rest.

Numbers in JSON keep every digit: the model that is read is the one that was estimated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Intrinsics, ReferenceFrame
from irpmd_rig.core.calibration.rig_calibration import RigCalibration
from irpmd_rig.core.rig_model import Correction, Projector, RigModel
from irpmd_rig.processing.archive import Content

VARIATIONS = "rig_variations.json"


def rig_content(calibration: RigCalibration, positions_mm: Sequence[float]) -> Content:
    """Everything of a rig's calibration but its variations, as JSON.

    Parameters
    ----------
    calibration
        What was estimated.
    positions_mm
        Stage positions of its views, as the stage read them.
    """
    return {
        "model": model_content(calibration.model),
        "parameters": [
            {"name": p.name, "value": p.value, "sigma": p.sigma, "unit": p.unit} for p in calibration.parameters
        ],
        "covariance": calibration.covariance.tolist(),
        "covariance_is": "of the parameters in their order and units, inflated for correlated residuals",
        "inflation": calibration.inflation,
        "chi2_per_dof": calibration.chi2_per_dof,
        "chi2_by_region": dict(calibration.chi2_by_region),
        "positions_mm": list(positions_mm),
        "stage_offsets_mm": list(calibration.stage_offsets_mm),
        "flexible": calibration.flexible,
        "flexible_is": "whether the glass's bow and a correction of the phase over it were needed and used",
        "along_y": calibration.along_y,
        "along_y_is": "whether the model holds for fringes along y: without, they are not used",
        "undetermined": list(calibration.undetermined),
        "variations": f"{VARIATIONS}: models displaced by one sigma along independent directions",
    }


def variations_content(calibration: RigCalibration) -> Content:
    """Models displaced by one sigma, as JSON."""
    return {"models": [model_content(model) for model in calibration.variations]}


def read_variations(content: Content) -> tuple[RigModel, ...]:
    """Read what `variations_content` wrote; raises KeyError, TypeError or ValueError if something is wrong."""
    return tuple(read_model(model) for model in content["models"])


def model_content(model: RigModel) -> Content:
    """Write a model as JSON."""
    lens, projector = model.intrinsics, model.projector
    return {
        "intrinsics": {
            "size_px": list(lens.size_px),
            "focal_px": list(lens.focal_px),
            "principal_point_px": list(lens.principal_point_px),
            "distortion": list(lens.distortion),
        },
        "camera_mm": model.frame.camera_mm.tolist(),
        "axes_in_camera": model.frame.axes.tolist(),
        "glass": list(model.glass),
        "glass_is": "a, b, c of z = a x + b y + c in frame M at stage1 = 0",
        "stage_axis": model.stage_axis.tolist(),
        "projector": {
            "size_px": list(projector.size_px),
            "axes": projector.axes.tolist(),
            "centre_mm": projector.centre_mm.tolist(),
            "focal_px": list(projector.focal_px),
            "principal_point_px": list(projector.principal_point_px),
            "distortion": list(projector.distortion),
        },
        "count": model.count,
        "bow_mm": _correction_content(model.bow_mm),
        "correction_rad": _correction_content(model.correction_rad),
    }


def read_model(content: Content) -> RigModel:
    """Make a model again; raises KeyError, TypeError, ValueError or CalibrationError if something is wrong."""
    lens, projector = content["intrinsics"], content["projector"]
    a, b, c = content["glass"]
    return RigModel(
        intrinsics=Intrinsics(
            tuple(lens["size_px"]),
            tuple(lens["focal_px"]),
            tuple(lens["principal_point_px"]),
            tuple(lens["distortion"]),
        ),
        frame=ReferenceFrame(_array(content["axes_in_camera"], (3, 3)), _array(content["camera_mm"], (3,))),
        glass=(float(a), float(b), float(c)),
        stage_axis=_array(content["stage_axis"], (3,)),
        projector=Projector(
            tuple(projector["size_px"]),
            _array(projector["axes"], (3, 3)),
            _array(projector["centre_mm"], (3,)),
            tuple(projector["focal_px"]),
            tuple(projector["principal_point_px"]),
            tuple(projector["distortion"]),
        ),
        count=float(content["count"]),
        bow_mm=_correction(content["bow_mm"]),
        correction_rad=_correction(content["correction_rad"]),
    )


def _correction_content(correction: Correction | None) -> Content | None:
    if correction is None:
        return None
    return {
        "x_mm": list(correction.x_mm),
        "y_mm": list(correction.y_mm),
        "coefficients": correction.coefficients.tolist(),
    }


def _correction(content: Content | None) -> Correction | None:
    if content is None:
        return None
    return Correction(tuple(content["x_mm"]), tuple(content["y_mm"]), np.array(content["coefficients"], np.float64))


def _array(values: object, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"not {shape} finite numbers: {values!r}")
    return array
