"""Serves one world in one folder until it is told to end, or whoever started it is gone."""

import fcntl
import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from sims.errors import SimulationError
from sims.process.control import SOCKET, Control, ControlServer
from sims.process.faults import Faults
from sims.process.instruments import Conditions, Instruments
from sims.process.script import Script, read_script
from sims.rig import SimulatedRig
from sims.world import World, load_world

END_LIMIT_S = 4.0
# Of a Unix socket on Linux; control.sock has the longest name of those that are bound by their full path.
LONGEST_ADDRESS_BYTES = 107
_SMALLEST_PX = 64


@dataclass(frozen=True, slots=True)
class Options:
    """What a world is served as.

    `seed` and `size_px` replace the world file's seed and number of columns of the camera; `faults` names a script
    of faults (`sims.process.script.read_script`).
    """

    world_file: Path
    folder: Path
    seed: int | None = None
    size_px: int | None = None
    conditions: Conditions = field(default_factory=Conditions)
    faults: Path | None = None
    until_stdin_closes: bool = False


def serve(options: Options) -> None:
    """Serve until SIGTERM, SIGINT, a `stop` on the control line, or (as asked for) the end of standard input.

    Prints ``ready FOLDER`` once everything answers. Ends the process where its threads do not end in time.

    Raises
    ------
    WorldError
        The world file does not hold.
    SimulationError
        The folder cannot be used, or the instruments cannot be served.
    """
    world = chosen_world(options.world_file, options.seed, options.size_px)
    with _own(options.folder) as folder:
        ending = _Ending(folder)
        if options.until_stdin_closes:
            threading.Thread(target=ending.watch_stdin, name="stdin", daemon=True).start()
        _warm_up(world)
        try:
            with _signals_ask(ending), Instruments(world, folder, options.conditions) as instruments:
                _answer_until_asked(instruments, options, ending)
        except OSError as error:
            raise SimulationError(f"the world cannot be served in {folder}: {error}") from None


def _answer_until_asked(instruments: Instruments, options: Options, ending: "_Ending") -> None:
    faults = Faults(instruments)
    events = iter(()) if options.faults is None else read_script(options.faults, faults)
    script = Script(faults, instruments.clock)
    server = ControlServer(Control(instruments, options.world_file, faults, script, ending.ask), instruments.folder)
    server.start()
    try:
        script.start(events)
        sys.stdout.write(f"ready {instruments.folder}\n")
        sys.stdout.flush()
        ending.wait()
    finally:
        server.close()
        script.stop()


@contextmanager
def _signals_ask(ending: "_Ending") -> Iterator[None]:
    """Let SIGTERM and SIGINT ask for the end."""
    former = {number: signal.signal(number, lambda *_: ending.ask()) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


class _Ending:
    """The wish that the world ends, and the bound within which it does.

    A pipe, not an event: a signal's handler may write to it whatever the main thread is doing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        # Never closed: a thread that still wishes for the end must not write into another file.
        self._read, self._write = os.pipe()

    def ask(self) -> None:
        """Wish for the end, from any thread or signal handler."""
        os.write(self._write, b"x")

    def wait(self) -> None:
        """Wait until someone wishes for the end."""
        os.read(self._read, 1)
        self._enforce()

    def watch_stdin(self) -> None:
        """Wish for the end once standard input ends; the world may be starting still."""
        while os.read(sys.stdin.fileno(), 4096):
            pass
        self.ask()
        self._enforce()

    def _enforce(self) -> None:
        enforcer = threading.Timer(END_LIMIT_S, self._leave)
        enforcer.daemon = True
        enforcer.start()

    def _leave(self) -> None:
        """End at once: a frame that is being traced, say, is not waited for."""
        for path in self._folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        os._exit(0)


def chosen_world(path: Path, seed: int | None, size_px: int | None) -> World:
    """Load a world with another seed or camera size.

    Raises
    ------
    WorldError
        The world file does not hold, or not with such a camera.
    SimulationError
        The seed is not a whole number from 0 to 2^63 - 1.
    """
    world = load_world(path)
    if size_px is not None:
        world = world.with_camera_size(size_px)
    return SimulatedRig(world, seed=seed).world


def _warm_up(world: World) -> None:
    """Load or compile the kernels now: the first frame must not be the one that waits for them."""
    SimulatedRig(world.with_camera_size(_SMALLEST_PX)).capture()


@contextmanager
def _own(folder: Path) -> Iterator[Path]:
    """Make the folder and keep others from serving in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder = folder.resolve()
        if len(os.fsencode(folder / SOCKET)) > LONGEST_ADDRESS_BYTES:
            raise SimulationError(
                f"--folder {folder} is too long a path for sockets in it: {LONGEST_ADDRESS_BYTES - len(SOCKET) - 1}"
                " bytes at most"
            )
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise SimulationError(f"--folder {folder} cannot be used: {error}") from None
    try:
        try:
            # The lock is the folder's own and ends with this process: nothing is left to be cleaned up.
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise SimulationError(f"another world is served in {folder}: end it, or name another --folder") from None
        yield folder
    finally:
        os.close(descriptor)
