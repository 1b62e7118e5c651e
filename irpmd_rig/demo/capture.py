"""Taking pictures with the simulated rig: exposure, masks and fringe sets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from irpmd_rig.core import AbsolutePhase, check_frames, decode, fringe_images
from irpmd_rig.core.errors import FramesError
from sims.rig import SimulatedRig

Frame = NDArray[np.uint8] | NDArray[np.uint16]
_BRIGHT_FRACTION = 0.85  # of full scale, for the brightest parts of a white frame
_LIT_FRACTION = 0.2  # of the brightest parts: what counts as lit
_EDGE_PX = 6
_EXPOSURE_TRIES = 8


@dataclass(slots=True)
class Photographer:
    """Shows patterns and takes frames.

    Attributes
    ----------
    rig : SimulatedRig
        The rig that shows and captures.
    counts, steps
        Fringe sets.
    threads : int
        For decoding.
    tick : callable
        Called with the number of frames that were taken.
    """

    rig: SimulatedRig
    counts: tuple[float, ...]
    steps: int
    threads: int
    tick: Callable[[int], None]

    def frame(self, image: NDArray[np.uint8] | None) -> Frame:
        """One frame of the picture shown."""
        self.rig.show(image)
        captured: Frame = self.rig.capture()
        return captured

    def white(self) -> NDArray[np.uint8]:
        """The brightest picture of the projector."""
        width, height = self.rig.world.projector.size_px
        return np.full((height, width), 255, dtype=np.uint8)

    def expose(self, image: NDArray[np.uint8] | None) -> None:
        """Set the exposure so that the brightest parts reach 85 % of full scale.

        Raises
        ------
        FramesError
            If nothing in the picture is lit.
        """
        camera = self.rig.world.camera
        full = 2**camera.bits - 1
        exposure_us = camera.exposure_us
        for _ in range(_EXPOSURE_TRIES):
            self.rig.set_exposure(exposure_us)
            bright = float(np.percentile(self.frame(image), 99.5))
            if bright < full:
                break
            exposure_us /= 4
        if bright < 0.02 * full:
            raise FramesError("nothing in the camera's view is lit: check projector, glass and placement")
        self.rig.set_exposure(exposure_us * _BRIGHT_FRACTION * full / bright)

    def lit(self) -> NDArray[np.bool_]:
        """Pixels that the projector lights."""
        difference = self.frame(self.white()).astype(np.float32) - self.frame(None).astype(np.float32)
        threshold = _LIT_FRACTION * float(np.percentile(difference, 99))
        return np.asarray(ndimage.binary_opening(difference > threshold, iterations=2))

    def fringes(self) -> Frame:
        """All sets and steps, (sets, steps, H, W).

        Raises
        ------
        FramesError
            If a frame is stale, blended, dropped, swapped or saturated.
        """
        patterns = fringe_images(self.counts, self.steps, self.rig.world.projector.size_px)
        sets = [np.stack([self.frame(pattern) for pattern in fringe_set]) for fringe_set in patterns]
        frames: Frame = np.stack(sets)
        report = check_frames(frames, self.counts)
        if not report.ok:
            raise FramesError("; ".join(finding.message for finding in report.findings))
        self.tick(patterns.shape[0] * patterns.shape[1])
        return frames

    def decode(self, frames: Frame) -> AbsolutePhase:
        """Absolute phase of a full set of frames."""
        return decode(frames, self.counts, threads=self.threads)


def grow(region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A region with a rim added."""
    return np.asarray(ndimage.binary_dilation(region, iterations=_EDGE_PX))


def shrink(region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A region without its rim, where two surfaces share a pixel."""
    return np.asarray(ndimage.binary_erosion(region, iterations=_EDGE_PX))
