"""What the doctor says about rigs: in order, half there, and not there at all."""

import io
import json
import os
import sys
from pathlib import Path

import pytest
from rich.console import Console

from irpmd_rig.acquisition.rig_file import Device
from irpmd_rig.doctor import doctor, machine
from irpmd_rig.doctor.machine import lacking, modules, rights, shared_library
from irpmd_rig.shipped import CONFIGS

NOTHING = """\
name: empty bench
camera:
  driver: harvesters
  producer: nowhere.cti
projector:
  driver: video
  x_display: ":7654"
stage1:
  driver: serial
  port: /dev/nowhere
  dialect: gsc
  counts_per_mm: 1000.0
  sign: 1
  limits_mm: [-80.0, 220.0]
  speed_mm_per_s: 20
stage2:
  driver: serial
  port: socket://127.0.0.1:9
  dialect: gcs
  counts_per_mm: 1000.0
  sign: 1
  limits_mm: [0.0, 200.0]
  speed_mm_per_s: 20
"""


def told(rig: Path | str, **options) -> tuple[int, str]:
    console = Console(file=io.StringIO(), width=60)
    status = doctor(str(rig), verify=False, as_json=options.get("as_json", False), console=console)
    return status, console.file.getvalue()


@pytest.fixture(scope="module")
def quick_sim(tmp_path_factory):
    """Rig file of the shipped simulated rig with a small camera and a world of its own."""
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    text = (CONFIGS / "rigs" / "sim.yaml").read_text(encoding="utf-8")
    world = CONFIGS.resolve() / "worlds" / "misaligned.yaml"
    simulation = "simulation: {private: true, size_px: 64, time_scale: 20}\n"
    path.write_text(simulation + text.replace("../worlds/misaligned.yaml", str(world)), encoding="utf-8")
    return path


def test_the_simulated_rig_is_in_order(quick_sim):
    status, text = told(quick_sim)
    assert status == 0
    assert "everything is in order" in text
    assert "serial number: SIM00001" in text
    assert "unverified: never run on a real LightCommander" in text
    assert "position: 0.000 mm, measured" in text
    status, text = told(quick_sim, as_json=True)
    report = json.loads(text)
    assert (status, report["clean"], report["simulated"]) == (0, True, True)
    assert [device["name"] for device in report["devices"]] == ["camera", "projector", "stage1", "stage2"]
    assert all(device["state"] == "ready" and device["found"]["model"] for device in report["devices"])
    assert all(device["unverified"] for device in report["devices"])


def test_where_nothing_is_each_instrument_says_what_mends_it(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(NOTHING, encoding="utf-8")
    status, text = told(path)
    assert status == 1
    assert f"wrong: {path}:4:13: the producer {tmp_path}/nowhere.cti does not exist" in text
    assert "mend: set `producer` to a .cti file" in text
    assert "no X server runs as :7654" in text
    assert "there is no serial port /dev/nowhere" in text
    # The name of a dialect is found at its place; a line in the file is not the machine's fault.
    assert f"{path}:19:12: there is no stage dialect 'gcs'" in text
    assert "did you mean 'gsc'?" in text
    assert text.count("wrong:") >= 5


def test_a_rig_file_that_is_wrong_is_told_by_its_places(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(NOTHING.replace("sign: 1", "sing: 1").replace("x_display", "xdisplay"), encoding="utf-8")
    status, text = told(path, as_json=True)
    findings = json.loads(text)["findings"]
    assert status == 1
    assert {finding["what"].split(": ")[0] for finding in findings} >= {
        f"{path}:{at}" for at in ("7:3", "13:3", "21:3")
    }
    assert any("did you mean 'x_display'" in finding["remedy"] for finding in findings)


def test_a_world_that_does_not_start_is_a_finding(quick_sim, tmp_path):
    (tmp_path / "world.yaml").write_text("seed: 1\n", encoding="utf-8")
    text = quick_sim.read_text(encoding="utf-8")
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace(str(CONFIGS.resolve() / "worlds" / "misaligned.yaml"), "world.yaml"), encoding="utf-8")
    status, text = told(path)
    assert status == 1
    assert "the world does not start" in text
    assert "world.yaml" in text


def test_a_command_is_never_broken_into_lines(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(NOTHING, encoding="utf-8")
    longest = max(told(path)[1].splitlines(), key=len)
    assert len(longest) > 60


# --- the machine


def test_a_module_that_is_not_installed_is_named_with_its_extra():
    (finding,) = modules(("json", "no_such_module_anywhere"), "something")
    assert finding.what == "not installed: no_such_module_anywhere"
    assert finding.remedy == "pip install something"
    assert not list(modules(("json",), "something"))


def test_a_library_that_is_not_there_is_named():
    (finding,) = shared_library("libnothing.so.0", "install it")
    assert "libnothing.so.0" in finding.what
    aravis = Device("camera", "camera", "aravis", {"address": "127.0.0.1", "library": "libnothing.so.0"})
    assert "libaravis-0.8-0" in lacking(aravis)[0].remedy
    projector = Device("projector", "projector", "lightcommander", {"library": "/opt/ti/none.so"})
    assert "none.so" in lacking(projector)[0].what


def test_who_may_not_use_the_instruments_is_told_the_rules_and_the_groups(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "UDEV_FOLDERS", (tmp_path,))
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    monkeypatch.setattr(os, "getgroups", list)
    devices = [Device("camera", "camera", "harvesters", {}), Device("stage1", "stage", "serial", {})]
    remedies = [finding.remedy for finding in rights(devices)]
    assert any(f"install -m 644 {machine.RULES} /etc/udev/rules.d/" in remedy for remedy in remedies)
    assert machine.RULES.is_file()
    assert [r.split()[3] for r in remedies if "usermod" in r] == ["plugdev", "dialout"]
    (tmp_path / machine.RULES.name).touch()
    monkeypatch.setattr(os, "getuid", lambda: 0)
    assert rights(devices) == ()


def test_a_session_without_a_display_is_told(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    found = lacking(Device("projector", "projector", "video", {}))
    assert any("no X display" in finding.what for finding in found)


def test_a_driver_of_somebody_else_is_not_judged():
    assert lacking(Device("camera", "camera", "of-somebody-else", {})) == ()


def test_where_the_camera_s_library_is_missing_it_says_what_to_install(tmp_path, monkeypatch):
    # The camera's process sees a machine without it: the module is there by name and cannot be imported.
    (tmp_path / "harvesters").mkdir()
    (tmp_path / "harvesters" / "__init__.py").write_text(
        "raise ModuleNotFoundError('none', name='harvesters')\n", encoding="utf-8"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, sys.path)]))
    path = tmp_path / "rig.yaml"
    path.write_text(NOTHING.replace("  producer: nowhere.cti\n", ""), encoding="utf-8")
    status, text = told(path)
    assert status == 1
    assert "mend: pip install harvesters" in text
