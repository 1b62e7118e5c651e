"""Frames in step with the projector: through the real drivers, on twins that answer on the wire."""

import itertools
import threading
import time

import numpy as np
import pytest
from capture_pair import FRAME_TIMEOUT_S, HEIGHT, SPEED, WIDTH, Pair

from drivers.protocols import DeviceLost, FramesLost, Led
from irpmd_rig.acquisition.capture import Cancelled, FrameQuality
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.core import decode
from irpmd_rig.core.errors import FramesError
from tests.small_world import until

COUNTS = (16.0, 15.0, 12.0)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    pair = Pair(tmp_path_factory.mktemp("pair"))
    yield pair
    pair.close()


@pytest.fixture(autouse=True)
def _as_it_was(request):
    yield
    if "pair" in request.fixturenames:
        pair = request.getfixturevalue("pair")
        pair.brightness, pair.seen = 1.0, lambda light: light


@pytest.fixture(params=["hardware", "software"])
def photographer(request, pair):
    return pair.photographer(request.param)


def columns(phase) -> np.ndarray:
    """The projector's column that each pixel saw."""
    return phase.phase_rad / (2 * np.pi * COUNTS[0]) * 1024 - 0.5


def test_every_frame_shows_its_own_pattern(photographer):
    photographer.expose("white", 8000.0)
    taken = photographer.fringes(COUNTS, 4)
    assert [(frame.set, frame.step) for frame in taken] == [(k, n) for k in range(3) for n in range(4)]
    assert all(frame.attempt == 1 and frame.exposure_us == 8000.0 for frame in taken)
    assert all(frame.led is Led.INFRARED and frame.intensity == 0.6 for frame in taken)
    assert taken[0].checks["within_sets_checked"]
    assert taken.images.shape == (3, 4, HEIGHT, WIDTH)
    assert np.shares_memory(taken[5].frame.image, taken.images)
    seen = columns(decode(taken.images, COUNTS))
    np.testing.assert_allclose(seen - np.arange(2, 1024, 4), 0.0, atol=1.5)
    assert photographer.faults == {}


def test_rows_ten_bits_and_other_fringes_come_through_the_same_photographer(pair):
    photographer = pair.photographer(pixel_format="Mono10")
    photographer.expose("white", 8000.0)
    photographer.fringes(COUNTS, 4)
    taken = photographer.fringes((16.0, 15.0, 12.0), 5, "y")
    assert taken.images.dtype == np.uint16
    assert taken[0].frame.bits == 10
    assert taken[0].orientation == "y"
    seen = decode(taken.images, COUNTS).phase_rad / (2 * np.pi * 16) * 768 - 0.5
    np.testing.assert_allclose(seen - np.arange(2, 768, 4)[:, None], 0.0, atol=1.5)


@pytest.mark.parametrize(("trigger", "brightness"), [("hardware", 0.5), ("hardware", 12.0), ("software", 0.3)])
def test_auto_exposure_brings_the_brightest_parts_to_85_percent(trigger, pair, brightness):
    photographer = pair.photographer(trigger)
    pair.brightness = brightness
    chosen_us = photographer.expose("white")
    white = photographer.white()
    assert white.exposure_us == pytest.approx(chosen_us, abs=1.0)
    assert white.checks["brightness"] == pytest.approx(0.85, abs=0.03)
    assert photographer.black().checks["brightness"] < 0.1


def test_auto_exposure_ends_at_the_longest_sequence_of_the_projector(pair):
    pair.brightness = 0.2
    photographer = pair.photographer("hardware")
    chosen_us = photographer.expose("white")
    assert 19_800.0 < chosen_us < 20_000.0
    assert photographer.white().checks["brightness"] == pytest.approx(0.2 * 257 / 255 * chosen_us / 1e4, abs=0.03)


def test_nothing_lit_is_said(pair):
    photographer = pair.photographer("hardware")
    pair.seen = np.zeros_like
    pair.ambient = 0.0
    try:
        with pytest.raises(FramesError, match="nothing in the camera's view is lit"):
            photographer.expose("white")
    finally:
        pair.ambient = 4.0


def test_plain_frames_see_no_projector(photographer, pair):
    photographer.expose("white", 8000.0)
    photographer.white()
    plain = photographer.plain()
    assert plain.led is None
    assert plain.frame.image.mean() == pytest.approx(4.0, abs=0.2)
    assert pair.box.showing().led == "none"
    # And fringes after it.
    assert len(photographer.fringes(COUNTS, 4)) == 12


def test_an_exposure_that_no_sequence_can_hold_is_refused(pair):
    with pytest.raises(AcquisitionError, match="out of range"):
        pair.photographer("hardware").expose("white", 25_000.0)
    # Pattern by pattern there is no such bound.
    assert pair.photographer("software").expose("white", 25_000.0) == 25_000.0


def test_what_is_prepared_while_the_stage_moves_is_taken_or_given_up_for_something_else(photographer):
    photographer.expose("white", 8000.0)
    for between in (list, photographer.white, photographer.plain, lambda: photographer.expose("white", 7000.0)):
        photographer.begin_move("stage1", 1.0)
        photographer.prepare_fringes(COUNTS, 4)
        photographer.move("stage1", 1.0)
        between()
        taken = photographer.fringes(COUNTS, 4)
        assert photographer.faults == {}
        np.testing.assert_allclose(columns(decode(taken.images, COUNTS)) - np.arange(2, 1024, 4), 0.0, atol=1.5)
    assert taken[0].exposure_us == 7000.0
    photographer.move("stage1", 0.0)


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (lambda pair: pair.twin.faults.drop_next(), "lost"),
        (lambda pair: pair.twin.faults.incomplete_next(), "incomplete"),
        (lambda pair: pair.twin.faults.miss_triggers(), "late"),
        (lambda pair: pair.twin.faults.late_next(seconds=1.5 * FRAME_TIMEOUT_S * SPEED), "late"),
    ],
    ids=["dropped", "incomplete", "missed trigger", "late"],
)
def test_a_frame_that_does_not_come_right_is_taken_again_and_no_index_shifts(photographer, pair, fault, kind):
    photographer.expose("white", 8000.0)
    photographer.white()
    fault(pair)
    taken = photographer.fringes(COUNTS, 4)
    assert sum(photographer.faults.values()) == 1
    # A camera does not know of the loss of its last frame, which with a software trigger each one is.
    assert photographer.faults.keys() <= {kind, "late"}
    seen = columns(decode(taken.images, COUNTS))
    np.testing.assert_allclose(seen - np.arange(2, 1024, 4), 0.0, atol=1.5)


def test_a_sync_pulse_in_the_middle_that_is_missed_repeats_the_burst(pair):
    photographer = pair.photographer()
    photographer.expose("white", 8000.0)
    photographer.take_fringes(COUNTS, 4)
    edges = itertools.count(1)
    pair.box.on_sync(lambda _: pair.box.faults.miss_sync() if next(edges) == 3 else None, output=1)
    taken = photographer.fringes(COUNTS, 4)
    assert taken[0].attempt == 2
    np.testing.assert_allclose(columns(decode(taken.images, COUNTS)) - np.arange(2, 1024, 4), 0.0, atol=1.5)


def test_a_burst_in_series_of_which_a_frame_is_lost_is_not_taken_again(pair):
    photographer = pair.photographer("hardware")
    photographer.expose(exposure_us=2500.0)
    photographer.prepare_series((8.0,), 4, 10)
    pair.twin.faults.drop_next()
    with pytest.raises(FramesLost, match="failed 1 times"):
        photographer.series((8.0,), 4, 10, time.monotonic())
    assert photographer.faults["lost"] == 1


@pytest.mark.parametrize("trigger", ["hardware", "software"])
def test_frames_that_never_come_end_in_one_error_in_bounded_time(trigger, pair):
    hasty = pair.photographer(trigger, frame_timeout_s=0.5)
    hasty.expose("white", 8000.0)
    pair.twin.faults.miss_triggers(100)
    began_s = time.monotonic()
    try:
        with pytest.raises(FramesLost, match="failed 3 times"):
            hasty.white()
    finally:
        pair.twin.faults.miss_triggers(0)
    # Three waits of half a second, and not the hundred that are missed.
    assert time.monotonic() - began_s < 30.0
    photographer = pair.photographer(trigger)
    photographer.expose("white", 8000.0)
    photographer.white()


def test_a_saturated_measurement_is_taken_again_and_then_refused(pair):
    photographer = pair.photographer("hardware")
    photographer.expose("white", 8000.0)
    pair.brightness = 4.0
    with pytest.raises(FrameQuality, match="full scale") as caught:
        photographer.fringes(COUNTS, 4)
    assert {finding.kind for finding in caught.value.report.findings} >= {"saturated"}
    assert photographer.faults["faulty"] == 3


def test_a_stale_frame_is_found_and_the_set_taken_again(pair):
    photographer = pair.photographer()
    photographer.expose("white", 8000.0)
    former: list[np.ndarray] = []
    stale = iter([False] * 5 + [True])

    def seen(light):
        former.append(light)
        return former[-2] if next(stale, False) else light

    pair.seen = seen
    taken = photographer.fringes(COUNTS, 4)
    assert photographer.faults == {"faulty": 1}
    assert {frame.attempt for frame in taken} == {2}


def test_an_led_that_someone_else_turned_off_is_lit_again(pair):
    photographer = pair.photographer()
    photographer.expose("white", 8000.0)
    photographer.fringes(COUNTS, 4)
    pair.instruments.projector.set_led(Led.INFRARED, 0.0)
    assert photographer.fringes(COUNTS, 4)[0].attempt == 2


def test_an_unplugged_camera_is_device_lost_and_after_replug_all_is_well(photographer, pair):
    photographer.expose("white", 8000.0)
    photographer.white()
    pair.twin.faults.unplug()
    try:
        with pytest.raises(DeviceLost):
            photographer.fringes(COUNTS, 4)
    finally:
        pair.twin.faults.replug()
    assert pair.box.showing().image is None
    assert len(photographer.fringes(COUNTS, 4)) == 12


def test_cancelling_ends_a_wait_for_a_frame_and_leaves_the_projector_dark(pair):
    cancelled = threading.Event()
    photographer = pair.photographer(cancelled=cancelled, frame_timeout_s=100.0)
    photographer.expose("white", 8000.0)
    photographer.white()
    pair.twin.faults.miss_triggers(100)
    threading.Timer(0.3, cancelled.set).start()
    began_s = time.monotonic()
    try:
        with pytest.raises(Cancelled):
            photographer.fringes(COUNTS, 4)
    finally:
        pair.twin.faults.miss_triggers(0)
    # Long before the frame would be given up.
    assert time.monotonic() - began_s < 30.0
    assert pair.box.showing().image is None


def test_a_move_ends_at_its_target_and_need_not_be_made_twice(pair, monkeypatch):
    photographer = pair.photographer()
    there = photographer.move("stage1", 3.0)
    assert there.measured
    assert there.position_mm == pytest.approx(3.0, abs=0.02)
    with monkeypatch.context() as patch:
        patch.setattr(pair.instruments.stages["stage1"], "move_to", pytest.fail)
        assert photographer.move("stage1", 3.0) == there
    photographer.begin_move("stage1", 0.0)
    assert photographer.move("stage1", 0.0).position_mm == pytest.approx(0.0, abs=0.02)


def test_a_cancelled_move_stops_the_stage(pair):
    cancelled = threading.Event()
    photographer = pair.photographer(cancelled=cancelled)
    stage = pair.instruments.stages["stage1"]
    # So slow that it is on its way whenever the machine comes to cancel it.
    stage.set_speed(1.0)

    def cancel_under_way() -> None:
        until(pair.stage_twin.moving)
        cancelled.set()

    canceller = threading.Thread(target=cancel_under_way)
    canceller.start()
    with pytest.raises(Cancelled):
        photographer.move("stage1", 45.0)
    canceller.join()
    until(lambda: not pair.stage_twin.moving())
    assert pair.stage_twin.position_mm() < 44.0
    stage.set_speed(20.0)
    pair.photographer().move("stage1", 0.0)


def test_a_stage_that_is_not_there_is_said(pair):
    with pytest.raises(AcquisitionError, match="it has stage1"):
        pair.photographer().move("stage7", 1.0)
