"""Taking pictures for the demonstration: scenes, masks and fringe sets, decoded while the next ones are taken."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from irpmd_rig.acquisition.capture import FringeFrames, Photographer
from irpmd_rig.acquisition.rig import Operator
from irpmd_rig.core import AbsolutePhase, decode
from irpmd_rig.recipes.plan import Scene

Frame = NDArray[np.uint8] | NDArray[np.uint16]
_LIT_FRACTION = 0.2  # of the brightest parts: what counts as lit
_EDGE_PX = 6


class Decoded(NamedTuple):
    """Frames, (sets, steps, H, W), and what they say."""

    images: Frame
    phase: AbsolutePhase


@dataclass(slots=True)
class Lab:
    """A rig, who takes its pictures, and who puts things in place.

    Attributes
    ----------
    photographer : Photographer
        Takes frames.
    operator : Operator
        Places things.
    counts, steps
        Fringe sets.
    threads : int
        For decoding.
    tick : callable
        Called with the number of frames that were taken.
    pool : ThreadPoolExecutor
        Checks and decodes.
    """

    photographer: Photographer
    operator: Operator
    counts: tuple[float, ...]
    steps: int
    threads: int
    tick: Callable[[int], None]
    pool: ThreadPoolExecutor

    def place(self, subject: str, *, pose: int = 0, glass: bool = True, lamp: bool = False) -> None:
        """Have a scene arranged."""
        self.operator.arrange(Scene(subject, pose, glass, lamp))

    def board(self) -> Frame:
        """One well exposed frame without the projector."""
        self.photographer.expose("plain")
        image = self.photographer.plain().frame.image
        self.tick(1)
        return image

    def lit(self) -> NDArray[np.bool_]:
        """Pixels that the projector lights, well exposed."""
        self.photographer.expose("white")
        white, black = self.photographer.white(), self.photographer.black()
        difference = white.frame.image.astype(np.float32) - black.frame.image.astype(np.float32)
        threshold = _LIT_FRACTION * float(np.percentile(difference, 99))
        return np.asarray(ndimage.binary_opening(difference > threshold, iterations=2))

    def fringes(self) -> Future[Decoded]:
        """Well exposed fringe sets; checked and decoded while the caller goes on.

        The result raises FrameQuality if a frame is stale, blended, dropped, swapped or saturated.
        """
        self.photographer.expose("white")
        taken = self.photographer.take_fringes(self.counts, self.steps)
        self.tick(len(taken))
        return self.pool.submit(self._decoded, taken)

    def _decoded(self, taken: FringeFrames) -> Decoded:
        self.photographer.check(taken)
        return Decoded(taken.images, decode(taken.images, self.counts, threads=self.threads))


def grow(region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A region with a rim added."""
    return np.asarray(ndimage.binary_dilation(region, iterations=_EDGE_PX))


def shrink(region: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A region without its rim, where two surfaces share a pixel."""
    return np.asarray(ndimage.binary_erosion(region, iterations=_EDGE_PX))
