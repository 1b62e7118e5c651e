"""What may not be used, and what cannot be computed: said in words, with the reason of a run's end."""

import json
import shutil
from contextlib import contextmanager

import numpy as np
import pytest
import tifffile

from irpmd_rig.processing import FramesUnusable, ProcessingError, Refused
from irpmd_rig.processing.chain import Chain, age_days, check_uses
from irpmd_rig.processing.process import process, reconstruct
from irpmd_rig.processing.wishes import align_wishes, settle_wishes
from irpmd_rig.store import Fringes, Optics, Reason, RunFolder, RunRecord


@pytest.fixture
def copied(chain, tmp_path):
    """A measurement that may be spoilt."""
    path = tmp_path / "run"
    shutil.copytree(chain.folders["measure"].path, path, ignore=shutil.ignore_patterns("results"))
    return RunFolder(path)


def refusal(chain, record):
    with pytest.raises(Refused) as caught:
        check_uses(record, chain.runs.library)
    assert caught.value.reason is Reason.REFUSED
    return str(caught.value)


def record_of(chain, **changes):
    return chain.folders["measure"].record().model_copy(update=changes)


def test_what_fits_is_found_before_anything_moves(chain):
    uses = check_uses(record_of(chain), chain.runs.library)
    assert uses == chain.processed["measure"].uses


def test_a_reference_at_other_positions_is_refused(chain):
    said = refusal(chain, record_of(chain, positions_mm=(0.0, 30.0)))
    assert "0, 40 mm, not at 30 mm (in-position window 0.01 mm)" in said
    near = record_of(chain, positions_mm=(0.009, 40.01))
    assert check_uses(near, chain.runs.library)
    assert "not at 0.011 mm" in refusal(chain, record_of(chain, positions_mm=(0.011, 40.0)))


def test_another_camera_is_refused_by_every_calibration_at_once(chain):
    other = Optics(camera_serial="XM-0002", size_px=(384, 384))
    said = refusal(chain, record_of(chain, optics=other))
    assert said.count("was made with camera XM-0001, this is XM-0002") == 4


def test_another_picture_size_is_refused(chain):
    other = Optics(camera_serial="XM-0001", size_px=(2048, 2048))
    assert "384 x 384 px, the frames have 2048 x 2048" in refusal(chain, record_of(chain, optics=other))


def test_a_calibration_that_is_too_old_is_refused_where_the_rig_file_says_so(chain):
    rig = {**chain.folders["measure"].record().rig, "calibration": {"max_age_days": 1e-9}}
    said = refusal(chain, record_of(chain, rig=rig))
    assert "days old, the rig file allows 1e-09" in said


def test_a_run_that_is_no_calibration_or_not_there_is_refused(chain):
    camera = chain.folders["calibrate-camera"].id
    assert "is a calibrate-camera" in refusal(chain, record_of(chain, uses={"reference": camera}))
    assert "no run" in refusal(chain, record_of(chain, uses={"reference": "20200101-000000-000000"}))


def test_what_a_recipe_names_is_used_unless_run_yaml_says_another(chain):
    record = record_of(chain, recipe={"calibration": chain.folders["calibrate-camera"].id, "reference": "active"})
    assert "is a calibrate-camera" in refusal(chain, record)
    geometry = chain.folders["calibrate-geometry"].id
    named = record.model_copy(update={"uses": {"calibrate-geometry": geometry}})
    assert check_uses(named, chain.runs.library)["calibrate-geometry"] == geometry


def test_a_reference_of_another_camera_calibration_is_refused(chain):
    folder = chain.folders["reference"]
    content = folder.results.read_json("calibration.json")
    spoilt = {**content, "uses": {**content["uses"], "calibrate-camera": "20200101-000000-000000"}}
    path = folder.results.path("calibration.json")
    original = path.read_text()
    try:
        path.write_text(json.dumps(spoilt))
        assert "the optics differ" in refusal(chain, record_of(chain))
        path.write_text("{")
        assert "not JSON" in refusal(chain, record_of(chain))
        path.write_text("{}")
        assert refusal(chain, record_of(chain))
    finally:
        path.write_text(original)


@contextmanager
def changed(folder, **parts):
    """A calibration or reference with other content for a while."""
    path = folder.results.path("calibration.json")
    original = path.read_text()
    try:
        path.write_text(json.dumps({**json.loads(original), **parts}))
        yield
    finally:
        path.write_text(original)


def test_a_reference_from_before_the_geometry_was_calibrated_again_is_off(chain):
    reference = chain.folders["reference"]
    uses = {**reference.results.read_json("calibration.json")["uses"], "calibrate-geometry": "20200101-000000-000000"}
    record = record_of(chain)
    with changed(reference, uses=uses):
        assert check_uses(record, chain.runs.library)  # taken after it
    with changed(reference, created="2020-01-01T00:00:00+00:00"):
        assert check_uses(record, chain.runs.library)  # goes with it
    with changed(reference, uses=uses, created=None):
        assert check_uses(record, chain.runs.library)
    with changed(reference, uses=uses, created="2020-01-01T00:00:00"):
        said = refusal(chain, record)
        assert "goes with calibrate-geometry 20200101-000000-000000 and is older than" in said
        marked = record_of(chain, recipe={**record.recipe, "if_calibration_is_off": "mark"})
        assert "is older than" in "; ".join(Chain(marked, chain.runs.library).off)


def test_a_calibration_of_unknown_age_is_refused_where_the_rig_file_limits_it(chain):
    rig = {**chain.folders["measure"].record().rig, "calibration": {"max_age_days": 30}}
    with changed(chain.folders["calibrate-plate"], created=None):
        assert check_uses(record_of(chain), chain.runs.library)
        said = refusal(chain, record_of(chain, rig=rig))
    assert "does not say when it was taken, the rig file allows 30 days" in said


def test_a_time_without_offset_is_utc():
    naive, aware = (age_days({"created": f"2026-01-01T00:00:00{offset}"}) for offset in ("", "+00:00"))
    assert naive == pytest.approx(aware, abs=1e-3)
    assert age_days({}) is None


def test_other_fringes_are_refused_before_anything_moves(chain):
    said = refusal(chain, record_of(chain, fringes=Fringes(counts=(32, 31, 28), steps=4)))
    assert "has 64 fringes at the finest, this run 32" in said


def test_a_reference_of_other_fringes_is_not_taken_by_a_method_that_needs_none(chain):
    model = {"rig_model": {"chi2_per_dof": 1.0}}
    with (
        changed(chain.folders["calibrate-geometry"], **model),
        changed(chain.folders["reference"], counts=[32, 31, 28]),
    ):
        without = Chain(record_of(chain), chain.runs.library)
        assert "reference" not in without.uses
        assert "has 32 fringes at the finest, this run 64" in without.without_reference
        assert "reference" not in check_uses(record_of(chain), chain.runs.library)


def test_a_recipe_part_without_its_figures_has_the_recipes_own():
    turns = align_wishes(RunRecord(kind="align"))
    assert (turns.tolerance_deg, turns.rounds) == (0.03, 5)
    assert settle_wishes(RunRecord(kind="characterise", recipe={"what": "settle"})).still_um == 1.0
    with pytest.raises(ProcessingError, match=r"recipe\.still_um"):
        settle_wishes(RunRecord(kind="characterise", recipe={"still_um": "little"}))


def test_a_rig_part_that_is_wrong_is_said(chain):
    with pytest.raises(ProcessingError, match=r"rig\.stage1\.in_position_mm"):
        check_uses(record_of(chain, rig={"stage1": {"in_position_mm": "wide"}}), chain.runs.library)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda lines: lines[:-1], "23 frames|11 frames for 12 patterns: set 2 step 3 is missing"),
        (lambda lines: [*lines, lines[-1]], "13 frames for 12 patterns"),
        (lambda lines: lines[:12], "1 stage positions; a depth takes two or more"),
        (lambda lines: [line | {"stage1_mm": None} for line in lines], "stage1_mm of the object frames is not known"),
        (lambda lines: [line | {"stage1_mm": float(n)} for n, line in enumerate(lines)], "goes from 0.0 to 11.0"),
        (lambda lines: [line | {"label": "mirror"} for line in lines], "no fringe frames labelled 'object'"),
        (lambda lines: [line | {"path": "../run.yaml"} for line in lines], "cannot be read"),
        (lambda lines: [line | {"path": "run.yaml"} for line in lines], "cannot be read"),
        (lambda lines: [line | {"counts": [64, 63]} for line in lines], "12 frames for 8 patterns"),
    ],
)
def test_a_folder_that_is_not_complete_cannot_be_computed(chain, copied, spoil, said):
    manifest = copied.path / "manifest.jsonl"
    lines = spoil([json.loads(line) for line in manifest.read_text().splitlines()])
    manifest.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(FramesUnusable, match=said) as caught:
        process(copied, chain.runs.library, lambda _: None)
    assert caught.value.reason is Reason.FRAME_QUALITY
    assert copied.results.names() == ()


def test_frames_that_were_not_checked_are_checked_and_refused(chain, copied):
    entries = copied.manifest()
    lines = [json.loads(entry.line()) | {"checks": {}} for entry in entries]
    (copied.path / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    first, second = (copied.path / entries[k].path for k in (4, 5))
    stale = tifffile.imread(first)
    tifffile.imwrite(second, stale)
    with pytest.raises(FramesUnusable, match=r"station 0 .*set 1 step 1"):
        process(copied, chain.runs.library, lambda _: None)
    assert copied.results.names() == ()  # the depth map that was there before the check is none


def test_frames_of_more_bits_than_the_manifest_says_are_refused_with_what_to_write(chain, copied):
    lines = [json.loads(entry.line()) for entry in copied.manifest()]
    for line in lines:
        for key in ("bits", "sha256", "checks"):
            line.pop(key, None)
        frame = tifffile.imread(copied.path / line["path"])
        tifffile.imwrite(copied.path / line["path"], frame.astype(np.uint16) * 16)
    (copied.path / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(FramesUnusable, match='"bits": 12'):
        process(copied, chain.runs.library, lambda _: None)


def test_a_frame_that_changed_since_it_was_taken_is_noticed(chain, copied):
    path = copied.path / copied.manifest()[3].path
    tifffile.imwrite(path, tifffile.imread(path)[::-1])
    with pytest.raises(FramesUnusable, match="1 frames are missing or damaged: frames/00003"):
        reconstruct(copied.path, chain.runs.library, lambda _: None)
    path.unlink()
    with pytest.raises(FramesUnusable, match="00003"):
        reconstruct(copied.path, chain.runs.library, lambda _: None)


def test_an_object_that_reflects_nothing_has_no_depth(chain, copied):
    rng = np.random.default_rng(0)
    for entry in copied.manifest():
        noise = rng.integers(0, 4, (384, 384), dtype=np.uint8)
        tifffile.imwrite(copied.path / entry.path, noise)
    with pytest.raises(ProcessingError, match="no pixel has a depth; check that the object"):
        process(copied, chain.runs.library, lambda _: None)


def test_calibrating_needs_to_know_board_and_drawing(chain, tmp_path):
    for kind, missing in (("calibrate-camera", "checkerboard"), ("calibrate-geometry", "drawing")):
        path = tmp_path / kind
        shutil.copytree(chain.folders[kind].path, path, ignore=shutil.ignore_patterns("results"))
        folder = RunFolder(path)
        rig = {key: value for key, value in folder.record().rig.items() if key != missing}
        folder.amend(rig=rig)
        with pytest.raises(ProcessingError, match=f"{missing} is not known; give rig.{missing} in run.yaml"):
            process(folder, chain.runs.library, lambda _: None)


def test_a_folder_without_run_yaml_is_said(chain, tmp_path):
    with pytest.raises(ProcessingError, match=r"run\.yaml"):
        process(RunFolder(tmp_path), chain.runs.library, lambda _: None)
