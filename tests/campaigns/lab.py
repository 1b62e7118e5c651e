"""A simulated rig with its daemon, each a process of its own, as they stand in a lab; and eyes on both."""

import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.simulated import serve_command
from irpmd_rig.client import Client
from irpmd_rig.service.models import Run
from irpmd_rig.shipped import world_file

SIZE_PX = 320
TIME_SCALE = 20.0
OWNER = "Ada"
FINAL = ("succeeded", "failed", "aborted", "interrupted")
SHIPPED = Path(__file__).parents[2] / "configs" / "rigs" / "sim.yaml"
# The daemon ends with whoever started it, however that ended.
COMMAND = """
import os, signal, sys, threading
def follow():
    os.read(0, 1)
    os.kill(os.getpid(), signal.SIGTERM)
threading.Thread(target=follow, daemon=True).start()
from irpmd_rig.cli import main
main()
"""


class TooLate(AssertionError):
    """Something did not happen within its bound."""


def until(what: Callable[[], Any], limit_s: float, name: str = "it") -> Any:
    """Wait for something that has to become true, and return it."""
    end_s = time.monotonic() + limit_s
    while not (found := what()):
        if time.monotonic() > end_s:
            raise TooLate(f"{name} did not happen within {limit_s:g} s")
        time.sleep(0.02)
    return found


def free_port() -> int:
    """Not one that the kernel hands out by itself: nobody takes it while no daemon listens there."""
    while True:
        port = random.SystemRandom().randrange(10_000, 32_000)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def alive(process: psutil.Process) -> bool:
    with suppress(psutil.NoSuchProcess):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


class Daemon:
    """A daemon's process, and a client of it."""

    def __init__(self, process: subprocess.Popen[str], url: str, token: Path) -> None:
        self.process = process
        self.pid = process.pid
        self.client = Client(url, token)
        self._helpers: set[psutil.Process] = set()

    def helpers(self) -> dict[str, psutil.Process]:
        """The processes that it started: by the last part of the module that they run."""
        found = {}
        for child in psutil.Process(self.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                words = child.cmdline()
                self._helpers.add(child)
                # A process that was forked a moment ago has its parent's command line still.
                for name in ("camera", "processing"):
                    if any(f".{name}." in word for word in words):
                        found[name] = child
        return found

    def kill(self) -> None:
        """End it as a power cut of the process would, and see that all its helpers end by themselves."""
        self.helpers()
        self.process.kill()
        self.process.wait(60)
        self.client.close()
        until(lambda: not any(map(alive, self._helpers)), 60.0, "the end of the daemon's helpers")

    def terminate(self, number: int = signal.SIGTERM) -> int:
        """Ask it to end; returns its exit status."""
        self.helpers()
        self.process.send_signal(number)
        status = self.process.wait(60)
        self.client.close()
        until(lambda: not any(map(alive, self._helpers)), 60.0, "the end of the daemon's helpers")
        return status

    def memory_bytes(self) -> int:
        """Proportional memory of the daemon and its helpers."""
        whole = 0
        for process in (psutil.Process(self.pid), *self.helpers().values()):
            with suppress(psutil.NoSuchProcess):
                whole += process.memory_full_info().pss
        return whole

    def descriptors(self) -> dict[str, int]:
        """Open files of the daemon and its helpers."""
        processes = {"daemon": psutil.Process(self.pid), **self.helpers()}
        return {name: process.num_fds() for name, process in processes.items()}

    # --- what a person does

    @contextmanager
    def lease(self) -> Iterator[None]:
        with self.client.lease(OWNER, 60.0, override=True):
            yield

    def submit(self, recipe: str, key: str | None = None) -> str:
        """Let a run wait: after a success the queue goes on by itself, and it would begin at once."""
        self.client.hold_queue()
        run: Run = self.client.submit(recipe, idempotency_key=key)
        return run.id

    def ready(self, limit_s: float = 90.0) -> None:
        """Wait until only a person's leave is missing for a run to begin."""

        def only_held() -> bool:
            reasons = self.client.rig().reasons
            return all(reason.startswith("the queue is held") for reason in reasons)

        try:
            until(only_held, limit_s, "a rig that is ready")
        except TooLate as error:
            raise TooLate(f"{error}: {self.client.rig().reasons}") from None

    def begin(self, recipe: str, frames: int = 1, limit_s: float = 60.0) -> str:
        """Begin a run; returns its id once so many frames of it are on disk."""
        run_id = self.submit(recipe)
        self.resume()
        until(lambda: self.has_frames(run_id, frames), limit_s, f"frame {frames} of run {run_id}")
        return run_id

    def has_frames(self, run_id: str, frames: int) -> bool:
        run = self.client.run(run_id)
        assert run.state not in ("failed", "aborted", "interrupted"), (run.reason, run.detail)
        return (run.frames or 0) >= frames or run.state in FINAL

    def resume(self) -> None:
        self.ready()
        self.client.resume_queue()

    def ended(self, run_id: str, limit_s: float = 60.0) -> Run:
        """Wait for the end of a run."""
        until(lambda: self.client.run(run_id).state in FINAL, limit_s, f"the end of run {run_id}")
        run: Run = self.client.run(run_id)
        return run

    def carry_out(self, recipe: str, limit_s: float = 90.0) -> Run:
        """Run a recipe to its end."""
        run_id = self.submit(recipe)
        self.resume()
        return self.ended(run_id, limit_s)

    def retry(self, run_id: str, limit_s: float = 90.0) -> Run:
        """Run it again to its end."""
        with self.lease():
            self.client.act(run_id, "retry")
        self.resume()
        return self.ended(run_id, limit_s)


class Lab:
    """A world's process, a rig file on it, and a folder for runs."""

    def __init__(self, folder: Path, world: WorldControl, world_pid: int) -> None:
        self.world = world
        self.world_pid = world_pid
        self.folder = folder
        self.root = folder / "data"
        self.rig = folder / "rig.yaml"
        self.log = folder / "daemon.log"
        self.port = free_port()
        self.write_rig()

    def write_rig(self, more: str = "", reserve_gb: float = 0.0) -> Path:
        """Write the shipped rig, on this world; settings of whole instruments may replace its own."""
        text = SHIPPED.read_text().replace("../worlds/misaligned.yaml", str(world_file("misaligned")))
        self.rig.write_text(
            f"{text}\nsimulation: {{folder: {self.world.folder}}}\n"
            f"storage: {{root: {self.root}, reserve_gb: {reserve_gb}}}\n"
            f"service: {{port: {self.port}}}\n{more}"
        )
        return self.rig

    @contextmanager
    def serving(
        self,
        *,
        prefix: tuple[str, ...] = (),
        environment: dict[str, str] | None = None,
        limit_s: float = 60.0,
        says: str = "ready",
    ) -> Iterator[tuple[subprocess.Popen[str], str]]:
        """A process of `irpmd-rig serve` and its address; whatever is left of it at the end is ended."""
        command = [*prefix, sys.executable, "-c", COMMAND, "serve", str(self.rig)]
        with self.log.open("a") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
                env=os.environ | (environment or {}),
            )
        assert process.stdout is not None
        assert process.stdin is not None
        try:
            line = process.stdout.readline().split()
            assert line[:1] == [says], f"no daemon: {self.log.read_text()[-2000:]}"
            yield process, line[1]
        finally:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(limit_s)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
                    raise TooLate(f"the daemon did not end within {limit_s:g} s") from None
                finally:
                    process.stdout.close()
                    process.stdin.close()
            process.stdout.close()
            process.stdin.close()

    @contextmanager
    def daemon(self, **settings: Any) -> Iterator[Daemon]:
        """A daemon, as `serving`."""
        with self.serving(**settings) as (process, url):
            daemon = Daemon(process, url, self.seen_by(process.pid) / "token")
            with daemon.client:
                yield daemon

    def seen_by(self, pid: int) -> Path:
        """The folder of the runs as a process sees it, which may have mounted something there."""
        return Path(f"/proc/{pid}/root{self.root.resolve()}")

    def command(self, *words: str, limit_s: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run `irpmd-rig` to its end."""
        command = [sys.executable, "-c", "from irpmd_rig.cli import main; main()", *words]
        return subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=False)

    def fault(self, name: str, **arguments: Any) -> None:
        self.world.call("fault", name=name, **arguments)

    def state(self) -> dict[str, Any]:
        return self.world.call("state")

    def unrest(self) -> list[str]:
        """What of the hardware is not at rest: LED, stages, camera."""
        state = self.state()
        found = []
        if state["led"] and state["intensity"]:
            found.append(f"the {state['led']} LED is on at {state['intensity']:g}")
        found += [f"{name} moves" for name, stage in state["stages"].items() if stage["moving"]]
        if state["camera"]["armed"] and state["camera"]["plugged"]:
            found.append("the camera is armed")
        return found

    def at_rest(self, limit_s: float = 0.0) -> None:
        """What the hardware has to be whenever a run has ended: dark, and nothing moves."""
        end_s = time.monotonic() + limit_s
        while found := self.unrest():
            assert time.monotonic() < end_s, found
            time.sleep(0.02)

    def mend(self) -> None:
        """Let every fault be over."""
        for name, arguments in MENDS:
            self.fault(name, **arguments)


MENDS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("camera_replug", {}),
    ("camera_recover", {}),
    ("camera_cool", {}),
    ("camera_slow", {"seconds": 0.0}),
    ("projector_replug", {}),
    ("projector_mend", {}),
    *(
        (name, {"stage": stage, **more})
        for stage in ("stage1", "stage2")
        for name, more in (
            ("stage_replug", {}),
            ("stage_slow", {"seconds": 0.0}),
            ("stage_mute", {"on": False}),
            ("stage_endless", {"on": False}),
        )
    ),
)


@contextmanager
def lab(folder: Path | None = None, **options: Any) -> Iterator[Lab]:
    """A world that ends with whoever started it; `options` by their names on its command line."""
    with ExitStack() as stack:
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="irpmd-lab-")))
        chosen = {"size-px": SIZE_PX, "time-scale": TIME_SCALE} | options
        command = [*serve_command(world_file("misaligned"), folder / "world", chosen), "--until-stdin-closes"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        assert process.stdout is not None
        try:
            assert process.stdout.readline().startswith(b"ready")
            yield Lab(folder, WorldControl(folder / "world"), process.pid)
        finally:
            process.communicate(timeout=60)
