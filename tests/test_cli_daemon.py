"""The commands that work with a daemon, typed as a user types them: serve, run, runs, stop, safe."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.client import Client

COMMAND = [sys.executable, "-m", "irpmd_rig"]
WORLD = Path(__file__).parents[1] / "configs" / "worlds" / "misaligned.yaml"

RIG = """name: test rig
world: {world}
simulation: {{folder: {folder}}}
camera: {{driver: harvesters}}
projector: {{driver: lightcommander, transport: usb, profile: lightcommander-sim}}
stage1: {{driver: serial, dialect: gsc, speed_mm_per_s: 20.0}}
stage2: {{driver: serial, dialect: gsc, speed_mm_per_s: 20.0}}
storage: {{root: {root}, reserve_gb: 0.1}}
service: {{port: {port}}}
"""
SHORT = """kind: sequence
name: short
exposure_us: 2000.0
steps:
  - {do: prompt, text: Place the mirror., subject: mirror}
  - {do: show, pattern: white}
  - {do: move, stage: stage1, position_mm: 0}
  - {do: capture, label: near}
"""
ASKS = SHORT + "  - {do: prompt, text: Turn the sample round.}\n  - {do: capture, label: turned}\n"
LONG = SHORT + "  - {do: wait, time_s: 60}\n  - {do: capture, label: late}\n"


def until(what: Callable[[], bool], limit_s: float = 80.0) -> None:
    end_s = time.monotonic() + limit_s
    while not what():
        assert time.monotonic() < end_s, "it did not happen in time"
        time.sleep(0.05)


class Lab:
    """A folder with a rig file and recipes, a world that goes on whatever happens to daemons, and a daemon."""

    def __init__(self, folder: Path, world: WorldControl) -> None:
        self.folder = folder
        self.world = world
        self.daemon: subprocess.Popen[str] | None = None
        self.url = ""
        for name, text in (("short", SHORT), ("asks", ASKS), ("long", LONG)):
            (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
        self.write_rig(port=0)

    def write_rig(self, port: int) -> None:
        text = RIG.format(world=WORLD, folder=self.world.folder, root=self.folder / "data", port=port)
        (self.folder / "rig.yaml").write_text(text, encoding="utf-8")

    def start(self) -> None:
        with (self.folder / "daemon.log").open("w") as log:
            self.daemon = subprocess.Popen(
                [*COMMAND, "serve", "rig.yaml"], cwd=self.folder, stdout=subprocess.PIPE, stderr=log, text=True
            )
        assert self.daemon.stdout is not None
        ready = self.daemon.stdout.readline()
        assert ready.startswith("ready http://127.0.0.1:"), (self.folder / "daemon.log").read_text()
        self.url = ready.split()[1]
        # As in a lab, where the port is fixed: the rig file tells where the daemon is.
        self.write_rig(port=int(self.url.rpartition(":")[2]))

    def end(self, number: int = signal.SIGTERM) -> int:
        assert self.daemon is not None
        assert self.daemon.stdout is not None
        self.daemon.send_signal(number)
        status = self.daemon.wait(80)
        self.daemon.stdout.close()
        return status

    def begin(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*COMMAND, *arguments], cwd=self.folder, env={**os.environ, "IRPMD_RIG_URL": self.url},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip

    def typed(self, *arguments: str, stdin: str = "") -> tuple[int, str, str]:
        with self.begin(*arguments) as process:
            try:
                said, noted = process.communicate(stdin, timeout=60)
            finally:
                process.kill()
        assert "Traceback" not in noted
        return process.returncode, said, noted

    def client(self) -> Client:
        return Client(self.url, self.folder / "data" / "token")

    def newest(self) -> tuple[str, str | None]:
        with self.client() as client:
            for run in client.runs(1):
                return str(run.state), run.reason
        return "none", None

    def at_rest(self) -> bool:
        state = self.world.call("state")
        moving = any(stage["moving"] for stage in state["stages"].values())
        return not moving and not (state["led"] and state["intensity"])


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    folder = tmp_path_factory.mktemp("world")
    command = [*COMMAND, "sim", str(WORLD), "--folder", str(folder), "--size-px", "64"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield WorldControl(folder)
        process.send_signal(signal.SIGTERM)
        process.wait(60)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, world: WorldControl) -> Iterator[Lab]:
    lab = Lab(tmp_path_factory.mktemp("lab"), world)
    lab.start()
    yield lab
    assert lab.end() == 0
    assert lab.at_rest()


def test_a_recipe_is_run_and_its_run_is_shown(lab: Lab) -> None:
    status, said, noted = lab.typed("run", "short.yaml", "--json")
    assert status == 0, noted
    run = json.loads(said)
    assert (run["state"], run["frames"]) == ("succeeded", 1)
    status, said, _ = lab.typed("runs")
    assert status == 0
    assert run["id"] in said
    status, said, _ = lab.typed("runs", run["id"])
    assert status == 0
    assert "sequence, short" in said
    assert lab.typed("runs", run["id"], "delete")[0] == 0
    status, _, noted = lab.typed("runs", run["id"])
    assert status == 2
    assert run["id"] in noted


def test_what_is_wrong_with_a_recipe_is_told_with_file_and_line(lab: Lab) -> None:
    (lab.folder / "wrong.yaml").write_text(SHORT.replace("position_mm: 0", "position_mm: 5000"), encoding="utf-8")
    status, said, noted = lab.typed("run", "wrong.yaml")
    assert (status, said) == (2, "")
    assert "wrong.yaml:7:" in noted
    status, _, noted = lab.typed("run", "nowhere.yaml")
    assert status == 2
    assert "paper-measure" in noted


def test_ctrl_c_asks_before_it_aborts(lab: Lab) -> None:
    with lab.begin("run", "long.yaml") as process:
        until(lambda: lab.newest()[0] == "running")
        assert process.stdin is not None
        process.send_signal(signal.SIGINT)
        time.sleep(1.5)
        assert lab.newest()[0] == "running"
        process.stdin.write("\n")
        process.stdin.flush()
        time.sleep(1.5)
        assert process.poll() is None
        assert lab.newest()[0] == "running"
        process.send_signal(signal.SIGINT)
        time.sleep(1.5)
        _, noted = process.communicate("a\n", timeout=60)
        assert process.returncode == 1
        assert "Abort the run?" in noted
    assert lab.newest() == ("aborted", "aborted_by_user")
    assert lab.at_rest()


def test_the_operator_is_asked_in_the_terminal(lab: Lab) -> None:
    with lab.begin("run", "asks.yaml") as process:
        until(lambda: lab.newest()[0] == "waiting_for_operator")
        assert process.stdin is not None
        time.sleep(1.0)
        process.stdin.write("what?\n")
        process.stdin.flush()
        time.sleep(1.5)
        assert lab.newest()[0] == "waiting_for_operator"
        said, noted = process.communicate("\n", timeout=60)
        assert process.returncode == 0, noted
    assert "Turn the sample round." in noted
    assert "'what?' is no answer" in noted
    assert "succeeded: 2 frames" in said


def test_a_run_can_be_left_to_the_daemon(lab: Lab) -> None:
    with lab.begin("run", "long.yaml") as process:
        until(lambda: lab.newest()[0] == "running")
        process.send_signal(signal.SIGINT)
        _, noted = process.communicate("l\n", timeout=60)
        assert process.returncode == 1
    assert "left to the daemon" in noted
    assert lab.newest()[0] == "running"
    status, said, _ = lab.typed("stop")
    assert status == 0
    assert {line.split(":")[0] for line in said.splitlines()} == {"camera", "projector", "stage1", "stage2"}
    assert lab.newest() == ("failed", "stopped")
    assert lab.at_rest()
    # Nothing can start, and nobody is there who could do anything about it.
    status, _, noted = lab.typed("run", "short.yaml")
    assert status == 1
    assert "clear the stop" in noted
    assert lab.newest() == ("queued", None)
    assert lab.typed("stop", "--clear")[0] == 0
    with lab.client() as client:
        assert lab.typed("runs", client.runs(1)[0].id, "abort")[0] == 0


def test_without_a_daemon_or_its_token_it_is_said_how_to_get_one(lab: Lab, tmp_path: Path) -> None:
    for arguments, says in ((["--token", str(tmp_path / "none")], "token"), (["--url", "http://127.0.0.1:1"], "serve")):
        status, said, noted = lab.typed("runs", *arguments)
        assert (status, said) == (2, "")
        assert says in noted


def test_safe_works_through_the_daemon_and_after_it_was_killed(lab: Lab) -> None:
    status, said, noted = lab.typed("safe", "rig.yaml")
    assert status == 0, noted
    assert "the daemon stopped everything" in noted
    assert "stage1: stopped" in said
    lab.typed("stop", "--clear", "--rig", "rig.yaml")
    with lab.client() as client:
        client.take_lease("Ada")
        client.projector_led("infrared", 0.4)
        client.projector_show("white")
        assert not lab.at_rest()
        lab.end(signal.SIGKILL)
    assert not lab.at_rest()
    status, said, noted = lab.typed("safe", "rig.yaml")
    assert status == 0, (said, noted)
    assert "the daemon" not in noted
    assert lab.at_rest()
    lab.write_rig(port=0)
    lab.start()
