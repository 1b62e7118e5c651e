"""Frames that others recorded of a real mirror facet, and their own result: OpenCSP (Apache-2.0).

Source: sandialabs/OpenCSP, opencsp/test/data/sofast_fringe. The frames are looked for beside the repository in
shared/data/opencsp, or in the folder that IRPMD_OPENCSP_DIR names.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from irpmd_rig.core.phase import CameraResponse, decode, wrapped_phases

FOLDER = Path(
    os.environ.get("IRPMD_OPENCSP_DIR") or Path(__file__).resolve().parents[2].parent / "shared" / "data" / "opencsp"
)
FRAMES, RESPONSE, EXPECTED = (
    FOLDER / name for name in ("measurement_facet.h5", "image_calibration.h5", "facet_expected.h5")
)
RESULT = "DataSofastCalculation/facet/facet_000"
FINEST = 63.9


@pytest.fixture(scope="module")
def facet():
    """Frames of both axes (ours: steps add), counts, response, mask, and the stored coordinates on the mask."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed: pip install h5py")
    for path in (FRAMES, RESPONSE, EXPECTED):
        if not path.exists():
            pytest.skip(f"{path} is absent: put OpenCSP's files there or name their folder in IRPMD_OPENCSP_DIR")
    with h5py.File(FRAMES) as file:
        stored = file["MeasurementSofastFringe/fringe_images"][()]
        counts = file["MeasurementSofastFringe/fringe_periods_x"][()]
    with h5py.File(RESPONSE) as file:
        response = CameraResponse(*(file[f"ImageCalibration/{k}_values"][()] for k in ("camera", "display")))
    with h5py.File(EXPECTED) as file:
        mask = file[f"{RESULT}/CalculationImageProcessingFacet/mask_processed"][()].astype(bool)
        screen = file[f"{RESULT}/CalculationDataGeometryFacet/v_screen_points_fractional_screens"][()]
    # Stored (H, W, frame), y first, four sets of four steps; their steps go backwards.
    sets = np.moveaxis(stored, 2, 0).reshape(2, 4, 4, *stored.shape[:2])[:, :, [0, 3, 2, 1]]
    assert mask.sum() == 7105
    return {"y": (sets[0], 1 - screen[1]), "x": (sets[1], screen[0])}, counts, response, mask


@pytest.mark.parametrize("axis", ["x", "y"])
def test_facet_agrees_with_the_stored_result(facet, axis):
    axes, counts, response, mask = facet
    frames, expected = axes[axis]
    # The mask is OpenCSP's: it holds a few pixels of less modulation than our gate would take.
    absolute = decode(frames, counts, unwrapping="hierarchical", response=response, min_modulation_dn=5)
    assert absolute.valid[mask].all()
    phase = absolute.phase_rad[mask].astype(float)
    # float32 holds a phase of 400 rad to 3.8e-8 screens: that much, and no more, is lost by it.
    assert np.abs(phase / (2 * np.pi * FINEST) - expected).max() < 1e-7 + 3.9e-8
    wrapped = wrapped_phases(frames, response=response).phase_rad[3][mask].astype(float)
    full = wrapped + 2 * np.pi * np.rint((phase - wrapped) / (2 * np.pi))
    assert np.abs(full / (2 * np.pi * FINEST) - expected).max() < 1e-7


def test_the_default_gate_keeps_nearly_the_whole_facet(facet):
    axes, counts, response, mask = facet
    for frames, _ in axes.values():
        absolute = decode(frames, counts, unwrapping="hierarchical", response=response)
        assert absolute.valid[mask].mean() > 0.999
