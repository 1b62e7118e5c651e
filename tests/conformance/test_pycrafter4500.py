"""The PyPI package pycrafter4500, unmodified, runs a pattern sequence on the simulated DLPC350.

It was written for the real box and knows nothing of this project. It asks the USB library for its default
backend, so that is replaced; nothing else is.
"""

import gc
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pycrafter4500
import pytest
import usb.backend.libusb1

from sims.clock import Clock
from sims.projector.dlpc350 import Dlpc350
from sims.projector.usb_backend import get_backend
from sims.projector.usb_bus import UsbBus

VIDEO = np.random.default_rng(4500).integers(0, 256, (1140, 912, 3), np.uint8)


@pytest.fixture
def box(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Dlpc350]:
    clock = Clock()
    box = Dlpc350(clock, video=lambda: VIDEO)
    bus = UsbBus(tmp_path / "usb")
    bus.add(box)
    bus.start()
    backend = get_backend(bus.socket_path)
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda **_: backend)
    yield box
    # The package never closes its device: that happens when the object goes.
    gc.collect()
    backend.finalize()
    bus.close()
    clock.close()


def test_a_whole_pattern_sequence_runs(box: Dlpc350) -> None:
    edges: list[float] = []
    box.on_sync(edges.append)
    pycrafter4500.pattern_mode(num_pats=3, fps=200, bit_depth=7, led_color=0b111)
    give_up_s = time.monotonic() + 30
    while len(edges) < 6 and time.monotonic() < give_up_s:
        time.sleep(0.005)
    assert box.player.running(edges[-1])
    # Three patterns of 5 ms in every vertical sync of 1/60 s.
    first = edges[0]
    expected = [first + frame / 60 + k * 0.005 for frame in range(2) for k in range(3)]
    assert edges[:6] == pytest.approx(expected, abs=1e-9)
    assert first * 60 == pytest.approx(round(first * 60), abs=1e-6)
    for number, channel in enumerate((1, 0, 2)):
        shown = box.player.shown_at(first + number * 0.005 + 0.001)
        assert shown.led == "red+green+blue"
        seven_bits = VIDEO[..., channel].astype(int) >> 1
        assert np.array_equal(shown.image, (seven_bits * 255 + 63) // 127)


@pytest.mark.parametrize("bit_depth", [1, 2, 4, 8])
def test_every_bit_depth_that_the_package_offers_runs(box: Dlpc350, bit_depth: int) -> None:
    period_us = 8333 if bit_depth == 8 else 5000
    pycrafter4500.pattern_mode(num_pats=3, period=period_us, bit_depth=bit_depth, led_color=0b001)
    with pycrafter4500.connect_usb() as lcr:
        lcr.get_main_status()
        assert lcr.ans[4] & 0b10
    # Three patterns of 8.333 ms do not fit into one vertical sync: they take two, and the rest is dark.
    expected = ["red"] * 3 + ["none"] if bit_depth == 8 else (["red"] * 3 + ["none"]) * 2
    times = box.player.intervals(box.player.programme.start_s, box.player.programme.start_s + 1 / 30)
    assert [shown.led for _, _, shown in times] == expected


def test_video_mode_and_power(box: Dlpc350) -> None:
    pycrafter4500.pattern_mode(period=5000)
    pycrafter4500.video_mode()
    assert not box.player.programme.rising
    assert np.array_equal(box.showing().image, VIDEO.mean(axis=2).round())
    pycrafter4500.power_down()
    assert box.showing().led == "none"
    pycrafter4500.power_up()
    assert box.showing().led != "none"


@pytest.mark.usefixtures("box")
def test_the_status_that_the_package_prints_is_the_box_s(capsys: pytest.CaptureFixture[str]) -> None:
    pycrafter4500.set_gamma(True)
    printed = capsys.readouterr().out
    assert "DMD micromirrors are not parked" in printed
    assert "Sequencer is stopped" in printed
    assert "Gamma correction is enabled" in printed


def test_a_sequence_that_breaks_the_exposure_rule_is_not_started(box: Dlpc350) -> None:
    with pycrafter4500.connect_usb() as lcr:
        lcr.pattern_display("stop")
        lcr.set_display_mode("pattern")
        lcr.set_pattern_config(num_lut_entries=1, num_pats_for_trig_out2=1)
        lcr.set_exposure_frame_period(4900, 5000)
        lcr.open_mailbox(2)
        lcr.mailbox_set_address(0)
        lcr.send_pattern_lut(trig_type=0, pat_num=0, bit_depth=1, led_select=1)
        lcr.open_mailbox(0)
        lcr.start_pattern_lut_validate()
        lcr.command("r", 0, 0x1A, 0x1A, [])
        assert lcr.ans[4] == 0x10
        lcr.pattern_display("start")
        assert lcr.ans[0] & 0x20
    assert not box.player.programme.rising
