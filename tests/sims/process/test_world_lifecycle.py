"""How the world's process begins and ends, and what its control line answers."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from serial import Serial
from typer.testing import CliRunner
from world_client import WORLD, Refusal, ServedWorld, ask

from sims.__main__ import app

ENDS_WITHIN_S = 15.0
SMALL = ("--size-px", "128")


def await_gone(pid: int) -> float:
    """Seconds until a process is gone, or a zombie that nobody waits for."""
    start_s = time.monotonic()
    while time.monotonic() - start_s < 2 * ENDS_WITHIN_S:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].startswith("Z"):
                break
        except OSError:
            break
        time.sleep(0.02)
    return time.monotonic() - start_s


def test_hello_tells_all_that_a_rig_needs(world: ServedWorld) -> None:
    hello = world.hello
    assert hello["world"] == str(WORLD.resolve())
    assert hello["pid"] == world.process.pid
    assert (hello["name"], hello["seed"], hello["camera_size_px"]) == ("aligned", 5, [320, 320])
    assert (hello["time_scale"], hello["replay"], hello["stages"]) == (20.0, False, "gsc")
    for path in (hello["producer"], hello["usb_argument"], *hello["ports"].values(), *hello["sequences"]):
        assert Path(path).exists()
    assert hello["drawing"] == {
        "camera_xy_mm": [-160.0, 0.0],
        "heading": [pytest.approx(0.6018150), 0.0],
        "d_point_mm": [125.0, 0.0],
    }
    assert hello["board"] == {"squares": [12, 14], "square_mm": 10.0, "poses": 30}
    assert hello["stage1_travel_mm"] == [-80.0, 220.0]
    assert hello["stage2_travel_mm"] == [0.0, 200.0]
    assert set(hello["objects"]) < set(hello["subjects"])
    assert {"mirror", "plate", "board", "board_on_plate", "nothing"} <= set(hello["subjects"])


@pytest.mark.parametrize(
    ("call", "arguments", "complaint"),
    [
        ("plaice", {}, "did you mean 'place'"),
        ("place", {"subject": "mirorr"}, "there is no subject 'mirorr'"),
        ("place", {"subject": "board", "pose": 30}, "poses 0 to 29, not 30"),
        ("place", {"subject": "mirror", "pose": 1}, "poses 0 to 0, not 1"),
        ("place", {"subject": "board", "pose": 1.5}, "pose: Input should be a valid integer"),
        ("place", {}, "'subject' is missing"),
        ("place", {"subject": "mirror", "glas": True}, "there is no 'glas' here"),
        ("glass", {"present": "yes"}, "present: Input should be a valid boolean"),
        ("lamp", {"on": 1}, "on: Input should be a valid boolean"),
        ("fault", {"name": "camera_unplugged"}, "did you mean 'camera_unplug'"),
        ("fault", {}, "there is no fault 'None'"),
        ("fault", {"name": "frame_dropped", "frames": 0}, "frames: Input should be greater than or equal to 1"),
        ("fault", {"name": "stage_stall"}, "'stage' is missing"),
        ("fault", {"name": "stage_stall", "stage": "stage3"}, "Input should be 'stage1' or 'stage2'"),
        ("fault", {"name": "camera_hang", "frames": 1}, "there is no 'frames' here"),
        ("faults", {"seed": -1}, "seed"),
        ("faults", {"seed": 1, "rate_per_s": 0}, "rate_per_s"),
        ("faults", {"seed": 1, "names": ["camera_replug"]}, "no fault 'camera_replug' can come at random"),
    ],
)
def test_a_wrong_call_is_refused_and_says_why(
    world: ServedWorld, call: str, arguments: dict[str, object], complaint: str
) -> None:
    with pytest.raises(Refusal) as refused:
        world(call, **arguments)
    assert complaint in str(refused.value)


@pytest.mark.parametrize(
    "request_", [b"\n", b"[]\n", b'{"call": 3}\n', b"\xff\xfe\n", b"[" * 30_000 + b"\n", b"x" * 70_000 + b"\n"]
)
def test_garbage_on_the_control_line_is_answered(world: ServedWorld, request_: bytes) -> None:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(30)
        connection.connect(str(world.folder / "control.sock"))
        connection.sendall(request_)
        assert connection.makefile("rb").readline().startswith(b'{"ok": false, "error": "')
    assert world("state")["subject"]


def test_a_client_that_goes_away_leaves_the_line_to_others(world: ServedWorld) -> None:
    for half in (b"", b'{"call": "st'):
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(world.folder / "control.sock"))
            connection.sendall(half)
    assert world("state")["subject"]


def test_a_folder_in_use_is_refused(world: ServedWorld) -> None:
    with ServedWorld(world.folder, *SMALL, start=False) as second:
        status, errors = second.end()
    assert status == 2
    assert errors == f"error: another world is served in {world.folder}: end it, or name another --folder\n"
    assert world("state")["subject"]


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--seed", "-1"), "a seed is a whole number"),
        (("--size-px", "3"), "64 to 8192"),
        (("--folder", "/proc/nowhere"), "cannot be used"),
        (("--folder", f"/tmp/{'x' * 100}"), "too long a path"),
    ],
)
def test_wrong_options_are_refused(tmp_path: Path, options: tuple[str, ...], complaint: str) -> None:
    result = CliRunner().invoke(app, ["serve", str(WORLD), "--folder", str(tmp_path / "world"), *SMALL, *options])
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert complaint in result.stderr


def test_a_wrong_script_of_faults_ends_it(tmp_path: Path) -> None:
    script = tmp_path / "script.yaml"
    script.write_text("script:\n- {at_s: 1, fault: camera_unplugged}\n")
    folder = tmp_path / "world"
    with ServedWorld(folder, *SMALL, "--faults", str(script), start=False) as served:
        status, errors = served.end()
    assert (status, list(folder.iterdir())) == (2, [])
    assert errors == "error: script.yaml:2:20: there is no fault 'camera_unplugged'; did you mean 'camera_unplug'?\n"


@pytest.mark.parametrize("how", ["SIGTERM", "SIGINT"])
def test_it_ends_and_leaves_nothing_but_the_folder(tmp_path: Path, how: str) -> None:
    with ServedWorld(tmp_path, *SMALL) as served:
        start_s = time.monotonic()
        served.process.send_signal(signal.Signals[how])
        status, errors = served.end()
        assert time.monotonic() - start_s < ENDS_WITHIN_S
    assert (status, errors) == (0, "")
    assert list(tmp_path.iterdir()) == []


def test_it_ends_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    # The parent is a process of its own, which can be killed without the test.
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import subprocess, sys; world = subprocess.Popen(sys.argv[1:], stdin=subprocess.PIPE); world.wait()",
            *(sys.executable, "-m", "sims", "serve", str(WORLD)),
            *("--folder", str(tmp_path), *SMALL, "--until-stdin-closes"),
        ],
        stdout=subprocess.PIPE,
    )
    assert parent.stdout is not None
    with parent.stdout:
        assert parent.stdout.readline().startswith(b"ready")
        pid = ask(tmp_path, "hello")["pid"]
        parent.kill()
        parent.wait()
        assert await_gone(pid) < ENDS_WITHIN_S
    assert list(tmp_path.iterdir()) == []


def test_it_ends_in_time_whatever_still_works(tmp_path: Path) -> None:
    with ServedWorld(tmp_path, *SMALL, "--time-scale", "0.01") as served:
        served("fault", name="stage_slow", stage="stage1", seconds=100.0)
        # An answer that is held back, in a world whose seconds take a hundred.
        with Serial(served.hello["ports"]["stage1"], 9600) as line:
            line.write(b"!:\r\n")
            time.sleep(0.2)
            start_s = time.monotonic()
            assert served.end()[0] == 0
    assert time.monotonic() - start_s < ENDS_WITHIN_S
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_world_left_is_no_hindrance(tmp_path: Path) -> None:
    with ServedWorld(tmp_path, *SMALL) as killed:
        killed.kill()
    assert (tmp_path / "control.sock").exists()
    with ServedWorld(tmp_path, *SMALL) as served:
        camera = served.camera()
        camera.open()
        camera.close()
        served("stop")
        assert served.process.wait(ENDS_WITHIN_S) == 0
    assert list(tmp_path.iterdir()) == []


def test_no_thread_or_descriptor_stays_of_clients_that_left(world: ServedWorld) -> None:
    def use() -> None:
        camera, projector, stage = world.camera(), world.projector(), world.stage("stage2")
        for device in (camera, projector, stage):
            device.open()
            world("state")
        for device in (camera, projector, stage):
            device.close()

    def count() -> tuple[int, int]:
        threads, descriptors = (
            len(list(Path(f"/proc/{world.process.pid}/{name}").iterdir())) for name in ("task", "fd")
        )
        return threads, descriptors

    use()
    time.sleep(0.3)
    before = count()
    use()
    use()
    deadline_s = time.monotonic() + 30
    while count() > before and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert count() <= before
