"""Projector, stages and camera of the world's process, through the real drivers, meet in one physics."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from world_client import WORLD, ServedWorld

from drivers.protocols import CameraSettings, Led, PatternSequence, SyncOutput
from irpmd_rig.core import decode, fringe_images
from sims.optics import trace
from sims.setup import Setup
from sims.world import load_world

COUNTS = (64.0, 63.0, 56.0)
WHITE, BLACK = 12, 13


@pytest.fixture(scope="module")
def loaded(opened: SimpleNamespace) -> SimpleNamespace:
    fringes = fringe_images(COUNTS, 4, (1024, 768)).reshape(12, 768, 1024)
    plain = np.stack([np.full((768, 1024), value, np.uint8) for value in (255, 0)])
    opened.projector.load(np.concatenate([fringes, plain]))
    opened.projector.set_led(Led.INFRARED, 0.6)
    return opened


def single(rig: SimpleNamespace, pattern: int, exposure_us: float = 8000.0) -> NDArray[np.uint8]:
    rig.camera.configure(CameraSettings(exposure_us=exposure_us, pixel_format="Mono8", trigger="software"))
    rig.projector.show(pattern)
    rig.camera.arm(1)
    rig.camera.trigger()
    image = rig.camera.fetch(10).image.copy()
    rig.camera.stop()
    return image


def burst(rig: SimpleNamespace, sync: SyncOutput | None = None) -> tuple[NDArray[np.uint16], list[float]]:
    rig.camera.configure(CameraSettings(exposure_us=7800.0, pixel_format="Mono10", trigger="hardware"))
    rig.projector.order(PatternSequence(tuple(range(12)), 8000.0))
    rig.projector.configure_sync(sync or SyncOutput(enabled=True))
    rig.camera.arm(12)
    rig.projector.run_once()
    frames = list(rig.camera.frames(10))
    rig.camera.stop()
    return np.stack([frame.image for frame in frames]), [frame.timestamp_s for frame in frames]


def place(world: ServedWorld, subject: str, *, glass: bool, lamp: bool = False, pose: int = 0) -> None:
    world("place", subject=subject, pose=pose)
    world("glass", present=glass)
    world("lamp", on=lamp)


def test_a_burst_on_the_sync_edges_decodes_to_the_truth(world: ServedWorld, loaded: SimpleNamespace) -> None:
    place(world, "mirror_step_x", glass=True)
    loaded.stage1.move_to(40.0)
    assert loaded.stage1.wait().position_mm == pytest.approx(40.0, abs=0.002)
    frames, times_s = burst(loaded)
    # The sequence's period, exactly: however late the threads of the world were.
    assert np.diff(times_s) == pytest.approx(0.0111, abs=1e-8)
    found = decode(frames.reshape(3, 4, *frames.shape[1:]), COUNTS).phase_rad
    truth = trace(load_world(WORLD).with_camera_size(frames.shape[1]), Setup("mirror_step_x", stage1_mm=40.0))
    wanted = 2 * np.pi * COUNTS[0] * (truth.projector_px[..., 0] + 0.5) / 1024
    error = np.abs(found - wanted)[np.isfinite(found) & np.isfinite(wanted)]
    assert error.size > 0.1 * found.size
    assert np.median(error) < 0.05
    assert np.quantile(error, 0.9) < 0.3


def test_white_black_and_no_light(world: ServedWorld, loaded: SimpleNamespace) -> None:
    place(world, "plate", glass=False)
    loaded.stage1.move_to(0.0)
    loaded.stage1.wait()
    white, black = single(loaded, WHITE), single(loaded, BLACK)
    loaded.projector.set_led(Led.INFRARED, 0.3)
    half = single(loaded, WHITE)
    loaded.projector.set_led(Led.INFRARED, 0.0)
    dark = single(loaded, WHITE)
    loaded.projector.set_led(Led.GREEN, 0.6)
    green = single(loaded, WHITE, 3250.0)
    loaded.projector.set_led(Led.INFRARED, 0.6)
    light = white.mean() - dark.mean()
    assert light > 100
    # The mirrors are never quite black: the world file's black level.
    assert (black.mean() - dark.mean()) / light == pytest.approx(0.1, abs=0.01)
    assert (half.mean() - dark.mean()) / light == pytest.approx(0.5, abs=0.01)
    # The ambient light behind the infrared filter, and without it: the world's two bands.
    assert dark.mean() == pytest.approx(6.0, abs=5.0)
    assert green.mean() - dark.mean() > 100


def test_the_lamp_shows_the_board(world: ServedWorld, loaded: SimpleNamespace) -> None:
    loaded.projector.set_led(Led.INFRARED, 0.0)
    place(world, "board", glass=False, lamp=True, pose=3)
    board = single(loaded, BLACK)
    place(world, "board", glass=False, lamp=False, pose=3)
    unlit = single(loaded, BLACK)
    loaded.projector.set_led(Led.INFRARED, 0.6)
    assert np.quantile(board, 0.95) > 3 * np.quantile(board, 0.3)
    assert board.max() > unlit.max() + 50


def test_stage2_carries_the_plate(world: ServedWorld, loaded: SimpleNamespace) -> None:
    place(world, "plate", glass=False)
    near = single(loaded, WHITE, 2000.0)
    loaded.stage2.move_to(100.0)
    loaded.stage2.wait()
    far = single(loaded, WHITE, 2000.0)
    loaded.stage2.move_to(0.0)
    loaded.stage2.wait()
    assert abs(near.mean() - far.mean()) > 2
    assert world("state")["stages"]["stage2"]["position_mm"] == pytest.approx(0.0, abs=0.01)


def test_a_negative_pulse_triggers_on_its_trailing_edge(world: ServedWorld, loaded: SimpleNamespace) -> None:
    place(world, "plate", glass=False)
    _, plain_s = burst(loaded, SyncOutput(enabled=True, width_us=100.0))
    _, times_s = burst(loaded, SyncOutput(enabled=True, polarity="negative", width_us=100.0))
    assert len(plain_s) == len(times_s) == 12
    loaded.projector.configure_sync(SyncOutput(enabled=True))


def test_the_state_is_what_the_drivers_did(world: ServedWorld, loaded: SimpleNamespace) -> None:
    loaded.projector.set_led(Led.INFRARED, 0.45)
    loaded.projector.show(WHITE)
    loaded.camera.configure(CameraSettings(exposure_us=1000.0, trigger="hardware"))
    loaded.camera.arm(3)
    state = world("state")
    assert state["led"] == "infrared"
    assert state["intensity"] == pytest.approx(0.45)
    assert (state["light"], state["running"], state["parked"]) == (True, True, False)
    assert state["camera"]["armed"] is True
    loaded.camera.stop()
    loaded.projector.park()
    state = world("state")
    assert (state["led"], state["intensity"], state["light"], state["parked"]) == (None, 0.0, False, True)
    assert state["camera"]["armed"] is False
    loaded.projector.unpark()
    loaded.stage2.move_to(150.0)
    assert world("state")["stages"]["stage2"]["moving"] is True
    loaded.stage2.stop()
    loaded.stage2.home()
    loaded.projector.set_led(Led.INFRARED, 0.6)
