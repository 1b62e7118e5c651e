from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.protocols import Frame
from irpmd_rig.acquisition.settling import NotSettled, differ, wait_until_still

RANDOM = np.random.default_rng(7)
COLUMNS = np.arange(160)


def frame(shift_px: float = 0.0, noise_dn: float = 1.0, brightness: float = 1.0) -> Frame:
    fringes = 120 + 80 * np.cos(2 * np.pi * (COLUMNS + shift_px) / 40)
    image = brightness * np.tile(fringes, (120, 1)) + RANDOM.normal(0, noise_dn, (120, 160))
    return Frame(np.clip(np.rint(image), 0, 255).astype(np.uint8), 8, 0, 0, None, 0.0, None)


@pytest.mark.parametrize("noise_dn", [0.0, 0.2, 1.0, 4.0])
def test_noise_is_no_motion(noise_dn: float) -> None:
    assert not any(differ(frame(noise_dn=noise_dn), frame(noise_dn=noise_dn)) for _ in range(20))


def test_a_common_change_of_brightness_is_no_motion() -> None:
    assert not differ(frame(), frame(brightness=0.97))


@pytest.mark.parametrize("shift_px", [0.1, -0.5, 3.0])
def test_a_shifted_picture_is_motion(shift_px: float) -> None:
    assert differ(frame(), frame(shift_px))


def shooting(frames: Iterator[Frame]) -> Callable[[], Frame]:
    return lambda: next(frames)


def test_it_waits_until_the_ringing_is_over() -> None:
    shifts = [4.0, -2.0, 1.0, -0.5, 0.0, 0.0, 0.0]
    assert wait_until_still(shooting(frame(shift) for shift in shifts)) == 6


def test_what_never_rests_ends_bounded() -> None:
    with pytest.raises(NotSettled, match=r"after 5 frames.*settle: time_s"):
        wait_until_still(shooting(frame(float(shift)) for shift in range(100)), tries=5)
