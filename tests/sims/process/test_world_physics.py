"""What an exposure sees: the light, subject and stages of its own time, whoever asks later."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from sims.clock import ManualClock
from sims.errors import SimulationError
from sims.process.physics import Physics, Places
from sims.process.pictures import Pictures
from sims.process.replay import Recording
from sims.projector.player import Light, Player, Programme
from sims.rig import SimulatedRig
from sims.world import World

WHITE = np.full((768, 1024), 255, np.uint8)
GREY = np.full((768, 1024), 100, np.uint8)
for _image in (WHITE, GREY):
    _image.setflags(write=False)


class Still:
    """A pattern that is an image."""

    def __init__(self, image: NDArray[np.uint8]) -> None:
        self._image = image

    def image(self) -> NDArray[np.uint8]:
        return self._image


class Bench:
    """A projector, a place of stages and the physics, on a clock that is moved by hand."""

    def __init__(self, world: World, *, replay: bool = False) -> None:
        self.clock = ManualClock(10.0)
        self.player = Player(self.clock, 1)
        self.places: Callable[[float], Places] = lambda _time_s: Places(0.0, 0.0)
        self.physics = Physics(world, self.clock, self.player, lambda at_s: self.places(at_s), replay=replay)

    def light(self, level: float, led: str = "infrared") -> None:
        self.player.light(Light(self.clock.now(), {led: level}))

    def show(self, image: NDArray[np.uint8] | None) -> None:
        self.player.show(Programme(self.clock.now(), () if image is None else (Still(image),)))

    def frame(self, exposure_us: float = 8000.0) -> NDArray[np.uint8]:
        develop = self.physics.expose(self.clock.now(), exposure_us, 8)
        self.clock.advance(exposure_us * 1e-6)
        return develop().astype(np.int32)


@pytest.fixture
def bench(ideal: World) -> Bench:
    bench = Bench(ideal)
    bench.physics.place("plate")
    bench.physics.set_glass(False)
    bench.clock.advance(1.0)
    return bench


def test_a_steady_picture_is_the_simulated_rigs_frame(ideal: World) -> None:
    bench, rig = Bench(ideal), SimulatedRig(ideal)
    bench.light(0.6)
    bench.show(GREY)
    bench.clock.advance(1.0)
    rig.show(GREY)
    rig.set_bits(8)
    assert np.array_equal(bench.frame(ideal.camera.exposure_us), rig.capture())


def test_two_pictures_in_one_exposure_mix_by_their_times(bench: Bench) -> None:
    bench.light(0.6)
    bench.show(WHITE)
    white = bench.frame()
    bench.show(None)
    black = bench.frame()
    bench.show(WHITE)
    develop = bench.physics.expose(bench.clock.now(), 8000.0, 8)
    bench.clock.advance(0.002)
    bench.show(None)
    bench.clock.advance(0.006)
    mixed = develop().astype(np.int32)
    assert np.abs(mixed - (0.25 * white + 0.75 * black)).max() < 1.0
    # Half of the exposure without light.
    bench.show(WHITE)
    develop = bench.physics.expose(bench.clock.now(), 8000.0, 8)
    bench.clock.advance(0.004)
    bench.light(0.0)
    bench.clock.advance(0.004)
    half = develop().astype(np.int32)
    bench.show(None)
    dark = bench.frame()
    assert np.abs((half - dark) - 0.5 * (white - dark)).max() < 1.5


def test_light_goes_with_the_led_and_its_level(bench: Bench) -> None:
    bench.show(WHITE)
    bench.light(0.6)
    full = bench.frame()
    bench.light(0.15)
    quarter = bench.frame()
    bench.light(0.0)
    dark = bench.frame()
    assert full.max() > dark.max() + 50
    assert np.abs((quarter - dark) - 0.25 * (full - dark)).max() <= 1.0


def test_the_filter_stays_with_the_led_that_was_lit_last(ideal: World) -> None:
    lights = ideal.lights.model_copy(
        update={"visible": ideal.lights.visible.model_copy(update={"ambient_radiance_uw_per_mm2_sr": 0.5})}
    )
    bench = Bench(ideal.model_copy(update={"lights": lights}))
    bench.physics.place("nothing")
    unlit = bench.frame().mean()
    bench.light(0.5, "green")
    bench.light(0.0, "green")
    after_green = bench.frame().mean()
    bench.light(0.5)
    bench.light(0.0)
    after_infrared = bench.frame().mean()
    assert unlit == after_infrared < after_green - 10


def test_frames_are_of_their_time_however_late_they_are_made(bench: Bench) -> None:
    bench.light(0.6)
    bench.show(WHITE)
    now = bench.frame()
    bench.places = lambda at_s: Places(0.0, 0.0 if at_s < end_s else 50.0)
    start_s = bench.clock.now()
    end_s = start_s + 0.008
    develop = bench.physics.expose(start_s, 8000.0, 8)
    bench.clock.advance(0.009)
    bench.physics.place("nothing")
    bench.show(None)
    bench.light(0.0)
    bench.clock.advance(5.0)
    assert np.array_equal(develop(), now)
    assert bench.frame().max() < now.max() / 2


def test_board_lamp_and_wrong_subjects(bench: Bench, ideal: World) -> None:
    bench.physics.place("board", 2)
    dark = bench.frame()
    bench.physics.set_lamp(True)
    assert bench.frame().max() > dark.max() + 50
    assert (bench.physics.subject.name, bench.physics.subject.pose, bench.physics.subject.glass) == ("board", 2, False)
    for subject, pose in (("bord", 0), ("board", ideal.board.poses), ("plate", 1)):
        with pytest.raises(SimulationError):
            bench.physics.place(subject, pose)
    assert bench.physics.subject.name == "board"


def test_the_seed_makes_the_noise(aligned: World) -> None:
    def frames(seed: int) -> NDArray[np.int32]:
        bench = Bench(aligned.model_copy(update={"seed": seed}))
        return np.stack([bench.frame(), bench.frame()])

    first, again, other = frames(1), frames(1), frames(2)
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], other[0])


def test_a_replayed_frame_is_the_one_of_the_rehearsal(aligned: World) -> None:
    bench = Bench(aligned, replay=True)
    bench.light(0.6)
    bench.show(WHITE)
    bench.places = lambda _at_s: Places(40.0004, 0.0)
    first = bench.frame()
    bench.places = lambda _at_s: Places(39.9987, 0.0004)
    assert np.array_equal(bench.frame(), first)
    for change in (
        lambda: setattr(bench, "places", lambda _at_s: Places(40.02, 0.0)),
        lambda: bench.show(GREY),
        lambda: bench.light(0.5),
        lambda: bench.physics.set_lamp(True),
        lambda: bench.physics.place("plate"),
    ):
        before = bench.frame()
        change()
        bench.clock.advance(0.1)
        assert not np.array_equal(bench.frame(), before)
    assert not np.array_equal(bench.frame(9000.0), bench.frame())


def test_a_recording_keeps_to_its_memory() -> None:
    recording = Recording(limit_bytes=300)
    made: list[int] = []

    def render(number: int) -> Callable[[], NDArray[np.uint8]]:
        return lambda: made.append(number) or np.full(100, number, np.uint8)  # type: ignore[func-returns-value]

    for number in (1, 2, 3, 1, 4):
        assert recording.frame(number, render(number))[0] == number
    assert made == [1, 2, 3, 4]
    assert len(recording) == 3
    # Asked for longest ago was 2, which went for 4.
    assert recording.frame(1, render(1))[0] == 1
    assert recording.frame(2, render(2))[0] == 2
    assert made == [1, 2, 3, 4, 2]


def test_pictures_are_told_apart_by_what_they_show(ideal: World) -> None:
    pictures = Pictures(ideal.projector)
    assert pictures.digest(WHITE) == pictures.digest(WHITE.copy()) != pictures.digest(GREY)
    assert pictures.light(WHITE) is pictures.light(WHITE.copy())
    changing = GREY.copy()
    before = pictures.digest(changing)
    changing[0, 0] += 1
    assert pictures.digest(changing) != before
