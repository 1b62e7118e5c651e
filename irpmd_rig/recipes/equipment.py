"""What a recipe needs to know of a rig to be checked and estimated without touching it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Axis:
    """One stage.

    Attributes
    ----------
    lower_mm, upper_mm : float
        Soft limits in millimetres.
    speed_mm_per_s : float or None
        Speed of moves; None: not known.
    settle_s : float
        Its own settle time in seconds.
    reads_position : bool
        Whether its controller tells where it is; True also where that is not known.
    """

    lower_mm: float
    upper_mm: float
    speed_mm_per_s: float | None = None
    settle_s: float = 0.0
    reads_position: bool = True


@dataclass(frozen=True, slots=True)
class Equipment:
    """A rig as far as recipes care; None: not known, and not checked.

    Attributes
    ----------
    stages : mapping
        The axes by name, ``stage1`` and ``stage2``; one that is not there is not on the rig.
    camera_size_px, projector_size_px : tuple of int or None
        Width and height.
    exposure_range_us : tuple of float or None
        Shortest and longest exposure of the camera, in microseconds.
    longest_pattern_us : float or None
        Longest time for which the projector shows one pattern, in microseconds.
    pattern_limit : int or None
        How many patterns fit into the projector.
    frame_period_s : float
        Shortest time from frame to frame, in seconds.
    pixel_formats, triggers, leds : tuple of str or None
        What can be chosen.
    trigger : str
        What the rig uses where a recipe says nothing.
    subjects : tuple of str or None
        What an operator who is a program can place; None: a person places anything.
    board_poses : int or None
        In how many poses he can hold the board.
    display_delay_s : float or None
        How long the projector's driver itself waits after each picture, in seconds.
    """

    stages: Mapping[str, Axis] = field(default_factory=dict)
    camera_size_px: tuple[int, int] | None = None
    projector_size_px: tuple[int, int] | None = None
    exposure_range_us: tuple[float, float] | None = None
    longest_pattern_us: float | None = None
    pattern_limit: int | None = None
    frame_period_s: float = 0.0111
    pixel_formats: tuple[str, ...] | None = None
    triggers: tuple[str, ...] | None = None
    leds: tuple[str, ...] | None = None
    trigger: str = "hardware"
    subjects: tuple[str, ...] | None = None
    board_poses: int | None = None
    display_delay_s: float | None = None
