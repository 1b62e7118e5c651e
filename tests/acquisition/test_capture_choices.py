"""What is chosen before frames are taken: exposures, the projector's times, the patterns in it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.protocols import Frame, Led, PatternTiming, ProjectorCapabilities
from irpmd_rig.acquisition.captured import Cancelled, FrameStack
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.exposure import measure_exposure_us
from irpmd_rig.acquisition.patterns import (
    BLACK,
    WHITE,
    PatternDeck,
    choose_timing,
    held_timing,
    longest_exposure_us,
)
from irpmd_rig.core import fringe_images
from irpmd_rig.core.errors import CountsError, FramesError

SIZE_PX = (1024, 768)


def frame(value: float, bits: int = 8) -> Frame:
    full = 2**bits - 1
    image = np.full((64, 64), min(round(value * full), full), np.uint8 if bits == 8 else np.uint16)
    return Frame(image, bits, 0, 0, None, 0.0, None)


def capabilities(*timings: tuple[float, float], **other) -> ProjectorCapabilities:
    listed = tuple(PatternTiming(exposure, period, 8, (Led.INFRARED,)) for exposure, period in timings)
    values = {"pattern_limit": 120, "can_load": True, "self_paced": True, "has_sync": True, "can_park": True}
    return ProjectorCapabilities("test", SIZE_PX, tuple(Led), **{"timings": listed or None, **values, **other})


# --- exposure


@given(st.floats(1e-6, 1e-2), st.sampled_from([8, 10]), st.floats(10.0, 1e5))
def test_the_exposure_found_brings_a_linear_camera_to_85_percent(share_per_us, bits, start_us):
    frames = []

    def shoot(exposure_us):
        frames.append(exposure_us)
        return frame(share_per_us * exposure_us, bits)

    found_us = measure_exposure_us(shoot, start_us, (10.0, 1e6))
    assert share_per_us * found_us == pytest.approx(0.85, abs=0.02)
    assert len(frames) <= 8


def test_near_the_right_exposure_a_single_frame_is_taken():
    tried = []
    measure_exposure_us(lambda us: tried.append(us) or frame(us / 10_000), 8000.0, (10.0, 1e5))
    assert tried == [8000.0]


def test_the_longest_exposure_is_taken_where_even_that_does_not_reach_85_percent():
    assert measure_exposure_us(lambda us: frame(us / 100_000), 1000.0, (10.0, 20_000.0)) == 20_000.0


@pytest.mark.parametrize(
    ("light", "words"), [(0.0, "nothing in the camera's view is lit"), (1.0, "full scale even at 10 us")]
)
def test_light_that_no_exposure_suits_is_said(light, words):
    with pytest.raises(FramesError, match=words):
        measure_exposure_us(lambda _: frame(light), 5000.0, (10.0, 1e5))


def test_light_that_is_not_steady_is_said():
    values = iter([1.0, 0.1] * 10)
    with pytest.raises(FramesError, match="not steady"):
        measure_exposure_us(lambda _: frame(next(values)), 5000.0, (0.001, 1e9))


# --- times of the projector


def test_the_shortest_period_that_camera_and_exposure_allow_is_chosen():
    can = capabilities((2500.0, 11_100.0), (10_000.0, 11_100.0), (12_000.0, 12_000.0), (20_000.0, 20_000.0))
    # 2048 lines of an xiQ need 11 072.5 us.
    assert choose_timing(can, Led.INFRARED, 2000.0, 11_072.5).exposure_us == 2500.0
    assert choose_timing(can, Led.INFRARED, 8000.0, 11_072.5).exposure_us == 10_000.0
    # The camera's exposure must end within the pattern's.
    assert choose_timing(can, Led.INFRARED, 9990.0, 11_072.5).exposure_us == 12_000.0
    assert choose_timing(can, Led.INFRARED, 11_900.0, 11_964.5).exposure_us == 12_000.0
    # And the camera must be ready for the next trigger.
    assert choose_timing(can, Led.INFRARED, 11_940.0, 12_004.5).exposure_us == 20_000.0


def test_the_longest_exposure_has_a_sequence():
    can = capabilities((2500.0, 2500.0), (20_000.0, 20_000.0))
    longest_us = longest_exposure_us(can, Led.INFRARED)
    assert 19_800.0 < longest_us < 20_000.0
    assert choose_timing(can, Led.INFRARED, longest_us, longest_us + 64.5).exposure_us == 20_000.0


def test_a_light_or_exposure_without_a_sequence_is_said():
    can = capabilities((2500.0, 2500.0))
    with pytest.raises(AcquisitionError, match="longest exposure is 2500 us"):
        choose_timing(can, Led.INFRARED, 9000.0, 9064.5)
    for choose in (lambda: choose_timing(can, Led.RED, 1000.0, 1064.5), lambda: held_timing(can, Led.RED, 1000.0)):
        with pytest.raises(AcquisitionError, match="in red"):
            choose()


def test_a_projector_that_takes_any_time_is_given_what_is_needed():
    can = capabilities()
    chosen = choose_timing(can, Led.GREEN, 4000.0, 11_072.5)
    assert chosen.exposure_us > 4000.0
    assert chosen.period_us > 11_072.5
    assert longest_exposure_us(can, Led.GREEN) == float("inf")
    assert held_timing(can, Led.GREEN, 50_000.0).exposure_us == 50_000.0


def test_patterns_shown_by_hand_take_the_nearest_sequence_whatever_the_exposure():
    can = capabilities((2500.0, 2500.0), (20_000.0, 20_000.0))
    assert held_timing(can, Led.INFRARED, 90_000.0).exposure_us == 20_000.0


# --- patterns in the projector


class Memory:
    """A projector that takes patterns, and nothing else."""

    name = "projector"

    def __init__(self, limit: int | None = 120, **other) -> None:
        self.loads: list[np.ndarray] = []
        self._limit, self._other = limit, other

    def capabilities(self) -> ProjectorCapabilities:
        return capabilities(pattern_limit=self._limit, **self._other)

    def load(self, patterns) -> None:
        self.loads.append(patterns)


def test_each_order_names_its_own_patterns_and_nothing_is_loaded_twice():
    memory = Memory()
    deck = PatternDeck(memory)
    counts = (64.0, 63.0)
    along_x = deck.fringes(counts, 4, "x")
    along_y = deck.fringes(counts, 3, "y")
    assert deck.fringes(counts, 4, "x") == along_x
    assert len(memory.loads) == 2
    loaded = memory.loads[-1]
    expected = fringe_images(counts, 4, SIZE_PX).reshape(-1, *reversed(SIZE_PX))
    np.testing.assert_array_equal(loaded[list(along_x)], expected)
    np.testing.assert_array_equal(
        loaded[list(along_y)], fringe_images(counts, 3, SIZE_PX, axis="y").reshape(-1, *reversed(SIZE_PX))
    )
    assert loaded[deck.plain(WHITE)[0]].min() == 255
    assert loaded[deck.plain(BLACK)[0]].max() == 0
    deck.forget()
    deck.plain(WHITE)
    assert len(memory.loads) == 3


def test_sets_make_room_for_others_and_too_many_are_refused():
    memory = Memory(limit=20)
    deck = PatternDeck(memory)
    deck.fringes((64.0, 63.0, 56.0), 4, "x")
    assert deck.fringes((64.0, 63.0, 56.0), 4, "y") == tuple(range(2, 14))
    with pytest.raises(AcquisitionError, match="more than the 20"):
        deck.fringes((64.0, 63.0, 56.0), 8, "x")


def test_counts_that_make_no_fringes_leave_the_deck_usable():
    deck = PatternDeck(Memory())
    with pytest.raises(CountsError):
        deck.fringes((-1.0,), 4, "x")
    assert deck.plain(WHITE) == (0,)


def test_a_projector_whose_patterns_lie_in_its_flash_is_refused():
    with pytest.raises(AcquisitionError, match="flash"):
        PatternDeck(Memory(can_load=False))


# --- values


def test_a_stack_keeps_frames_in_their_places():
    stack = FrameStack((2, 3))
    kept = [stack.put(number, frame(number / 10)) for number in range(6)]
    images = stack.images()
    assert images.shape == (2, 3, 64, 64)
    np.testing.assert_array_equal(images[1, 2], kept[5].image)
    assert not kept[0].image.flags.writeable


def test_errors_survive_a_process_boundary():
    import pickle

    assert str(pickle.loads(pickle.dumps(Cancelled()))) == str(Cancelled())
