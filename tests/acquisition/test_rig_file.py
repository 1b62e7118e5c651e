"""Rig files: what they hold, and what is said about each thing that is wrong with one."""

import re
from pathlib import Path

import pytest

from drivers.camera.options import HarvestersSettings
from drivers.errors import ConfigurationError
from drivers.projector.screen import ScreenSettings
from drivers.stage.axis import SerialStageSettings
from drivers.values import Led
from irpmd_rig.acquisition import rig_file as models
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.shipped import CONFIGS, shipped_rigs

LAB = """\
name: lab
camera:
  driver: harvesters
projector:
  driver: video
  x_display: ":7"
stage1:
  driver: serial
  port: /dev/ttyUSB0
  dialect: gsc
  counts_per_mm: 1000.0
  sign: 1
  limits_mm: [-80.0, 220.0]
  speed_mm_per_s: 20
"""


def written(folder: Path, text: str, name: str = "rig.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def problems(folder: Path, text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_rig(written(folder, text))
    return str(caught.value)


@pytest.mark.parametrize("name", shipped_rigs())
def test_every_shipped_rig_file_holds(name):
    rig = read_rig(name)
    assert {"camera", "projector", "stage1", "stage2"} == set(rig.devices)
    assert rig.light.led is Led.INFRARED


def test_the_simulated_rigs_name_a_world_that_is_there():
    assert read_rig("sim").world == CONFIGS.resolve() / "worlds" / "misaligned.yaml"
    assert read_rig("sim-gcd.yaml").simulation.stages == "gcd-0301m"


def test_the_example_shows_every_key():
    text = shipped_rigs()["lab.example"].read_text(encoding="utf-8")
    shown = set(re.findall(r"(\w+):", text))
    asked = (
        models._Rig, models.Simulation, models.Light, models.DrawingPlaces, models.Checkerboard, models.Storage,
        models.Service, models.CalibrationLimits, HarvestersSettings, ScreenSettings, SerialStageSettings,
    )  # fmt: skip
    for model in asked:
        assert set(model.model_fields) <= shown, model


def test_what_a_file_does_not_say_has_a_default(tmp_path):
    rig = read_rig(written(tmp_path, LAB))
    assert (rig.light.led, rig.light.intensity, rig.trigger) == (Led.INFRARED, 0.6, "hardware")
    assert (rig.storage.root, rig.storage.reserve_gb, rig.storage.retention_days) == (Path("data"), 2.0, None)
    assert (rig.service.host, rig.service.port) == ("127.0.0.1", 8321)
    assert rig.world is None
    assert rig.drawing is None
    assert list(rig.devices) == ["camera", "projector", "stage1"]


def test_paths_of_instruments_are_relative_to_the_file(tmp_path):
    dialect = (Path(__file__).parents[2] / "drivers/stage/dialects/gsc.yaml").read_text(encoding="utf-8")
    written(tmp_path, dialect, "mine.yaml")
    text = LAB.replace("driver: harvesters", "driver: harvesters\n  producer: lib/my.cti")
    rig = read_rig(written(tmp_path, text.replace("dialect: gsc", "dialect: mine.yaml")))
    assert rig.devices["camera"].settings["producer"] == str(tmp_path / "lib/my.cti")
    assert rig.devices["stage1"].settings["dialect"] == str(tmp_path / "mine.yaml")
    assert rig.devices["stage1"].settings["port"] == "/dev/ttyUSB0"


@pytest.mark.parametrize(
    ("old", "new", "place", "says", "remedy"),
    [
        (
            "driver: harvesters",
            "driver: harvestrs",
            "3:11",
            "no camera driver 'harvestrs'",
            "did you mean 'harvesters'",
        ),
        ("name: lab", "nam: lab", "1:1", "unknown key 'nam'", "did you mean 'name'"),
        ("dialect: gsc", "dialect: gcs", "10:12", "stage1: there is no stage dialect 'gcs'", "did you mean 'gsc'"),
        ("  sign: 1", "  sing: 1", "12:3", "unknown key 'stage1.sing'", "did you mean 'sign'"),
        ("sign: 1", "sign: 2", "12:9", "'stage1.sign'", ""),
        ("[-80.0, 220.0]", "[220.0, -80.0]", "13:14", "'stage1.limits_mm'", "lower limit first"),
        ("speed_mm_per_s: 20", "speed_mm_per_s: 200", "14:19", "a speed of 200 mm/s is out of range", "0.5 to 20"),
        ("  counts_per_mm: 1000.0\n", "", "8:3", "counts_per_mm of this axis is not known", "counts per turn"),
        ("driver: video", "driver: 7", "5:11", "'projector.driver' must be text", ""),
        ("  port: /dev/ttyUSB0\n", "", "7:1", "'stage1.port' is missing", "add port"),
        ("name: lab", "name: lab\nworld: nowhere.yaml", "2:8", "there is no world file", "relative to the rig file"),
        ("name: lab", "name: lab\nsimulation: {seed: 2}", "2:13", "without a 'world'", "add world"),
        ("name: lab", "name: lab\nlight: {led: ultraviolet}", "2:14", "'light.led'", "infrared"),
        ("name: lab", "name: lab\nlight: {intensity: 0.7}", "2:20", "'light.intensity'", "0.6"),
        ("name: lab", "name: lab\ntrigger: soft", "2:10", "'trigger'", "software"),
    ],
)
def test_what_is_wrong_is_told_with_its_place_and_remedy(tmp_path, old, new, place, says, remedy):
    told = problems(tmp_path, LAB.replace(old, new))
    lines = [line for line in told.splitlines() if f"rig.yaml:{place}: " in line]
    assert any(says in line and remedy in line for line in lines), told


def test_a_second_stage_may_be_said_not_to_be(tmp_path):
    assert "stage2" not in read_rig(written(tmp_path, LAB + "stage2: null\n")).devices


def test_all_that_is_wrong_is_told_at_once(tmp_path):
    text = LAB.replace("driver: harvesters", "driver: harvestrs").replace("gsc", "gcs").replace("name: lab", "name: 3")
    assert len(problems(tmp_path, text + "extra: 1\n").splitlines()) == 4


def test_a_profile_that_may_not_be_used_is_found_unless_only_the_form_is_asked_for(tmp_path):
    text = LAB.replace(
        'driver: video\n  x_display: ":7"',
        "driver: lightcommander\n  transport: usb\n  profile: lightcommander\n  sequences: [a.bf]",
    )
    told = problems(tmp_path, text)
    assert "rig.yaml:7:12: projector: the USB profile" in told
    assert "fill it in" in told
    rig = read_rig(tmp_path / "rig.yaml", deep=False)
    assert rig.devices["projector"].settings["sequences"] == (str(tmp_path / "a.bf"),)


def test_a_dialect_file_that_is_wrong_is_told_with_both_places(tmp_path):
    dialect = (Path(__file__).parents[2] / "drivers/stage/dialects/gsc.yaml").read_text(encoding="utf-8")
    written(tmp_path, dialect.replace("framing:", "framin:"), "mine.yaml")
    told = problems(tmp_path, LAB.replace("dialect: gsc", "dialect: mine.yaml"))
    line = 1 + dialect[: dialect.index("framing:")].count("\n")
    assert f"stage1: mine.yaml:{line}:1: unknown key 'framin'; did you mean 'framing'" in told
    assert "rig.yaml:10:12: " in told
    simulated = written(tmp_path, (shipped_rigs()["sim"]).read_text(encoding="utf-8").replace("gsc", "mine.yaml"))
    world = CONFIGS.resolve() / "worlds" / "misaligned.yaml"
    text = simulated.read_text(encoding="utf-8").replace("../worlds/misaligned.yaml", str(world))
    assert "'framin'" in problems(tmp_path, text)


def test_a_driver_s_complaint_is_placed_by_the_path_of_its_setting(tmp_path):
    rig = read_rig(written(tmp_path, LAB))
    problem = rig.problem(ConfigurationError("stage1", "no", "do", ("limits_mm", 1)))
    assert (problem.line, problem.column) == (13, 22)
    assert rig.problem(ConfigurationError("stage1", "no", "do", ("settle_s",))).line == 8


def test_an_unknown_rig_names_the_shipped_ones():
    with pytest.raises(FileNotFoundError, match=r"'simm'.*sim-gcd"):
        read_rig("simm")
