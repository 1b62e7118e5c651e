"""A frame from the picture that the projector was told to show and a traced light map: compiled.

The picture becomes light by the projector's response and lens; every pixel takes the light at its traced
place, adds the lamp's and the ambient light, the camera's optics blur the sum, and the sensor makes words of
it.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sims.bands import over_rows
from sims.compiled import kernel
from sims.optics import SUBPIXELS, LightMap
from sims.sensor import frame_key, gaussian_row, words_row

if TYPE_CHECKING:
    from sims.instruments import Camera, Light, Projector
    from sims.world import World

Image = NDArray[np.float32]
_PLANCK_TIMES_C_J_M = 6.62607015e-34 * 299792458.0
_BITS = int(math.log2(SUBPIXELS))
_TAIL = 4.0


def projected_light(projector: "Projector", image: NDArray[np.uint8] | None) -> Image:
    """Light of the picture, 1 for white, on a grid of two samples a projector pixel in each direction.

    Every pixel of the DMD is a uniform square, blurred by the lens: the light is the picture convolved with a
    square and a Gaussian, both known in closed form, so the samples are exact whatever the blur. Between
    samples half a pixel apart a bilinear interpolation is then good to 0.1 mrad of a 16-pixel fringe; one
    taken between the pixels themselves would leave a ripple of 1 mrad that no projector shows.

    Parameters
    ----------
    image : (rows, columns) uint8, or None for a black picture.

    Returns
    -------
    (2 rows, 2 columns) float32; sample (i, j) is at projector pixel ((i - 0.5) / 2, (j - 0.5) / 2).
    """
    width, height = projector.size_px
    levels = 2**projector.bits - 1
    words = np.round(np.arange(256) / 255 * levels) / levels
    response = (projector.black_level + (1 - projector.black_level) * words**projector.gamma).astype(np.float32)
    light = np.full((height, width), response[0]) if image is None else response[image]
    even, odd = _kernels(projector.lens_blur_px)
    rows = np.empty((height, 2 * width), np.float32)
    over_rows(lambda first, last: _spread_columns(light, even, odd, first, last, rows), height)
    out = np.empty((2 * height, 2 * width), np.float32)
    over_rows(lambda first, last: _spread_rows(rows, even, odd, first, last, out), height)
    return out


def _kernels(blur: float) -> tuple[Image, Image]:
    """Weights of the pixels around a sample a quarter pixel before a pixel's centre, and after it."""
    reach = math.ceil(0.75 + _TAIL * blur)
    offsets = np.arange(-reach, reach + 1)

    def step(x: float) -> float:
        return 0.5 * math.erfc(-x / (blur * math.sqrt(2))) if blur > 0 else float(x > 0)

    kernels = []
    for place in (-0.25, 0.25):
        weights = np.array([step(k + 0.5 - place) - step(k - 0.5 - place) for k in offsets])
        kernels.append((weights / weights.sum()).astype(np.float32))
    return kernels[0], kernels[1]


@kernel
def _spread_columns(light: Image, even: Image, odd: Image, first: int, last: int, out: Image) -> None:
    width, reach = light.shape[1], even.size // 2
    padded = np.empty(width + 2 * reach, np.float32)
    a, b = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(first, last):
        padded[reach : reach + width] = light[v]
        # Beyond the DMD there is no light.
        padded[:reach] = 0.0
        padded[reach + width :] = 0.0
        a[:] = 0.0
        b[:] = 0.0
        for k in range(even.size):
            we, wo = even[k], odd[k]
            part = padded[k : k + width]
            for j in range(width):
                a[j] += we * part[j]
                b[j] += wo * part[j]
        for j in range(width):
            out[v, 2 * j] = a[j]
            out[v, 2 * j + 1] = b[j]


@kernel
def _spread_rows(rows: Image, even: Image, odd: Image, first: int, last: int, out: Image) -> None:
    height, width, reach = rows.shape[0], rows.shape[1], even.size // 2
    for v in range(first, last):
        a, b = out[2 * v], out[2 * v + 1]
        a[:] = 0.0
        b[:] = 0.0
        for k in range(even.size):
            source = v + k - reach
            if 0 <= source < height:
                we, wo = even[k], odd[k]
                part = rows[source]
                for j in range(width):
                    a[j] += we * part[j]
                    b[j] += wo * part[j]


@dataclass(frozen=True, slots=True)
class Exposure:
    """One frame's scales.

    Attributes
    ----------
    projector_e : electrons of a pixel for white light and a factor of 1 / mm^2.
    lamp_e : electrons for a lamp factor of 1 (0: the lamp is off).
    ambient_e : electrons of the ambient light.
    bits : 8 or 10.
    key : what makes the frame's noise its own.
    """

    projector_e: float
    lamp_e: float
    ambient_e: float
    bits: int
    key: NDArray[np.uint32]


def electrons_per_radiance(camera: "Camera", light: "Light", exposure_us: float) -> float:
    """Electrons of a pixel for 1 uW / (mm^2 sr): lens, filter, pixel, exposure, photon energy, QE."""
    solid_angle = math.pi / (4 * camera.f_number**2)
    area_mm2 = (camera.pixel_um * 1e-3) ** 2
    energy_j = 1e-6 * solid_angle * area_mm2 * light.filter_transmission * exposure_us * 1e-6
    return energy_j * light.quantum_efficiency * light.wavelength_nm * 1e-9 / _PLANCK_TIMES_C_J_M


def exposure(world: "World", light: "Light", *, exposure_us: float, bits: int, lamp: bool, frame: int) -> Exposure:
    """Scales of frame number `frame`; the ambient light's flicker is drawn here."""
    scale = electrons_per_radiance(world.camera, light, exposure_us)
    flicker = np.random.default_rng([world.seed, 0xF11C, frame]).standard_normal() * light.ambient_flicker
    return Exposure(
        projector_e=scale * world.projector.radiant_intensity_mw_per_sr * 1e3,
        lamp_e=scale * world.lamp.irradiance_uw_per_mm2 if lamp else 0.0,
        ambient_e=scale * light.ambient_radiance_uw_per_mm2_sr * max(1.0 + float(flicker), 0.0),
        bits=bits,
        key=frame_key(world.seed, frame),
    )


def render(camera: "Camera", light: Image, scene: LightMap, shot: Exposure) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Render one frame: uint8 (8 bits) or uint16 (10 bits), of the light map's shape."""
    reach = math.ceil(_TAIL * camera.psf_px)
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(camera.psf_px, 1e-6)) ** 2)
    taps = (taps / taps.sum()).astype(np.float32)
    full_scale = 2**shot.bits - 1
    numbers = np.array(
        [
            shot.projector_e,
            shot.lamp_e,
            shot.ambient_e,
            float(camera.shot_noise),
            camera.read_noise_e**2,
            camera.full_well_e,
            full_scale / camera.full_well_e * camera.gain,
            full_scale,
            1 / camera.gamma,
        ],
        dtype=np.float32,
    )
    out = np.empty(scene.column.shape, np.uint8 if shot.bits == 8 else np.uint16)
    flat = light.reshape(-1)
    over_rows(
        lambda first, last: _render_rows(flat, light.shape[1], scene, taps, numbers, shot.key, first, last, out),
        out.shape[0],
    )
    return out


@kernel(fastmath={"contract"})
def _sample_row(
    light: NDArray[np.float32],
    stride: int,
    column: NDArray[np.int32],
    row: NDArray[np.int32],
    factor: NDArray[np.float32],
    scale: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Electrons of the projector's light along one row: bilinear between four samples."""
    part = np.float32(1.0 / SUBPIXELS)
    mask = np.int32(SUBPIXELS - 1)
    for j in range(out.size):
        c, r = column[j], row[j]
        fx, fy = np.float32(c & mask) * part, np.float32(r & mask) * part
        base = np.uint32((r >> _BITS) * stride + (c >> _BITS))
        a, b = light[base], light[base + np.uint32(1)]
        d, e = light[base + np.uint32(stride)], light[base + np.uint32(stride) + np.uint32(1)]
        upper = a + fx * (b - a)
        lower = d + fx * (e - d)
        out[j] = scale * factor[j] * (upper + fy * (lower - upper))


@kernel(fastmath={"contract"})
def _add_scaled(weight: np.float32, source: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    for j in range(out.size):
        out[j] += weight * source[j]


@kernel
def _render_rows(
    light: NDArray[np.float32],
    stride: int,
    scene: LightMap,
    taps: NDArray[np.float32],
    numbers: NDArray[np.float32],
    key: NDArray[np.uint32],
    first: int,
    last: int,
    out: NDArray[np.uint8],
) -> None:
    rows, columns = out.shape
    reach = taps.size // 2
    sharp = np.empty(columns + 2 * reach, np.float32)
    ring = np.empty((taps.size, columns), np.float32)
    electrons = np.empty(columns, np.float32)
    noise = np.empty(columns + columns % 2, np.float32)
    middle = sharp[reach : reach + columns]
    for v in range(first - reach, last + reach):
        # The image's edge rows and columns stand for what lies beyond them.
        source = min(max(v, 0), rows - 1)
        _sample_row(light, stride, scene.column[source], scene.row[source], scene.factor[source], numbers[0], middle)
        if numbers[1] > np.float32(0.0):
            _add_scaled(numbers[1], scene.lamp[source], middle)
        sharp[:reach] = sharp[reach]
        sharp[reach + columns :] = sharp[reach + columns - 1]
        across = ring[(v - first + reach) % taps.size]
        across[:] = 0.0
        for k in range(taps.size):
            _add_scaled(taps[k], sharp[k : k + columns], across)
        row = v - reach
        if row < first:
            continue
        electrons[:] = numbers[2]
        for k in range(taps.size):
            _add_scaled(taps[k], ring[(row - first + k) % taps.size], electrons)
        gaussian_row(key, row, noise)
        words_row(electrons, noise, numbers[3], numbers[4], numbers[5], numbers[6], numbers[7], numbers[8], out[row])
