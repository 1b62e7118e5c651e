"""Frames of a real measurement (OpenCSP facet, Apache-2.0): non-linear camera, 0.9 to 63.9 fringes, 4 steps.

The data are read from ../shared/data/opencsp beside the checkout, which holds their source and licence.
"""

from pathlib import Path

import numpy as np
import pytest

from irpmd_rig.core.quality import check_frames

DATA = Path(__file__).parents[3] / "shared/data/opencsp/measurement_facet.h5"
COUNTS = (0.9, 3.9, 15.9, 63.9)


@pytest.fixture(scope="module", params=["y", "x"])
def frames(request):
    if not DATA.exists():
        pytest.skip(f"needs the OpenCSP measurement in {DATA.parent}")
    h5py = pytest.importorskip("h5py", reason="install the extra hdf5")
    with h5py.File(DATA) as file:
        images = np.moveaxis(file["MeasurementSofastFringe/fringe_images"][()], -1, 0)
    half = images[:16] if request.param == "y" else images[16:]
    return np.ascontiguousarray(half).reshape(4, 4, *images.shape[1:])


def test_the_real_frames_raise_no_alarm(frames):
    report = check_frames(frames, COUNTS)
    assert report.ok, [f.message for f in report.findings]
    assert report.between_sets_checked
    assert 0.3 < report.noise_dn < 2


@pytest.mark.parametrize(("place", "share"), [(5, 1.0), (8, 0.05), (10, 0.79), (14, 0.05)])
def test_a_blend_put_into_them_is_found(frames, place, share):
    flat = frames.reshape(16, *frames.shape[2:]).astype(float)
    flat[place] = np.round((1 - share) * flat[place] + share * flat[place - 1])
    report = check_frames(flat.astype(np.uint8).reshape(frames.shape), COUNTS)
    assert [(f.set, f.step) for f in report.findings] == [divmod(place, 4)]
    finding = report.findings[0]
    assert finding.kind == ("stale" if share == 1 else "blended")
    assert finding.magnitude == pytest.approx(share, abs=0.02)
