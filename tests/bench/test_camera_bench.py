"""The bench of the camera, small: every figure has its baseline from the same run, and lost frames are told."""

import importlib.util

import pytest

from drivers.protocols import CameraCounters, FramesLost
from irpmd_rig.bench import camera
from irpmd_rig.bench.ticker import lateness_ms

FORMATS = ("Mono8", "Mono10", "Mono10p")


def _names(told: str, held_up: str) -> list[str]:
    rates = [f"camera {name}, {told}" for name in FORMATS]
    plain = [name for rate in rates for name in (rate, f"{rate}: lost")]
    return [*plain, held_up, f"{held_up}: frames meanwhile", f"{held_up}: frames meanwhile: lost"]


def test_each_figure_has_its_baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    if importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters is not installed: pip install 'irpmd-rig[camera]'")
    monkeypatch.setattr(camera, "SEGMENTS", 1)
    rows = camera.run(size_px=128, seconds=0.2)
    quick = _names("as fast as they come", "other threads held up, frames as fast as they come")
    assert [row.name for row in rows] == quick + _names("paced", "other threads held up")
    by_name = {row.name: row for row in rows}
    for name in FORMATS:
        rate = by_name[f"camera {name}, as fast as they come"]
        assert rate.ratio == pytest.approx(rate.value / 90.3)
        assert rate.ratio > 1.0
        assert by_name[f"{rate.name}: lost"].value == 0
        # 128 lines are read out in 0.75 ms, and less than twice as fast is nobody's xiQ.
        assert by_name[f"camera {name}, paced"].value < 1400
    held_up = by_name["other threads held up"]
    assert (held_up.must, held_up.aim, held_up.sense) == (10.0, 2.0, "at most")
    assert held_up.ratio == pytest.approx(held_up.value - held_up.baseline_value)


class _Losing:
    """A camera that loses two frames at a time, every other time."""

    def __init__(self) -> None:
        self._calls = 0

    def fetch(self, _timeout_s: float) -> None:
        self._calls += 1
        if self._calls % 2:
            raise FramesLost("camera", "2 frames never arrived", "take the burst again")

    def counters(self) -> CameraCounters:
        return CameraCounters(self._calls // 2, 0, 2 * ((self._calls + 1) // 2))


def test_lost_frames_are_counted_not_hidden() -> None:
    losing = _Losing()
    with camera._counted(losing) as taken:
        for _ in range(10):
            camera._fetch(losing, taken)
    assert (taken.frames, taken.lost) == (5, 10)
    taken.seconds = 1.0
    rate, lost = taken.rows("camera")
    assert rate.value == 5.0
    assert (lost.value, lost.baseline_value, lost.ratio) == (10, 5, pytest.approx(2 / 3))


def test_every_tick_is_counted() -> None:
    late = lateness_ms(0.05)
    assert len(late) == 50
    assert min(late) >= 0.0
