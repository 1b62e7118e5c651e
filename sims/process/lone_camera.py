"""A camera alone that sees random pictures: for measuring how fast frames get to a driver."""

import itertools
import os
import sys
from pathlib import Path

import numpy as np

from sims.camera import CameraServer, CameraSettings, CameraTwin
from sims.clock import Clock
from sims.errors import SimulationError

_PICTURES = 4
_KINDS = {8: np.uint8, 10: np.uint16}


def serve_camera(folder: Path, size_px: int, *, paced: bool) -> None:
    """Serve a camera in a folder until standard input closes; prints its producer's path once it answers.

    Parameters
    ----------
    folder : Path
        Made if need be.
    size_px : int
        Rows and columns.
    paced : bool
        Keep the sensor's times, or run as fast as frames are taken.

    Raises
    ------
    SimulationError
        The folder cannot be used, or the producer cannot be built.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SimulationError(f"the folder {folder} cannot be used: {error}") from None
    chance = np.random.default_rng(1)
    pictures = {
        bits: itertools.cycle([chance.integers(0, 1 << bits, (size_px, size_px), dtype=kind) for _ in range(_PICTURES)])
        for bits, kind in _KINDS.items()
    }
    settings = CameraSettings(size_px=(size_px, size_px), paced=paced)
    clock = Clock()
    camera = CameraTwin(lambda _start_s, _exposure_us, bits: next(pictures[bits]), clock, settings)
    with CameraServer(camera, folder) as server:
        sys.stdout.write(f"{server.cti}\n")
        sys.stdout.flush()
        while os.read(sys.stdin.fileno(), 4096):
            pass
    server.cti.unlink(missing_ok=True)
