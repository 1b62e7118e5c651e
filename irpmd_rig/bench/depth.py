"""Speed from the frames of two positions to depth and uncertainty a pixel, beside the decoding of the same frames."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.bench.decode import COUNTS, STEPS
from irpmd_rig.bench.timing import Row, median_ms, slower
from irpmd_rig.core import Intrinsics, ReferenceFrame, decode
from irpmd_rig.core.reconstruction.triangulation import RigTables, rig_tables, triangulate
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.rig_model import Projector, RigModel

POSITIONS_MM = (0.0, 40.0)
DECODE = "decode of the same frames"
_CAMERA_RAD = np.deg2rad(37.0)
_NOISE_DN = 1.5

Frames = NDArray[np.uint8]
Window = tuple[slice, slice]


def run(size_px: int = 2048, repeats: int = 9) -> list[Row]:
    """Time decoding and triangulation on one thread: 2 positions, 3 sets of 4 steps of ``size_px`` x ``size_px``.

    Parameters
    ----------
    size_px
        Side of the square frames.
    repeats
        Rounds; in each, every candidate runs once.

    Returns
    -------
    list of Row
        Depth and sigma of every pixel, and of the quarter of the picture's width and height that an object
        fills; calibration loaded, no facets fitted, the surface taken to be level across. And the latter with the slope
        across found, as a measurement does it.
    """
    tables = rig_tables(paper_rig(size_px))
    frames = [mirror_frames(tables, position_mm) for position_mm in POSITIONS_MM]
    whole = (slice(0, size_px), slice(0, size_px))
    object_seen = (slice(size_px * 12 // 32, size_px * 20 // 32), slice(size_px * 8 // 32, size_px * 16 // 32))
    names = ("depth, every pixel", "depth, an object's pixels", "depth, an object's pixels, slope across")
    candidates: dict[str, Callable[[], object]] = {
        names[0]: lambda: depth_of(frames, tables, whole, slope_rounds=0),
        names[1]: lambda: depth_of(frames, tables, object_seen, slope_rounds=0),
        names[2]: lambda: depth_of(frames, tables, object_seen, slope_rounds=2),
        DECODE: lambda: [decode(one, COUNTS) for one in frames],
    }
    medians = median_ms(candidates, repeats)
    return [
        slower(names[0], medians, DECODE, 2.5, 1.5),
        slower(names[1], medians, DECODE, 2.5, 1.5),
        slower(names[2], medians, DECODE, 2.5, 1.5),
    ]


def depth_of(frames: list[Frames], tables: RigTables, window: Window, *, slope_rounds: int) -> DepthMap:
    """Depth and its uncertainty in a window, from whole frames."""
    phases = [decode(one, COUNTS) for one in frames]
    views = Views(
        POSITIONS_MM,
        tuple(phase.phase_rad[window] for phase in phases),
        tuple(phase.sigma_in(window) for phase in phases),
        window,
    )
    return triangulate(views, tables.model, tables=tables, slope_rounds=slope_rounds)


def paper_rig(size_px: int) -> RigModel:
    """The paper's rig (physics notes, section 2) with a camera of this many pixels, its projector a degree askew."""
    scale = size_px / 2048
    lens = Intrinsics(
        (size_px, size_px),
        (2355.03 * scale, 2355.60 * scale),
        (1017.4 * scale - 0.5, 1019.1 * scale - 0.5),
        (-0.13744, 0.14780, -4e-5, -1.6e-4, 0.0),
    )
    sine, cosine = np.sin(_CAMERA_RAD), np.cos(_CAMERA_RAD)
    camera = ReferenceFrame(
        np.array([[cosine, 0.0, sine], [0.0, -1.0, 0.0], [sine, 0.0, -cosine]]), np.array([-160.0, 0.0, 330.0])
    )
    askew = np.deg2rad(1.0)
    axes = np.array([[np.cos(askew), 0.0, np.sin(askew)], [0.0, -1.0, 0.0], [np.sin(askew), 0.0, -np.cos(askew)]])
    centre = np.array([80.0 - 1670.0 * np.sin(askew), 0.0, 180.0 + 1670.0 * np.cos(askew)])
    projector = Projector((1024, 768), axes, centre, (4629.6, 4629.6), (511.5, 383.5), (0.245, 0.0, 0.0, 0.0, 0.0))
    return RigModel(lens, camera, (0.002, 0.001, 180.0), np.array([0.0, 0.0, -1.0]), projector, COUNTS[0])


def mirror_frames(tables: RigTables, position_mm: float) -> Frames:
    """Frames (3, 4, H, W) of the reference mirror, as if it and the glass filled the picture."""
    model = tables.model
    height, width = tables.rays_x.shape
    rng = np.random.default_rng(0)
    noise = rng.normal(0, _NOISE_DN, (height, width)).astype(np.float32)
    frames = np.empty((len(COUNTS), STEPS, height, width), np.uint8)
    for first in range(0, height, 64):
        rows = slice(first, min(first + 64, height))
        seen_x, seen_y = (rays[rows].astype(np.float64) for rays in (tables.rays_x, tables.rays_y))
        level = np.zeros_like(seen_x)
        x, y = tables.points_mm(level, (rows, slice(0, width)))
        leaving = np.stack([-seen_x, -seen_y, np.ones_like(seen_x)], axis=-1)
        lit = model.meet_glass(model.still(np.stack([x, y, level], axis=-1), position_mm), leaving)
        # Beyond the projector's picture the fringes go on: every pixel is to be decoded.
        phase = np.mod(model.phase_rad(lit, on_glass=True), 2 * np.pi * COUNTS[0]).astype(np.float32)
        for k, count in enumerate(COUNTS):
            for n in range(STEPS):
                fringes = 100 * np.cos(phase * np.float32(count / COUNTS[0]) + np.float32(2 * np.pi * n / STEPS))
                frames[k, n, rows] = np.rint(127 + fringes + np.roll(noise[rows], 17 * (STEPS * k + n)))
    return frames
