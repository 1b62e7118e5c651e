"""Frames against a plain float64 account of the same light."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

import sims.bands
from sims.render import electrons_per_radiance, projected_light
from sims.rig import SimulatedRig
from sims.world import World, load_world


def fringes(step: int, count: int = 64) -> np.ndarray:
    wave = np.cos(2 * np.pi * count * (np.arange(1024) + 0.5) / 1024 + np.pi / 2 * step)
    return np.tile(np.round(127.5 + 127.5 * wave).astype(np.uint8), (768, 1))


def changed(world: World, part: str, **update: object) -> World:
    return world.model_copy(update={part: getattr(world, part).model_copy(update=update)})


def light_at(image: np.ndarray, blur: float, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Squares of the DMD convolved with a Gaussian, summed pixel by pixel around each place."""
    out = np.zeros(column.shape)
    for dv in range(-5, 6):
        v = np.round(row).astype(int) + dv
        down = ndtr((v + 0.5 - row) / blur) - ndtr((v - 0.5 - row) / blur)
        for du in range(-5, 6):
            u = np.round(column).astype(int) + du
            across = ndtr((u + 0.5 - column) / blur) - ndtr((u - 0.5 - column) / blur)
            inside = (u >= 0) & (u < 1024) & (v >= 0) & (v < 768)
            out += np.where(inside, image[np.clip(v, 0, 767), np.clip(u, 0, 1023)] * across * down, 0)
    return out


@pytest.mark.parametrize(("blur", "tolerance"), [(0.5, 3.5e-3), (0.8, 2.5e-3)])
def test_projected_light_is_squares_blurred_by_the_lens(ideal: World, blur: float, tolerance: float) -> None:
    projector = ideal.projector.model_copy(update={"lens_blur_px": blur, "black_level": 0.0})
    image = fringes(1)
    grid = projected_light(projector, image)
    generator = np.random.default_rng(3)
    column, row = generator.uniform(4, 1019, 2000), generator.uniform(4, 763, 2000)
    x, y = 2 * column + 0.5, 2 * row + 0.5
    i, j = y.astype(int), x.astype(int)
    fy, fx = y - i, x - j
    sampled = (grid[i, j] * (1 - fx) + grid[i, j + 1] * fx) * (1 - fy) + (
        grid[i + 1, j] * (1 - fx) + grid[i + 1, j + 1] * fx
    ) * fy
    assert np.abs(sampled - light_at(image / 255, blur, column, row)).max() < tolerance


def test_picture_passes_gamma_black_level_and_bits(ideal: World) -> None:
    flat = np.full((768, 1024), 100, np.uint8)
    update = {"gamma": 2.0, "black_level": 0.1, "bits": 4}
    projector = ideal.projector.model_copy(update=update)
    word = round(100 / 255 * 15) / 15
    assert projected_light(projector, flat)[700, 900] == pytest.approx(0.1 + 0.9 * word**2, rel=1e-6)
    assert projected_light(projector, None)[700, 900] == pytest.approx(0.1, rel=1e-6)


def test_a_frame_is_the_projected_light_at_the_traced_places(ideal: World) -> None:
    """No noise, psf 0.9: radiometry, optics blur and quantisation, written down anew in float64."""
    world = changed(ideal, "camera", psf_px=0.9)
    rig = SimulatedRig(world)
    image = fringes(2, 16)
    rig.show(image)
    frame = rig.capture().astype(float)
    seen = rig.trace()
    lit = seen.projector_factor_per_mm2 > 0
    light = np.zeros(frame.shape)
    places = seen.projector_px[lit]
    shown = world.projector.black_level + (1 - world.projector.black_level) * image / 255
    light[lit] = light_at(shown, world.projector.lens_blur_px, places[:, 0], places[:, 1])
    infrared = world.lights.infrared
    scale = electrons_per_radiance(world.camera, infrared, world.camera.exposure_us)
    power = world.projector.radiant_intensity_mw_per_sr * 1e3
    electrons = gaussian_filter(
        scale * power * light * seen.projector_factor_per_mm2, 0.9, mode="nearest", truncate=4.5
    )
    electrons += scale * infrared.ambient_radiance_uw_per_mm2_sr
    expected = electrons * 1023 / world.camera.full_well_e
    # Lit up to the picture's border the light falls to zero within a pixel: there the grid's clamp shows.
    assert np.percentile(np.abs(frame - expected), 99) < 1.0
    assert np.abs(frame - expected).mean() < 0.35


def test_electrons_follow_from_energy_of_the_photons(ideal: World) -> None:
    camera, light = ideal.camera, ideal.lights.infrared
    joule = 1e-6 * np.pi / (4 * camera.f_number**2) * (5.5e-3) ** 2 * light.filter_transmission * 8e-3
    photons = joule / (6.62607015e-34 * 299792458 / 850e-9)
    assert electrons_per_radiance(camera, light, 8000) == pytest.approx(photons * light.quantum_efficiency, rel=1e-12)


def test_dark_background_holds_ambient_light_only(ideal: World) -> None:
    rig = SimulatedRig(ideal)
    rig.place("nothing")
    rig.set_glass(False)
    rig.show(fringes(0))
    rig.set_lamp(True)
    light = ideal.lights.infrared
    scale = electrons_per_radiance(ideal.camera, light, ideal.camera.exposure_us)
    expected = round(scale * light.ambient_radiance_uw_per_mm2_sr * 1023 / ideal.camera.full_well_e)
    assert np.all(rig.capture() == expected)


def test_exposure_scales_light_until_it_saturates(ideal: World) -> None:
    rig = SimulatedRig(ideal)
    rig.show(np.full((768, 1024), 255, np.uint8))
    once = rig.capture().astype(int)
    rig.set_exposure(ideal.camera.exposure_us / 2)
    half = rig.capture().astype(int)
    assert np.abs(once - 2 * half).max() <= 2
    rig.set_exposure(20 * ideal.camera.exposure_us)
    assert rig.capture().max() == 1023


def test_frames_do_not_depend_on_the_threads(aligned: World, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = []
    for threads in (1, 2):
        monkeypatch.setattr(sims.bands, "THREADS", threads)
        rig = SimulatedRig(aligned)
        rig.place("mirror_step_y")
        rig.show(fringes(0))
        frames.append([rig.capture() for _ in range(2)])
    assert np.array_equal(frames[0], frames[1])


def test_flicker_moves_the_ambient_light_from_frame_to_frame(ideal: World) -> None:
    visible = ideal.lights.visible.model_copy(update={"ambient_flicker": 0.03})
    world = ideal.model_copy(update={"lights": ideal.lights.model_copy(update={"visible": visible})})
    rig = SimulatedRig(world)
    rig.place("nothing")
    rig.set_glass(False)
    rig.set_light("visible")
    means = np.array([rig.capture().mean() for _ in range(60)])
    assert means.std() / means.mean() == pytest.approx(0.03, rel=0.35)
    rig.set_light("infrared")
    assert len({rig.capture().mean() for _ in range(5)}) == 1


def test_phase_noise_is_that_of_the_physics_notes(worlds: Path) -> None:
    """N = 4, one set, modulation about 0.7: 14.7 mrad (physics notes, section 3); white peaks near 0.85."""
    rig = SimulatedRig(load_world(worlds / "aligned.yaml"))
    phases, modulation = [], []
    for _ in range(2):
        frames = []
        for step in range(4):
            rig.show(fringes(step))
            frames.append(rig.capture().astype(np.float32))
        a, b = frames[3] - frames[1], frames[0] - frames[2]
        phases.append(np.arctan2(a, b))
        modulation.append(np.hypot(a, b) / 2 / np.mean(frames, axis=0))
    seen = rig.trace()
    zone = (seen.kind == 1) & (seen.point_mm[..., 0] > 0) & (seen.point_mm[..., 0] < 72)
    difference = np.angle(np.exp(1j * (phases[0] - phases[1])))[zone]
    assert 1e3 * difference.std() / np.sqrt(2) == pytest.approx(14.7, rel=0.03)
    assert np.median(modulation[0][zone]) == pytest.approx(0.7, abs=0.02)
    rig.show(np.full((768, 1024), 255, np.uint8))
    assert np.percentile(rig.capture(), 99) / 255 == pytest.approx(0.85, abs=0.03)


def test_light_maps_stay_inside_the_picture_up_to_its_last_pixel(ideal: World) -> None:
    """A plate fills the image and is larger than the picture: its rim reads no sample that does not exist."""
    rig = SimulatedRig(changed(ideal, "projector", size_px=(1024, 300)).with_camera_size(512))
    rig.set_glass(False)
    rig.place("plate")
    scene = rig.light_map()
    assert (scene.factor == 0).any()
    assert scene.column.min() >= 0
    assert scene.row.min() >= 0
    assert (scene.column >> 17).max() <= 2 * 1024 - 2
    assert (scene.row >> 17).max() == 2 * 300 - 2
