"""Which pixels the check of the frames looks at, and how bright they are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.arguments import checked_number
from irpmd_rig.core.errors import CountsError, FramesError
from irpmd_rig.core.phase.arguments import frame_array, fringe_counts

Floats = NDArray[np.float64]

PIXELS = 12_000
"""Modulated pixels used at most: a 3 % blend at a noise of a quarter of the modulation is then 7 sigma."""

ENOUGH_LIT = 6_000
COARSE_STRIDE = 8
TILES = 8
"""The picture is cut into TILES x TILES tiles, whose scatter gives every significance."""

NOISE_FACTOR = 1.7
"""Variation of a dark pixel over 12 frames, in units of its mean, that is exceeded once in a thousand."""

LIT_SHARE = 0.15
NOISE_SHARE = 0.5
"""A pixel is lit if its variation over all frames is above 1 DN of 255, LIT_SHARE of the 95th percentile,
and what the noise makes of a dark pixel (of that at most NOISE_SHARE of the 95th percentile)."""

BIT_DEPTHS = (8, 10, 12, 14, 16)


@dataclass(frozen=True, slots=True)
class Sample:
    """Sub-sampled lit pixels.

    Attributes
    ----------
    values_dn
        (sets, steps, pixels), ordered by tile.
    tile
        (pixels,) index of the tile of each pixel, ascending.
    lit_pixels
        Number of sampled lit pixels, saturated ones included.
    saturated_fraction
        (sets, steps): share of the lit pixels (if none is lit: of all) at full scale.
    lit_fraction
        Share of the sampled picture that is lit.
    noise_dn
        Noise, or more than it: seen in whichever of two ways fringes and faults disturb less.
    """

    values_dn: Floats
    tile: NDArray[np.int64]
    lit_pixels: int
    saturated_fraction: Floats
    lit_fraction: float
    noise_dn: float


def checked_frames(
    frames: NDArray[np.generic], counts: Sequence[float], saturation_dn: float | None
) -> tuple[NDArray[np.generic], Floats]:
    """Frames of the machine's byte order, and counts; those that cannot be checked are refused.

    Raises
    ------
    FramesError
        Wrong number of axes, type, fewer than three steps, NaN, masked values, values over full scale.
    CountsError
        Not one positive count for each set.
    MeasurementError
        A saturation_dn that is no positive number.
    """
    frames = frame_array(frames)
    if frames.ndim != 4 or 0 in frames.shape:
        raise FramesError(f"frames have shape {frames.shape}: accepted is (sets, steps, rows, columns)")
    native = frames.dtype.newbyteorder("=")
    if native not in (np.uint8, np.uint16, np.float32):
        raise FramesError(f"frames are {frames.dtype}: accepted are uint8, uint16 and float32")
    if frames.shape[1] < 3:
        raise FramesError(f"{frames.shape[1]} steps a set: accepted are 3 or more")
    frames = frames.astype(native, copy=False)
    if frames.dtype == np.float32 and not np.isfinite(frames.sum(dtype=np.float64)):
        raise FramesError("frames hold NaN or infinite values: accepted are finite values")
    if saturation_dn is not None:
        saturation_dn = checked_number("saturation_dn", saturation_dn, zero=False)
        if float(frames.max()) > saturation_dn:
            raise FramesError(f"a value of {frames.max()} is over the full scale of {saturation_dn}")
    periods = fringe_counts(counts)
    if periods.size != frames.shape[0]:
        raise CountsError(f"{periods.size} fringe counts for {frames.shape[0]} sets: accepted is one each")
    return frames, periods


def full_scale_dn(frames: NDArray[np.generic], saturation_dn: float | None) -> float | None:
    """Tell at which value the camera saturates: as told, or from the type; None for floats.

    A uint16 frame comes from a camera of 8, 10, 12, 14 or 16 bits: the smallest that holds the values.
    """
    if saturation_dn is not None:
        return float(saturation_dn)
    if frames.dtype == np.float32:
        return None
    if frames.dtype == np.uint8:
        return 255.0
    highest = int(frames.max())
    return float(next(2**b - 1 for b in BIT_DEPTHS if 2**b > highest))


def harmonics(values: Floats) -> tuple[Floats, NDArray[np.complex128]]:
    """Compute mean and complex first harmonic, z = B exp(i phase), of (sets, steps, pixels)."""
    steps = values.shape[1]
    kernel = np.exp(-2j * np.pi * np.arange(steps) / steps) * (2.0 / steps)
    return values.mean(axis=1), np.einsum("n,knp->kp", kernel, values)


def _noise_within_dn(values: Floats, variation: Floats) -> float:
    """Estimate the noise of the darkest third of the pixels from the set that is most like a sinusoid."""
    steps = values.shape[1]
    if steps == 3:
        return np.inf
    dark = values[..., variation <= np.quantile(variation, 0.3)]
    mean, z = harmonics(dark)
    rotor = np.exp(2j * np.pi * np.arange(steps) / steps)
    rest = np.abs(dark - mean[:, None] - (z[:, None] * rotor[:, None]).real)
    return float(1.4826 * np.median(rest, axis=(1, 2)).min() * np.sqrt(steps / (steps - 3)))


def _noise_along_rows_dn(frames: NDArray[np.generic]) -> float:
    """Estimate the noise of the darkest third from third differences along a few rows: order is no matter."""
    rows, columns = frames.shape[2:]
    if columns < 8:
        return np.inf
    lines = frames[:, :, rows // 32 :: max(1, rows // 16)].astype(np.float64)
    difference = np.diff(lines, n=3, axis=3) / np.sqrt(20.0)
    variation = lines.std(axis=(0, 1))[:, 1:-2]
    dark = variation <= np.quantile(variation, 0.3)
    return float(1.4826 * np.median(np.abs(difference[..., dark])))


def take_sample(frames: NDArray[np.generic], full_scale: float | None) -> Sample:
    """Draw lit pixels from a regular grid, made finer until there are enough of them.

    What is lit is judged by the variation over all frames, which does not depend on their order.
    """
    sets, steps, rows, columns = frames.shape
    stride = COARSE_STRIDE
    while stride > 1 and rows * columns < 4 * ENOUGH_LIT * stride**2:
        stride //= 2
    along_rows = _noise_along_rows_dn(frames)
    while True:
        grid = frames[:, :, stride // 2 :: stride, stride // 2 :: stride]
        shape = grid.shape[2:]
        values = grid.reshape(sets, steps, -1).astype(np.float64)
        variation = np.sqrt(2) * values.std(axis=(0, 1))
        strong = float(np.quantile(variation, 0.95))
        noise = np.sqrt(2) * min(along_rows, _noise_within_dn(values, variation))
        one_dn = 1.0 if full_scale is None else full_scale / 255
        lit = np.flatnonzero(
            variation > max(one_dn, LIT_SHARE * strong, min(NOISE_FACTOR * noise, NOISE_SHARE * strong))
        )
        if lit.size >= ENOUGH_LIT or stride == 1 or rows * columns > 4 * stride**2 * 1_000_000:
            break
        stride //= 2
    return _tiled(values, lit, shape, full_scale, noise / np.sqrt(2))


def _tiled(
    values: Floats,
    lit: NDArray[np.int64],
    shape: tuple[int, ...],
    full_scale: float | None,
    noise_dn: float,
) -> Sample:
    """Choose up to PIXELS unsaturated lit pixels and order them by tile."""
    lit_values = values[..., lit]
    size = lit_values.shape[2]
    saturated = _at_full_scale(lit_values, full_scale)
    usable: NDArray[np.bool_] = np.logical_not(saturated.any(axis=(0, 1)))
    if np.count_nonzero(usable) < 0.1 * size:
        usable = np.ones(size, bool)
    chosen = np.flatnonzero(usable)
    if chosen.size > PIXELS:
        # Not every n-th pixel: a regular choice could beat with the fringes.
        chosen = np.sort(np.random.default_rng(0).choice(chosen, PIXELS, replace=False))
    row, column = np.divmod(lit[chosen], shape[1])
    tile = _tile_of(row) * TILES + _tile_of(column)
    order = np.argsort(tile, kind="stable")
    return Sample(
        values_dn=lit_values[..., chosen[order]],
        tile=tile[order],
        lit_pixels=size,
        saturated_fraction=(saturated if size else _at_full_scale(values, full_scale)).mean(axis=2),
        lit_fraction=size / values.shape[2],
        noise_dn=float(noise_dn),
    )


def _at_full_scale(values: Floats, full_scale: float | None) -> NDArray[np.bool_]:
    return np.zeros(values.shape, bool) if full_scale is None else values >= full_scale


def _tile_of(position: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut the lit range into TILES equal parts and tell which part each position is in."""
    if position.size == 0:
        return position
    first, last = int(position.min()), int(position.max())
    return (position - first) * TILES // (last - first + 1)
