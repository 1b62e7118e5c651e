"""The pattern error: computed from the images alone, removed from what a camera sees of them."""

import numpy as np
import pytest
from fringe_reference import hierarchical, optimum
from scipy.ndimage import binary_erosion, gaussian_filter1d

from irpmd_rig.core import fringe_images
from irpmd_rig.core.errors import CountsError, FramesError, MeasurementError
from irpmd_rig.core.phase import decode
from irpmd_rig.core.phase.pattern_error import PatternError, pattern_error
from sims.rig import SimulatedRig
from sims.world import load_world

COUNTS = (64, 63, 56)
WIDTH = 1024


def quiet_rig(gamma):
    """A strip of the full camera without noise, 10 bits."""
    world = load_world("configs/worlds/aligned.yaml")
    camera = world.camera
    strip = camera.model_copy(
        update={
            "size_px": (1000, 160),
            "cc_px": (camera.cc_px[0] - 800, camera.cc_px[1] - 950),
            "read_noise_e": 0.0,
            "shot_noise": False,
            "bits": 10,
        }
    )
    projector = world.projector.model_copy(update={"gamma": gamma, "roll_deg": 3.0})
    rig = SimulatedRig(world.model_copy(update={"camera": strip, "projector": projector}))
    rig.set_exposure(8500)
    return rig


def decoded(rig, steps):
    """Phase (H, W), rad, and the true one."""
    frames = []
    for images in fringe_images(COUNTS, steps):
        for image in images:
            rig.show(image)
            frames.append(rig.capture())
    frames = np.reshape(frames, (len(COUNTS), steps, *frames[0].shape))
    return decode(frames, COUNTS).phase_rad, 2 * np.pi * 64 * (rig.trace().projector_px[..., 0] + 0.5) / WIDTH


def coherent_mrad(phase_rad, true_rad, where):
    """What does not average out along the fringes: scatter of the mean errors of all projector columns."""
    where = binary_erosion(where & np.isfinite(phase_rad) & np.isfinite(true_rad), iterations=5)
    column = (true_rad[where] / (2 * np.pi) * 16).astype(int)
    number = np.bincount(column)
    total = np.bincount(column, (phase_rad - true_rad)[where])
    means = total[number > 10] / number[number > 10]
    return 1e3 * means.std()


@pytest.mark.parametrize(
    ("steps", "gamma", "left"),
    [
        (4, 1.0, 0.3),
        (8, 1.0, 0.3),
        # A response that is not linear has harmonics of its own at four steps, none at eight.
        (4, 1.05, 0.75),
        (8, 1.05, 0.3),
    ],
)
def test_most_of_the_coherent_error_of_noise_free_frames_is_removed(steps, gamma, left):
    rig = quiet_rig(gamma)
    for subject, kind in (("mirror", 1), ("mirror", 3), ("mirror_step_x", 1)):
        rig.place(subject)
        phase_rad, true_rad = decoded(rig, steps)
        seen = rig.trace().kind == kind
        before = coherent_mrad(phase_rad, true_rad, seen)
        pattern_error(COUNTS, steps, WIDTH).remove(phase_rad)
        assert before > 0.4
        assert coherent_mrad(phase_rad, true_rad, seen) < left * before


@pytest.mark.parametrize(
    ("counts", "unwrapping", "plainly"),
    [(COUNTS, "optimum", optimum), ((63, 56, 64), "optimum", optimum), ((1, 8, 64), "hierarchical", hierarchical)],
)
@pytest.mark.parametrize("steps", [3, 4, 5])
def test_it_is_the_error_of_the_blurred_images(counts, unwrapping, plainly, steps):
    width, fine, blur_px = 512, 40, 0.8
    images = fringe_images(counts, steps, (width, 1)).astype(float)
    squares = np.repeat(images, fine, axis=-1)
    light = gaussian_filter1d(squares, blur_px * fine, mode="constant", truncate=8)
    phase_rad, _ = plainly(light, counts)
    true_rad = 2 * np.pi * max(counts) * (np.arange(width * fine) + 0.5) / (width * fine)
    error = pattern_error(counts, steps, width, unwrapping=unwrapping, blur_px=blur_px)
    inside = np.s_[:, 4 * fine : -4 * fine]
    removed = error.remove(phase_rad.copy())
    assert np.abs(phase_rad - true_rad)[inside].max() > 4e-4
    np.testing.assert_allclose(removed[inside], np.broadcast_to(true_rad, removed.shape)[inside], atol=3e-5)


def test_phases_are_corrected_in_place_and_unknown_ones_stay_unknown():
    error = PatternError(np.array([0.0, 0.2, 0.0], np.float32), count=1)
    phase_rad = np.array([[0, np.pi / 2, np.pi, np.nan, 2 * np.pi]], np.float32)
    assert error.remove(phase_rad) is phase_rad
    np.testing.assert_allclose(phase_rad, [[0, np.pi / 2 - 0.1, np.pi - 0.2, np.nan, 2 * np.pi]], rtol=1e-6)


def test_what_cannot_be_is_refused():
    with pytest.raises(MeasurementError, match="blur_px"):
        pattern_error(COUNTS, 4, WIDTH, blur_px=0)
    with pytest.raises(CountsError):
        pattern_error((64, 60), 4, WIDTH)
    error = pattern_error(COUNTS, 4, WIDTH)
    with pytest.raises(FramesError, match="float32 or float64"):
        error.remove(np.zeros((2, 2), np.uint8))
    with pytest.raises(FramesError, match="contiguous"):
        error.remove(np.zeros((4, 4), np.float32)[:, ::2])
