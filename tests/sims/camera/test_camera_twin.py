"""The simulated camera without its wire: triggers, bursts, faults, pictures."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from threading import Event

import numpy as np
import pytest
from numpy.typing import NDArray

from sims.camera import CameraSettings, CameraTwin, SensorTiming
from sims.camera.acquisition import Frame
from sims.camera.wire import Refusal, Status
from sims.clock import Clock
from tests.small_world import until

SIZE_PX = (64, 48)
READOUT_S = SensorTiming().readout_s(SIZE_PX[1])
Image = NDArray[np.uint8] | NDArray[np.uint16]


def picture(bits: int) -> Image:
    image = np.arange(64 * 48).reshape(48, 64) % (1 << bits)
    return image.astype(np.uint8) if bits == 8 else image.astype(np.uint16)


@dataclass
class Bench:
    """A camera on a table: its nodes by name, the frames that came out of it."""

    settings: CameraSettings = field(default_factory=lambda: CameraSettings(size_px=SIZE_PX))
    render: Callable[[float, float, int], object] = lambda _start_s, _exposure_us, bits: picture(bits)
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        self.frames: list[tuple[Frame, NDArray[np.uint8]]] = []
        self.renders: list[tuple[float, float, int]] = []
        self.arrived = threading.Condition()

        def render(start_s: float, exposure_us: float, bits: int) -> object:
            self.renders.append((start_s, exposure_us, bits))
            return self.render(start_s, exposure_us, bits)

        self.camera = CameraTwin(render, self.clock, self.settings)
        self.camera.attach(self)
        self.addresses = {
            register.feature.name: (address, register)
            for address, register in self.camera.node_map.registers.items()
            if register.part == "value"
        }

    def send(self, frame: Frame, ended: Event, *, lossless: bool) -> bool:  # noqa: ARG002 - a Sink
        memory = np.zeros(frame.settings.payload_bytes, np.uint8)
        frame.pack(memory)
        with self.arrived:
            self.frames.append((frame, memory))
            self.arrived.notify_all()
        return True

    def wait_for(self, frames: int, seconds: float = 30.0) -> list[int]:
        with self.arrived:
            assert self.arrived.wait_for(lambda: len(self.frames) >= frames, seconds), self.camera.counters
            return [frame.frame_id for frame, _ in self.frames]

    def get(self, name: str) -> object:
        address, register = self.addresses[name]
        return register.decode(self.camera.read(address, register.size))

    def set(self, name: str, value: float | str) -> None:
        address, register = self.addresses[name]
        number = dict(register.feature.entries)[value] if isinstance(value, str) else value
        self.camera.write(address, register.encode(float(number) if register.feature.kind == "float" else number))

    def do(self, *names: str) -> None:
        for name in names:
            self.set(name, 1)

    def trigger_by(self, source: str, selector: str = "FrameStart") -> None:
        self.set("TriggerSelector", selector)
        self.set("TriggerMode", "On")
        self.set("TriggerSource", source)


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def build(**options: object) -> Bench:
        made.append(Bench(**options))  # type: ignore[arg-type]
        return made[-1]

    yield build
    for bench in made:
        bench.camera.close()


@pytest.fixture
def bench(make: Callable[..., Bench]) -> Bench:
    return make()


def test_free_running_frames_keep_the_sensors_period(bench: Bench) -> None:
    bench.set("ExposureTime", 100)
    bench.do("AcquisitionStart")
    assert bench.wait_for(5)[:5] == [0, 1, 2, 3, 4]
    starts = [frame.start_s for frame, _ in bench.frames[:5]]
    periods = np.diff(starts)
    # A late thread may make the simulation skip ahead, never make it faster.
    assert periods.min() >= READOUT_S - 1e-9


@pytest.mark.parametrize(("mode", "frames"), [("SingleFrame", 1), ("MultiFrame", 3)])
def test_an_acquisition_ends_by_itself(bench: Bench, mode: str, frames: int) -> None:
    bench.set("AcquisitionMode", mode)
    bench.set("AcquisitionFrameCount", 3)
    bench.do("AcquisitionStart")
    assert bench.wait_for(frames) == list(range(frames))
    until(lambda: not bench.camera.acquiring)
    time.sleep(0.02)
    assert len(bench.frames) == frames


def test_a_software_trigger_takes_one_frame(bench: Bench) -> None:
    bench.trigger_by("Software")
    bench.do("AcquisitionStart")
    time.sleep(0.02)
    assert bench.frames == []
    bench.do("TriggerSoftware")
    assert bench.wait_for(1) == [0]


def test_a_hardware_trigger_tells_the_world_its_moment(bench: Bench) -> None:
    bench.trigger_by("Line1")
    bench.set("ExposureTime", 2000)
    bench.do("AcquisitionStart")
    edge_s = bench.clock.now() + 0.02
    bench.camera.trigger(edge_s)
    bench.wait_for(1)
    assert bench.renders == [(pytest.approx(edge_s + 10e-6, abs=1e-9), 2000, 8)]
    assert bench.clock.now() >= edge_s + 2e-3 + READOUT_S


def test_edges_too_close_to_each_other_are_missed_and_counted(bench: Bench) -> None:
    bench.trigger_by("Line1")
    bench.set("ExposureTime", 2000)
    bench.do("AcquisitionStart")
    now_s = bench.clock.now()
    for offset_s in (0.0, 1e-3, 2.0e-3, 2.1e-3, 10e-3):
        bench.camera.trigger(now_s + offset_s)
    assert bench.wait_for(3) == [0, 1, 2]
    assert bench.camera.counters.missed_triggers == 2
    bench.set("CounterSelector", "MissedTriggers")
    assert bench.get("CounterValue") == 2


def test_only_the_chosen_edge_of_the_chosen_source_counts(bench: Bench) -> None:
    bench.trigger_by("Line1")
    bench.set("TriggerActivation", "FallingEdge")
    bench.do("AcquisitionStart", "TriggerSoftware")
    bench.camera.trigger(bench.clock.now())
    bench.camera.trigger(bench.clock.now() + 0.01, rising=False)
    assert bench.wait_for(1) == [0]
    time.sleep(0.02)
    assert len(bench.frames) == 1
    assert bench.camera.counters.missed_triggers == 0


def test_a_burst_is_several_frames_for_one_trigger(bench: Bench) -> None:
    bench.trigger_by("Line1", "FrameBurstStart")
    bench.set("AcquisitionBurstFrameCount", 4)
    bench.do("AcquisitionStart")
    now_s = bench.clock.now()
    bench.camera.trigger(now_s)
    bench.camera.trigger(now_s + 2 * READOUT_S)  # while the burst runs: missed
    assert bench.wait_for(4) == [0, 1, 2, 3]
    assert bench.camera.counters.missed_triggers == 1


def test_triggers_do_not_outlive_their_acquisition(bench: Bench) -> None:
    bench.trigger_by("Line1")
    bench.do("AcquisitionStart")
    edge_s = bench.clock.now() + 0.5
    bench.camera.trigger(edge_s)
    bench.do("AcquisitionStop", "AcquisitionStart")
    assert bench.clock.now() < edge_s, "the machine was held up for too long to tell"
    time.sleep(0.6)
    assert bench.frames == []


def test_opening_switches_the_trigger_off_and_forgets_settings(bench: Bench) -> None:
    bench.trigger_by("Line1")
    bench.set("Gain", 3)
    bench.camera.release()
    bench.camera.open()
    assert (bench.get("TriggerMode"), bench.get("Gain")) == (0, 0)


def test_there_is_one_trigger(bench: Bench) -> None:
    bench.trigger_by("Line1")
    bench.set("TriggerSelector", "FrameBurstStart")
    with pytest.raises(Refusal, match="there is one trigger"):
        bench.set("TriggerMode", "On")


def test_a_slow_picture_can_be_made_after_its_exposure(make: Callable[..., Bench]) -> None:
    made_in: list[str] = []

    def later(_start_s: float, _exposure_us: float, bits: int) -> Callable[[], Image]:
        exposed_in = threading.current_thread().name

        def develop() -> Image:
            made_in.append(f"{exposed_in}, {threading.current_thread().name}")
            time.sleep(0.03)
            return picture(bits)

        return develop

    bench = make(render=later)
    bench.trigger_by("Line1")
    bench.do("AcquisitionStart")
    now_s = bench.clock.now()
    for number in range(4):
        bench.camera.trigger(now_s + number * 5e-3)
    assert bench.wait_for(4) == [0, 1, 2, 3]
    # All four exposures had their moment although each picture takes six triggers' time.
    assert bench.camera.counters.missed_triggers == 0
    assert made_in == ["camera exposures, camera readouts"] * 4


def test_the_region_is_cut_out(bench: Bench) -> None:
    for name, value in (("Width", 16), ("Height", 16), ("OffsetX", 8), ("OffsetY", 30)):
        bench.set(name, value)
    bench.do("AcquisitionStart")
    bench.wait_for(1)
    assert (bench.frames[0][1].reshape(16, 16) == picture(8)[30:46, 8:24]).all()


def test_ten_bits_ask_the_world_for_ten_bits(bench: Bench) -> None:
    bench.set("PixelFormat", "Mono10")
    bench.do("AcquisitionStart")
    bench.wait_for(1)
    assert bench.renders[0][2] == 10
    assert (bench.frames[0][1].view(np.uint16).reshape(48, 64) == picture(10)).all()


def test_gain_is_applied(bench: Bench) -> None:
    bench.set("Gain", 6)
    bench.do("AcquisitionStart")
    bench.wait_for(1)
    expected = np.rint(np.minimum(picture(8) / 255 * 10**0.3, 1) * 255)
    assert (bench.frames[0][1].reshape(48, 64) == expected).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Width", 66),
        ("Width", 18),
        ("OffsetX", 4),
        ("ExposureTime", 9.0),
        ("ExposureTime", float("nan")),
        ("Gain", 99),
        ("PixelFormat", 3),
        ("AcquisitionFrameRate", 1e9),
        ("AcquisitionFrameRateEnable", 2),
        ("LineMode", 1),
    ],
)
def test_what_is_out_of_range_is_refused(bench: Bench, name: str, value: float) -> None:
    with pytest.raises(Refusal) as refusal:
        bench.set(name, value)
    assert refusal.value.status is Status.INVALID_VALUE


def test_a_readable_feature_cannot_be_written_nor_the_region_while_acquiring(bench: Bench) -> None:
    with pytest.raises(Refusal):
        bench.set("PayloadSize", 1)
    bench.do("AcquisitionStart")
    with pytest.raises(Refusal) as refusal:
        bench.set("Width", 32)
    assert refusal.value.status is Status.ACCESS_DENIED
    bench.set("ExposureTime", 500)
    bench.do("AcquisitionStop")
    bench.set("Width", 32)


def test_dropped_frames_leave_gaps_in_the_frame_ids(bench: Bench) -> None:
    bench.camera.faults.drop_next(2)
    bench.do("AcquisitionStart")
    assert bench.wait_for(2)[:2] == [2, 3]
    assert bench.camera.counters.skipped == 2


def test_an_incomplete_frame_says_how_much_came(bench: Bench) -> None:
    bench.camera.faults.incomplete_next(1, share=0.25)
    bench.do("AcquisitionStart")
    bench.wait_for(2)
    assert [frame.share for frame, _ in bench.frames[:2]] == [0.25, 1.0]


def test_a_late_frame_comes_late(bench: Bench) -> None:
    bench.camera.faults.late_next(1, seconds=0.15)
    bench.trigger_by("Line1")
    bench.do("AcquisitionStart")
    now_s = bench.clock.now()
    bench.camera.trigger(now_s)
    bench.wait_for(1)
    assert bench.clock.now() >= now_s + 0.15


def test_a_missed_trigger_is_counted(bench: Bench) -> None:
    bench.camera.faults.miss_triggers(1)
    bench.trigger_by("Software")
    bench.do("AcquisitionStart", "TriggerSoftware", "TriggerSoftware")
    assert bench.wait_for(1) == [0]
    assert bench.camera.counters.missed_triggers == 1


@pytest.mark.parametrize("source", [None, "Software"])
def test_a_hanging_acquisition_delivers_nothing_until_it_recovers(bench: Bench, source: str | None) -> None:
    if source:
        bench.trigger_by(source)
    bench.camera.faults.hang()
    bench.do("AcquisitionStart", "TriggerSoftware")
    time.sleep(0.05)
    assert bench.frames == []
    assert bench.get("Width") == 64
    bench.camera.faults.recover()
    bench.do("TriggerSoftware")
    bench.wait_for(1)


def test_a_node_fails_as_often_as_told(bench: Bench) -> None:
    bench.camera.faults.fail_reads("Width", 2)
    for _ in range(2):
        with pytest.raises(Refusal, match="read of Width fails"):
            bench.get("Width")
    assert bench.get("Width") == 64
    bench.camera.faults.fail_writes("Gain")
    with pytest.raises(Refusal, match="write of Gain fails"):
        bench.set("Gain", 1)
    assert bench.get("Gain") == 0


def test_overheating_is_shown(bench: Bench) -> None:
    usual = bench.get("DeviceTemperature")
    bench.camera.faults.overheat(91.5)
    assert bench.get("DeviceTemperature") == 91.5
    bench.camera.faults.cool()
    assert bench.get("DeviceTemperature") == usual


def test_unplugging_ends_the_acquisition_and_loses_the_settings(bench: Bench) -> None:
    bench.set("Gain", 3)
    bench.do("AcquisitionStart")
    bench.wait_for(1)
    bench.camera.faults.unplug()
    assert not bench.camera.plugged
    assert not bench.camera.acquiring
    bench.camera.faults.replug()
    assert bench.get("Gain") == 0


def test_a_plug_that_is_in_cannot_be_put_in(bench: Bench) -> None:
    bench.set("Gain", 3)
    bench.camera.faults.replug()
    assert bench.get("Gain") == 3


@pytest.mark.parametrize("wrong", [np.zeros((4, 4), np.uint8), np.zeros((48, 64), np.uint16), None])
def test_a_world_that_fails_loses_frames_not_the_camera(
    make: Callable[..., Bench], wrong: object, caplog: pytest.LogCaptureFixture
) -> None:
    pictures = iter([wrong, picture(8)])

    def render(_start_s: float, _exposure_us: float, _bits: int) -> object:
        result = next(pictures, picture(8))
        if result is None:
            raise RuntimeError("the world has ended")
        return result

    bench = make(render=render)
    bench.do("AcquisitionStart")
    assert bench.wait_for(1)[0] == 1
    assert "frame lost" in caplog.text


def test_time_stamps_count_from_power_up(bench: Bench) -> None:
    before_s = bench.clock.now()
    bench.do("TimestampReset", "TimestampLatch")
    latched = bench.get("TimestampLatchValue")
    assert isinstance(latched, int)
    assert 0 <= latched <= (bench.clock.now() - before_s) * 1e9


def test_without_pace_frames_come_as_fast_as_they_are_taken(make: Callable[..., Bench]) -> None:
    bench = make(settings=CameraSettings(size_px=SIZE_PX, paced=False))
    bench.set("ExposureTime", 1_000_000)
    bench.do("AcquisitionStart")
    bench.wait_for(60)
    # Of a second each.
    assert bench.clock.now() < 30


def test_a_faster_clock_makes_a_faster_camera(make: Callable[..., Bench]) -> None:
    bench = make(clock=Clock(time_scale=100))
    bench.set("AcquisitionFrameRateEnable", 1)
    bench.set("AcquisitionFrameRate", 1)
    begin = time.monotonic()
    bench.do("AcquisitionStart")
    bench.wait_for(61)
    # A minute of its clock.
    assert time.monotonic() - begin < 30
    assert np.diff([frame.start_s for frame, _ in bench.frames]).min() >= 1 - 1e-9
