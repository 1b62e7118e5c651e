"""How long a noisy frame takes, beside the same frame in plain numpy."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sims.optics import SUBPIXELS
from sims.render import Exposure, exposure
from sims.rig import SimulatedRig

if TYPE_CHECKING:
    from sims.world import World

_MUST_MS, _AIM_MS = 100.0, 30.0


def bench_render(world: "World", *, runs: int) -> list[dict[str, Any]]:
    """Time `SimulatedRig.capture` with the pose known, at 8 and 10 bits.

    Returns
    -------
    Rows of name, value, unit, baseline, baseline_value, ratio (baseline over value), must and aim; medians.
    """
    rig = SimulatedRig(world)
    columns, rows = world.projector.size_px
    wave = 127.5 + 127.5 * np.cos(2 * np.pi * 64 * (np.arange(columns) + 0.5) / columns)
    picture = np.broadcast_to(np.round(wave).astype(np.uint8), (rows, columns))
    rig.show(picture)
    width, height = world.camera.size_px
    result = []
    for bits in (8, 10):
        rig.set_bits(bits)
        baseline = _median_ms(lambda bits=bits: _numpy_frame(rig, bits), max(3, runs // 5))
        name = f"render a noisy {width} x {height} frame, {bits} bits, pose known"
        result.append(_row(name, _median_ms(rig.capture, runs), baseline))

    def show_and_capture() -> None:
        rig.show(picture)
        rig.capture()

    name = f"show a picture and render a noisy {width} x {height} frame of it, 10 bits, pose known"
    result.append(_row(name, _median_ms(show_and_capture, runs), baseline))
    return result


def _row(name: str, value_ms: float, baseline_ms: float) -> dict[str, Any]:
    return {
        "name": name,
        "value": round(value_ms, 2),
        "unit": "ms",
        "baseline": "plain numpy (map look-up, separable blur, normal noise), 1 thread",
        "baseline_value": round(baseline_ms, 1),
        "ratio": round(baseline_ms / value_ms, 1),
        "must": _MUST_MS,
        "aim": _AIM_MS,
    }


def _median_ms(call: Callable[[], object], runs: int) -> float:
    call()
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times))


def _numpy_frame(rig: SimulatedRig, bits: int) -> NDArray[Any]:
    """Render a frame like those of `rig.capture()`, written plainly, with numpy's own noise."""
    camera, light, scene = rig.world.camera, rig.picture, rig.light_map()
    shot: Exposure = exposure(
        rig.world, rig.world.lights.infrared, exposure_us=camera.exposure_us, bits=bits, lamp=False, frame=0
    )
    c, r = scene.column // SUBPIXELS, scene.row // SUBPIXELS
    x = (scene.column % SUBPIXELS).astype(np.float32) / SUBPIXELS
    y = (scene.row % SUBPIXELS).astype(np.float32) / SUBPIXELS
    upper = light[r, c] * (1 - x) + light[r, c + 1] * x
    lower = light[r + 1, c] * (1 - x) + light[r + 1, c + 1] * x
    electrons = shot.projector_e * scene.factor * (upper * (1 - y) + lower * y)
    electrons = _blurred(_blurred(electrons, camera.psf_px).T, camera.psf_px).T + shot.ambient_e
    sigma = np.sqrt(camera.shot_noise * electrons + camera.read_noise_e**2)
    noise = np.random.default_rng(0).standard_normal(electrons.shape, dtype=np.float32)
    full_scale = 2**bits - 1
    share = np.minimum(electrons + sigma * noise, camera.full_well_e) * camera.gain / camera.full_well_e
    words = np.round(full_scale * np.clip(share, 0, 1) ** (1 / camera.gamma))
    return words.astype(np.uint8 if bits == 8 else np.uint16)


def _blurred(image: NDArray[Any], sigma: float) -> NDArray[Any]:
    if sigma == 0:
        return image
    reach = int(np.ceil(4 * sigma))
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    padded = np.pad(image, ((0, 0), (reach, reach)), mode="edge")
    return sum(np.float32(tap) * padded[:, k : k + image.shape[1]] for k, tap in enumerate(taps / taps.sum()))
