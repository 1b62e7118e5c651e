"""A rig with a simulated world: found or started, filled in, handled by an operator, ended."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from drivers.errors import ConfigurationError, DeviceLost, InstrumentError, LimitReached, NotConnected
from drivers.values import Led, StageCondition
from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.errors import SimulationError
from irpmd_rig.acquisition.rig import DeviceCondition, Rig
from irpmd_rig.acquisition.rig_file import RigFile, read_rig
from irpmd_rig.acquisition.simulated import attach, clear_stale_worlds, default_folder, running_world, serve_command
from irpmd_rig.recipes.plan import Scene
from irpmd_rig.shipped import CONFIGS, world_file

OPTIONS = {"size-px": 64, "time-scale": 20}


def small(**simulation) -> RigFile:
    return read_rig("sim").with_simulation(**simulation)


def serve(folder: Path, **options) -> subprocess.Popen:
    command = serve_command(world_file("misaligned"), folder, OPTIONS | options)
    process = subprocess.Popen(
        [*command, "--until-stdin-closes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout.readline().startswith(b"ready")
    return process


def end(process: subprocess.Popen) -> None:
    process.communicate(timeout=60)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a running world."""
    folder = tmp_path_factory.mktemp("world")
    process = serve(folder)
    yield folder
    end(process)


@pytest.fixture(scope="module")
def opened(folder):
    with Rig(small(folder=folder)) as rig:
        yield rig


@pytest.fixture
def rig(opened):
    """Return an open rig in good order."""
    if DeviceCondition.CLOSED in {state.state for state in opened.devices.values()}:
        opened.open()
    for name, state in opened.devices.items():
        if state.state is not DeviceCondition.READY:
            opened.reopen(name)
    opened.find_zeros()
    assert {state.state for state in opened.devices.values()} == {DeviceCondition.READY}
    return opened


def state(rig: Rig) -> dict:
    return rig.operator.control.call("state")


def alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def gone(pid: int, within_s: float) -> bool:
    end_s = time.monotonic() + within_s
    while alive(pid) and time.monotonic() < end_s:
        time.sleep(0.05)
    return not alive(pid)


# --- found, started, filled in


def test_what_the_world_knows_is_filled_in_and_what_the_file_says_goes_first(folder):
    rig_file = small(folder=folder)
    stage = rig_file.devices["stage1"]
    stage.settings["limits_mm"] = (-5.0, 5.0)
    filled, operator = attach(rig_file)
    settings = {name: device.settings for name, device in filled.devices.items()}
    assert settings["camera"]["producer"] == str(folder / "irpmd-sim.cti")
    assert settings["projector"]["backend_argument"].startswith(str(folder))
    assert settings["stage1"]["limits_mm"] == (-5.0, 5.0)
    assert settings["stage2"]["limits_mm"] == (0.0, 200.0)
    # The world's clock runs 20 times as fast.
    assert settings["stage1"]["settle_s"] == pytest.approx(0.2 / 20)
    assert filled.checkerboard.squares == (12, 14)
    assert filled.drawing.d_point_mm == (125.0, 0.0)
    operator.close()
    assert WorldControl(folder).hello()["ok"], "a world that was found is left running"


@pytest.fixture
def runtime_folder():
    """A folder whose path is as short as that of a session: sockets lie in it."""
    with tempfile.TemporaryDirectory(prefix="run-") as folder:
        yield folder


def test_a_rig_finds_the_world_where_the_command_puts_it_and_starts_another_if_it_does_not_fit(
    runtime_folder, monkeypatch
):
    monkeypatch.setenv("XDG_RUNTIME_DIR", runtime_folder)
    with pytest.raises(SimulationError, match="no simulated world is running"):
        running_world()
    process = serve(default_folder(world_file("misaligned")))
    try:
        assert running_world().hello()["pid"] == process.pid
        for changes, is_found in (({}, True), ({"size_px": 64}, True), ({"size_px": 80}, False)):
            operator = attach(small(**changes))[1]
            assert (operator.control.hello()["pid"] == process.pid) is is_found
            operator.close()
    finally:
        end(process)


def test_a_folder_that_is_named_must_hold_the_world_that_fits(folder, tmp_path):
    with pytest.raises(SimulationError, match=r"no world answers in .*irpmd-rig sim"):
        attach(small(folder=tmp_path))
    with pytest.raises(SimulationError, match="size_px is 64, not 100"):
        attach(small(folder=folder, size_px=100))
    with pytest.raises(SimulationError, match="stages is gsc, not gcd-0301m"):
        attach(small(folder=folder, stages="gcd-0301m"))


@pytest.mark.usefixtures("rig")
def test_a_private_world_is_replaced_and_ends_with_its_rig_and_leaves_nothing():
    def left() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    # The other rig has loaded what is then kept.
    before = left()
    private = Rig(small(private=True, size_px=64, time_scale=20))
    private.open()
    assert {s.state for s in private.devices.values()} == {DeviceCondition.READY}
    # A world that dies is said to be why, and is started again by the first instrument that is opened again.
    first = private.operator.control.hello()
    os.kill(first["pid"], signal.SIGKILL)
    while not private.operator.control.has_ended():
        time.sleep(0.01)
    assert {(s.state, s.detail) for s in private.refresh().values()} == {
        (DeviceCondition.MISSING, "the simulated world has ended")
    }
    assert all(stage.state().position is None for stage in private.stages.values())
    assert {private.reopen(name).state for name in private.devices} == {DeviceCondition.READY}
    hello = private.operator.control.hello()
    private.close()
    private.close()
    assert not Path(first["producer"]).parent.exists()
    assert not alive(hello["pid"])
    assert not Path(hello["producer"]).parent.exists()
    assert {s.state for s in private.devices.values()} == {DeviceCondition.CLOSED}
    assert left() == before


def test_a_private_world_ends_when_its_parent_is_killed():
    script = (
        "from irpmd_rig.acquisition.simulated import attach\n"
        "from irpmd_rig.acquisition.rig_file import read_rig\n"
        "import time\n"
        "operator = attach(read_rig('sim').with_simulation(private=True, size_px=64))[1]\n"
        "print(operator.control.hello()['pid'], flush=True)\n"
        "time.sleep(100)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as parent:
        pid = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    assert gone(pid, 30.0)


def test_what_killed_programs_left_is_cleared_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    old, starting, running, other = (
        tmp_path / name for name in ("irpmd-world-a", "irpmd-world-b", "irpmd-world-c", "d")
    )
    for folder in (old, starting, running, other):
        folder.mkdir()
    (old / "usb.sock").touch()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(running / "control.sock"))
        listener.listen()
        for folder in (old, running, other):
            os.utime(folder, (0.0, 0.0))
        clear_stale_worlds()
        assert sorted(tmp_path.iterdir()) == [other, starting, running]
    os.utime(running, (0.0, 0.0))
    clear_stale_worlds()
    assert sorted(tmp_path.iterdir()) == [other, starting]


def test_a_world_that_does_not_hold_is_told_in_its_own_words(tmp_path):
    text = (CONFIGS / "worlds" / "misaligned.yaml").read_text(encoding="utf-8").replace("psf_px", "psf_pxl")
    (tmp_path / "world.yaml").write_text(text, encoding="utf-8")
    written = (CONFIGS / "rigs" / "sim.yaml").read_text(encoding="utf-8").replace("../worlds/misaligned", "world")
    (tmp_path / "rig.yaml").write_text(written, encoding="utf-8")
    rig = Rig(read_rig(tmp_path / "rig.yaml"))
    with pytest.raises(SimulationError, match=r"world\.yaml:\d+.*did you mean 'psf_px'"):
        rig.open()
    rig.close()


@pytest.mark.parametrize("answer", [b"", b"nonsense\n", b"[]\n", b"{}\n", b'{"ok": false, "error": "tired"}\n'])
def test_what_the_control_line_answers_is_not_trusted(tmp_path, answer):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "control.sock"))
        server.listen()

        def serve_one() -> None:
            connection = server.accept()[0]
            with connection:
                connection.recv(4096)
                connection.sendall(answer)

        thread = threading.Thread(target=serve_one)
        thread.start()
        with pytest.raises(SimulationError):
            WorldControl(tmp_path, timeout_s=20).call("state")
        thread.join()


# --- instruments


def test_it_opens_with_everything_ready_and_its_axes_at_zero(rig):
    assert {name: s.kind for name, s in rig.devices.items()} == {
        "camera": "camera", "projector": "projector", "stage1": "stage", "stage2": "stage",
    }  # fmt: skip
    for stage in rig.stages.values():
        assert stage.state().condition is StageCondition.READY
    assert rig.camera.capabilities().sensor_size_px == (64, 64)
    assert rig.simulated


def test_the_operator_arranges_scenes(rig):
    rig.operator.arrange(Scene("plate", 0, glass=False, lamp=True))
    assert (state(rig)["subject"], state(rig)["glass"], state(rig)["lamp"]) == ("plate", False, True)
    rig.operator.arrange(Scene("mirror", 0, glass=True, lamp=False))
    assert (state(rig)["subject"], state(rig)["glass"], state(rig)["lamp"]) == ("mirror", True, False)
    with pytest.raises(SimulationError, match="teapot"):
        rig.operator.arrange(Scene("teapot", 0, glass=True, lamp=False))


def test_the_operator_reads_scales(rig):
    rig.stages["stage1"].move_to(12.5)
    rig.stages["stage1"].wait()
    assert rig.operator.read_scale("stage1") == pytest.approx(12.5, abs=0.02)
    with pytest.raises(SimulationError, match="no stage7"):
        rig.operator.read_scale("stage7")


def test_make_safe_puts_the_light_out_and_stops_the_stages(rig):
    rig.projector.set_led(Led.INFRARED, 0.5)
    rig.stages["stage1"].move_to(200.0)
    assert state(rig)["led"] == "infrared"
    answers = rig.make_safe()
    assert {name: answer.stopped for name, answer in answers.items()} == dict.fromkeys(rig.devices, True)
    assert state(rig)["led"] is None
    assert not state(rig)["stages"]["stage1"]["moving"]
    with pytest.raises(InstrumentError):
        rig.stages["stage1"].wait()


@pytest.mark.parametrize("name", ["camera", "projector", "stage1"])
def test_an_instrument_that_is_unplugged_is_lost_and_after_replugging_ready(rig, name):
    kind = rig.devices[name].kind
    arguments = {"stage": name} if kind == "stage" else {}
    rig.operator.control.call("fault", name=f"{kind}_unplug", **arguments)
    lost = rig.refresh()
    try:
        assert lost[name].state in (DeviceCondition.LOST, DeviceCondition.MISSING)
        assert lost[name].remedy
        assert {s.state for other, s in lost.items() if other != name} == {DeviceCondition.READY}
        told = rig.make_safe()
        if kind == "projector":
            assert isinstance(told[name], InstrumentError)
    finally:
        rig.operator.control.call("fault", name=f"{kind}_replug", **arguments)
    end_s = time.monotonic() + 30
    while rig.refresh()[name].state is not DeviceCondition.READY and time.monotonic() < end_s:
        time.sleep(0.1)
    assert rig.devices[name].state is DeviceCondition.READY
    if kind == "stage":
        assert rig.stages[name].state().position is None
        assert list(rig.find_zeros()) == [name]
        assert rig.stages[name].state().condition is StageCondition.READY


def test_an_error_that_is_no_state_leaves_it_as_it_is(rig):
    rig.note(LimitReached("stage1", "too far", "nearer"))
    assert rig.devices["stage1"].state is DeviceCondition.READY
    rig.note(DeviceLost("stage9", "gone", "find it"))
    assert "stage9" not in rig.devices


def test_reopening_one_instrument_leaves_the_others(rig):
    camera = rig.camera
    assert rig.reopen("stage2").state is DeviceCondition.READY
    assert rig.camera is camera
    assert rig.stages["stage2"].state().condition is StageCondition.NO_ZERO
    with pytest.raises(NotConnected, match="no such instrument"):
        rig.reopen("stage7")


def test_what_is_not_there_or_not_open_is_a_typed_error(rig):
    with pytest.raises(NotConnected, match="it has camera, projector"):
        rig.instrument("stage7")
    with pytest.raises(NotConnected, match="no stage"):
        rig.stage("camera")
    with pytest.raises(NotConnected, match="not open"):
        Rig(read_rig("sim")).reopen("camera")
    with pytest.raises(NotConnected, match="not open"):
        _ = Rig(read_rig("sim")).camera


# --- rig files that are wrong


WRONG = """\
name: wrong
world: {world}
simulation: {{folder: {folder}}}
camera:
  driver: harvesters
  producer: nowhere.cti
projector:
  driver: video
  x_display: ":7654"
stage1:
  driver: serial
  dialect: gsc
  port: /dev/nowhere
  speed_mm_per_s: 20
stage2:
  driver: serial
  dialect: gsc
  speed_mm_per_s: 20
"""


def test_each_instrument_that_cannot_be_opened_is_told_with_place_and_remedy_and_the_others_open(
    folder, opened, tmp_path
):
    opened.close()
    text = WRONG.format(world=world_file("misaligned").resolve(), folder=folder)
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    with Rig(read_rig(tmp_path / "rig.yaml")) as rig:
        told = rig.devices
        assert told["camera"].state is DeviceCondition.MISCONFIGURED
        assert f"rig.yaml:6:13: the producer {tmp_path}/nowhere.cti does not exist" in told["camera"].detail
        assert told["projector"].state is DeviceCondition.MISSING
        assert "display" in told["projector"].detail
        assert told["stage1"].state is DeviceCondition.MISSING
        assert "/dev/nowhere" in told["stage1"].detail
        assert all(told[name].remedy for name in ("camera", "projector", "stage1"))
        assert told["stage2"].state is DeviceCondition.READY
        assert list(rig.stages) == ["stage2"]
        with pytest.raises(ConfigurationError, match=r"rig\.yaml:6:13"):
            _ = rig.camera
        assert list(rig.make_safe()) == ["stage2"]
