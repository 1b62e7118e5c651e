"""Whether what the camera sees still moves: two frames that differ by nothing but noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import Frame
from irpmd_rig.acquisition.errors import AcquisitionError

TRIES = 30
# Noise has no neighbours: averaged over blocks it falls by the block's side, a moved picture does not.
_BLOCK_PX = 8
_EXCESS = 2.0
_DIGITISING_DN = 0.3  # of a difference of two frames whose noise is below one step


class NotSettled(AcquisitionError):
    """The picture did not come to rest."""


def differ(one: Frame, other: Frame) -> bool:
    """Whether two frames of one scene differ by more than noise and by more than one common brightness.

    Parameters
    ----------
    one, other
        Frames of the same size.
    """
    first, second = one.image.astype(np.float32), other.image.astype(np.float32)
    mean = float(second.mean())
    factor = float(first.mean()) / mean if mean > 0.0 else 1.0
    difference = first - factor * second
    noise = max(float(difference.std()), _DIGITISING_DN)
    return float(_blocks(difference).std()) > _EXCESS * noise / _BLOCK_PX


def wait_until_still(shoot: Callable[[], Frame], tries: int = TRIES) -> int:
    """Take frames until two that follow each other differ by no more than noise; returns how many were taken.

    Parameters
    ----------
    shoot
        Takes a frame of the scene.
    tries
        Highest number of frames.

    Raises
    ------
    NotSettled
        It still changes.
    """
    before = shoot()
    for taken in range(2, tries + 1):
        after = shoot()
        if not differ(before, after):
            return taken
        before = after
    raise NotSettled(
        f"the picture still changes after {tries} frames",
        "look for vibration, or for light that flickers; or give settle: time_s",
    )


def _blocks(image: NDArray[np.float32]) -> NDArray[np.float32]:
    height, width = (side // _BLOCK_PX * _BLOCK_PX for side in image.shape)
    blocks = image[:height, :width].reshape(height // _BLOCK_PX, _BLOCK_PX, width // _BLOCK_PX, _BLOCK_PX)
    means: NDArray[np.float32] = blocks.mean(axis=(1, 3))
    return means
