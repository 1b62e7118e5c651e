"""The commands around a rig, as a user types them: doctor, sim, fault."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "irpmd_rig"]


def typed(*arguments, folder, stdin="", **environment):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        cwd=folder,
        input=stdin,
        capture_output=True,
        text=True,
        timeout=380,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A world as `irpmd-rig sim` serves it, and the runtime folder that it is in."""
    runtime = tmp_path_factory.mktemp("run")
    with subprocess.Popen(
        [*COMMAND, "sim", "aligned", "--size-px", "64", "--time-scale", "20"],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "XDG_RUNTIME_DIR": str(runtime)},
    ) as process:  # fmt: skip
        assert process.stdout.readline().startswith(f"ready {runtime}/irpmd-rig/")
        yield str(runtime)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    assert not list((runtime / "irpmd-rig").rglob("*.sock"))


def test_the_doctor_finds_the_shipped_simulated_rig_in_order(served, tmp_path):
    # Of another world than the one that runs: a world of its own is started and ended.
    ended = typed("doctor", "sim", "--json", folder=tmp_path, XDG_RUNTIME_DIR=served)
    assert ended.returncode == 0, ended
    report = json.loads(ended.stdout)
    assert report["clean"]
    assert not list(tmp_path.iterdir())


def test_the_doctor_ends_with_1_where_something_is_to_mend_and_with_2_without_a_rig(tmp_path):
    (tmp_path / "rig.yaml").write_text("name: nothing\n", encoding="utf-8")
    ended = typed("doctor", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 1
    assert "'camera' is missing" in ended.stdout
    ended = typed("doctor", "nowhere.yaml", folder=tmp_path)
    assert ended.returncode == 2
    assert "sim-gcd" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_verify_without_a_terminal_ends_and_leaves_no_record(served, tmp_path):
    world = Path(__file__).parents[1] / "configs" / "worlds" / "aligned.yaml"
    text = (world.parents[1] / "rigs" / "sim.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(text.replace("../worlds/misaligned.yaml", str(world)), encoding="utf-8")
    ended = typed("doctor", "rig.yaml", "--verify", folder=tmp_path, XDG_RUNTIME_DIR=served)
    assert ended.returncode == 1
    assert "Broken off" in ended.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["rig.yaml"]
    ended = typed("doctor", "rig.yaml", "--verify", folder=tmp_path, stdin="Ada\n", XDG_RUNTIME_DIR=served)
    assert ended.returncode == 1
    (record,) = tmp_path.glob("verification-simulated-rig-*.yaml")
    assert "who: Ada" in record.read_text(encoding="utf-8")


def test_faults_are_listed_injected_and_refused(served, tmp_path):
    listed = typed("fault", folder=tmp_path, XDG_RUNTIME_DIR=served)
    assert listed.returncode == 0, listed
    assert "stage_mute" in listed.stdout
    assert typed("fault", "stage_mute", "stage=stage1", folder=tmp_path, XDG_RUNTIME_DIR=served).returncode == 0
    for wrong, says in ((["stage_mut"], "stage_mute"), (["stage_mute", "stage"], "key=value")):
        ended = typed("fault", *wrong, folder=tmp_path, XDG_RUNTIME_DIR=served)
        assert ended.returncode == 2
        assert says in ended.stderr
        assert "Traceback" not in ended.stderr


def test_without_a_world_a_fault_says_how_to_start_one(tmp_path):
    ended = typed("fault", "camera_unplug", folder=tmp_path, XDG_RUNTIME_DIR=str(tmp_path))
    assert ended.returncode == 2
    assert "irpmd-rig sim" in ended.stderr


def test_an_unknown_world_is_refused(tmp_path):
    ended = typed("sim", "nowhere", folder=tmp_path)
    assert ended.returncode == 2
    assert "misaligned" in ended.stderr
