"""Reports of runs that prepare the rig show their figures and begin with what was found."""

import numpy as np
import pytest

from irpmd_rig.report.content import Text
from irpmd_rig.report.reading import read_run
from irpmd_rig.report.run import run_page, write_report
from irpmd_rig.store import ManifestEntry, RunFolder, RunRecord
from irpmd_rig.store.record import write_record

LEVELS = list(range(0, 256, 15))
FOUND = {
    "gamma": {
        "gamma": 1.052, "sigma_gamma": 0.0013, "rms": 0.0008, "levels": LEVELS,
        "light": [(level / 255) ** 1.052 for level in LEVELS], "sigma_light": [0.002] * len(LEVELS),
        "table": [255 * (level / 255) ** (1 / 1.052) for level in range(256)],
    },
    "delay": {
        "after_ms": [0, 10, 20, 30, 40], "light": [0.01, 0.0, 0.4, 1.0, 1.0], "delay_ms": 30.0, "not_before_ms": 10.0,
    },
    "settle": {
        "after_s": [0.0, 0.1, 0.2, 0.3], "off_um": [-9.0, 3.0, -0.5, 0.2], "sigma_um": 0.3, "still_um": 1.0,
        "settle_s": 0.2, "largest_um": 9.0,
    },
    "stage-axis": {
        "drift": [1.75e-3, 2.0e-4], "sigma_drift": [2e-5, 3e-5], "scale": 1.0002, "sigma_scale": 4e-5,
        "positions_mm": [-40.0, 0.0, 40.0], "off_line_um": [[0.5, -0.2, 0.1], [0.0, 0.0, 0.0], [-0.4, 0.3, 0.0]],
    },
    "focus": {
        "counts": [16, 32, 64, 128], "contrast": [1.0, 0.98, 0.92, 0.71], "blur_px": 0.83,
        "blur_cells_px": [[0.8, 0.82], [None, 0.9]],
    },
    "exposure": {
        "exposures_us": [1000.0, 2000.0, 4000.0, 8000.0], "bright": [0.2, 0.4, 0.8, 1.0],
        "saturated": [0, 0, 0, 0.2], "recommended_us": 4250.0, "nonlinearity": 0.004, "noise_floor_dn": 0.4,
        "shot_dn": 0.02,
    },
}  # fmt: skip
SAID = {
    "gamma": ("Gamma 1.0520 ± 0.0013", None, {"gamma", "compensation"}),
    "delay": ("All light is there 30.0 ms after the order", None, {"delay"}),
    "settle": ("Within 1 µm from 0.200 s on", True, {"settle"}),
    "stage-axis": (
        "A mm away from the glass shifts the mirror by 1.750 ± 0.020 µm along x and 0.200 ± 0.030 µm along y",
        None,
        {"off_line"},
    ),
    "focus": ("Blur of 0.830 projector pixels (rms)", None, {"contrast", "blur"}),
    "exposure": ("Expose for 4250 µs", True, {"exposure"}),
}


def page_of(folder, kind, content):
    folder.mkdir()
    write_record(RunRecord(kind=kind, name="a run"), folder / "run.yaml")
    run = RunFolder(folder)
    run.write_frame(np.full((48, 64), 100, np.uint8), ManifestEntry(label="mirror", role="white"))
    run.flush()
    run.close()
    whole = {"kind": kind, "size_px": [64, 48], "uses": {}, "versions": {}, "words": "In words.", **content}
    run.results.write_json("result.json", whole)
    write_report(run)
    return run_page(read_run(run, None))


@pytest.mark.parametrize("what", FOUND)
def test_what_is_characterised_is_drawn(tmp_path, what):
    page = page_of(tmp_path / "run", "characterise", {"what": what, **FOUND[what]})
    headline, passed, pictures = SAID[what]
    assert (page.verdict.headline, page.verdict.passed) == (headline, passed)
    assert {picture.name for picture in page.pictures} == {*pictures, "frames"}
    assert Text("In words.") in page.sections[0].blocks


@pytest.mark.parametrize(
    ("what", "unknown", "headline"),
    [
        ("settle", {"settle_s": None}, "The stage did not come to rest within 1 µm"),
        ("exposure", {"recommended_us": None, "nonlinearity": None}, "No exposure can be recommended"),
    ],
)
def test_what_was_not_found_is_no_success(tmp_path, what, unknown, headline):
    page = page_of(tmp_path / "run", "characterise", {"what": what, **FOUND[what], **unknown})
    assert (page.verdict.headline, page.verdict.passed) == (headline, False)


@pytest.mark.parametrize("aligned", [True, False])
def test_the_glass_is_drawn_round_by_round_beside_the_tolerance(tmp_path, aligned):
    rounds = [
        {"about_x_deg": x, "about_y_deg": y, "sigma_about_x_deg": 0.002, "sigma_about_y_deg": 0.001}
        for x, y in ((0.21, -0.12), (-0.06, 0.011), (0.008, 0.002 if aligned else 0.1))
    ]
    content = {"rounds": rounds, "tolerance_deg": 0.03, "aligned": aligned, "next": None if aligned else "Turn it."}
    page = page_of(tmp_path / "run", "align", content)
    assert page.verdict.passed is aligned
    assert page.verdict.told == ("" if aligned else "Turn it.")
    assert "0.0080 ± 0.0020° about x" in page.verdict.headline
    x, y, limit = page.pictures[0].figure.axes[0].lines
    assert x.get_ydata().tolist() == [0.21, 0.06, 0.008]
    assert y.get_ydata()[0] == 0.12
    assert set(limit.get_ydata()) == {0.03}
