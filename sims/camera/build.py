"""Builds the GenTL producer on first use and keeps it."""

import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

from sims.errors import SimulationError

SOURCES = Path(__file__).parent / "producer"
FLAGS = ("-std=c11", "-shared", "-fPIC", "-O2", "-fvisibility=hidden", "-Wall", "-Wextra", "-pthread")
COMPILERS = ("cc", "gcc", "clang")
VARIABLE = "IRPMD_SIM_PRODUCER"


class ProducerError(SimulationError):
    """The producer cannot be had: no compiler, no place to keep it, or a wrong prebuilt file."""


def producer() -> Path:
    """Path of the producer, built if need be.

    The environment variable IRPMD_SIM_PRODUCER names a prebuilt file. Otherwise the sources are compiled into
    the user's cache (XDG_CACHE_HOME, else ~/.cache), named by a hash of them and the architecture.

    Raises
    ------
    ProducerError
        If there is no compiler, it fails, the cache cannot be written, or the prebuilt file is missing.
    """
    prebuilt = os.environ.get(VARIABLE)
    if prebuilt is not None:
        path = Path(prebuilt)
        if not path.is_file():
            raise ProducerError(f"{VARIABLE} names {prebuilt!r}, which is no file")
        return path
    sources = sorted(SOURCES.glob("*.[ch]"))
    folder = _cache()
    built = folder / f"producer-{_key(sources)}.cti"
    if built.exists():
        return built
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "producer.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not built.exists():
                _build([source for source in sources if source.suffix == ".c"], built)
    except OSError as error:
        raise ProducerError(
            f"the simulated camera's producer cannot be kept in {folder} ({error}): set"
            f" XDG_CACHE_HOME to a folder that can be written, or {VARIABLE} to a prebuilt file"
        ) from error
    return built


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "irpmd-rig"


def _key(sources: list[Path]) -> str:
    digest = hashlib.sha256(" ".join((platform.machine(), *FLAGS)).encode())
    for source in sources:
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return f"{digest.hexdigest()[:16]}-{platform.machine()}"


def _build(sources: list[Path], built: Path) -> None:
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise ProducerError(
            f"the simulated camera needs a C compiler ({', '.join(COMPILERS)}), and none is on the PATH:"
            " install the package gcc (Debian: apt-get install build-essential), or set"
            f" {VARIABLE} to a prebuilt file"
        )
    with tempfile.TemporaryDirectory(dir=built.parent) as folder:
        fresh = Path(folder) / built.name
        command = [compiler, *FLAGS, "-o", str(fresh), *map(str, sources)]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise ProducerError(f"{compiler} does not compile the simulated camera's producer:\n{result.stderr}")
        fresh.replace(built)
