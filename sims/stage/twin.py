"""A simulated stage: axes, the controller that drives them, and the line that it hangs on."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from sims.clock import WorldClock
from sims.stage.line import Firmware, LineFaults
from sims.stage.motion import Axis, AxisSettings
from sims.stage.port import SerialPort, SocketPort

MakeFirmware = Callable[[Mapping[int, Axis], WorldClock], Firmware]


class StageFaults:
    """What can be made to go wrong, from any thread while the stage runs.

    The faults of a move are spent by the next move of that axis. `line` holds the faults of the replies.
    """

    def __init__(self, axes: Mapping[int, Axis], port: SerialPort | SocketPort, line: LineFaults) -> None:
        self._axes = axes
        self._port = port
        self.line = line

    def stall_next_move(self, axis: int = 1, *, fraction: float = 0.5) -> None:
        """Let the next move get stuck on its way: it never ends until it is stopped."""
        self._axes[axis].faults.stall_fraction = fraction

    def overshoot_next_move(self, axis: int = 1, *, by_mm: float) -> None:
        """Let the next move end that far beyond its target; the controller knows it."""
        self._axes[axis].faults.overshoot_mm = by_mm

    def limit_next_move(self, axis: int = 1, *, fraction: float = 0.5) -> None:
        """Let the next move meet a limit switch on its way."""
        self._axes[axis].faults.limit_fraction = fraction

    def lose_steps(self, axis: int = 1, *, counts: float) -> None:
        """Let the next move fall short by so many counts; the controller does not know it."""
        self._axes[axis].faults.lost_counts = counts

    def unplug(self) -> None:
        """Tear the line out."""
        self._port.unplug()

    def replug(self) -> None:
        """Plug the line in again: the controller was powered all the time, its axes are where they were."""
        self._port.plug()


class StageTwin:
    """Axes, firmware and line of one stage controller.

    Parameters
    ----------
    axes
        Settings of the axes by their address on the line.
    firmware
        Makes the controller: `Gcd0301m`, `Gcd040101m`, `Gsc`, or a function that calls one with more
        settings.
    clock
        The clock of the world.
    link
        Path of the symbolic link that stands for the serial port; or None, to serve a TCP socket instead.
    tcp_port
        The TCP port; 0 takes a free one.
    wrong_line
        What a wrong baud rate yields on the serial port: nothing, or a few garbage bytes.
    seed
        Seed of the noise of all moves.

    Examples
    --------
    >>> stage = StageTwin({1: AxisSettings()}, Gsc, Clock(), link=Path("/tmp/world/stage1"))  # doctest: +SKIP
    >>> stage.start(); stage.position_mm(1)                                                   # doctest: +SKIP
    """

    def __init__(
        self,
        axes: Mapping[int, AxisSettings],
        firmware: MakeFirmware,
        clock: WorldClock,
        *,
        link: Path | None,
        tcp_port: int = 0,
        wrong_line: Literal["silent", "garbage"] = "silent",
        seed: int | None = None,
    ) -> None:
        self._axes = {
            address: Axis(settings, clock, None if seed is None else (seed, address))
            for address, settings in axes.items()
        }
        self.firmware = firmware(self._axes, clock)
        line = LineFaults()
        self._port: SerialPort | SocketPort
        if link is None:
            self._port = SocketPort(self.firmware, clock, line, tcp_port)
        else:
            self._port = SerialPort(self.firmware, link, clock, line, wrong_line=wrong_line)
        self.faults = StageFaults(self._axes, self._port, line)

    @property
    def plugged(self) -> bool:
        """Whether the line is there."""
        return self._port.plugged

    @property
    def url(self) -> str:
        """What pyserial's `serial_for_url` opens to reach this controller."""
        return self._port.url if isinstance(self._port, SocketPort) else str(self._port.link)

    def position_mm(self, axis: int = 1) -> float:
        """Return where the carriage of an axis truly is now, with backlash, noise and ringing."""
        return self._axes[axis].true_mm

    def position_mm_at(self, time_s: float, axis: int = 1) -> float:
        """Return where the carriage of an axis truly was at a time that is not long over."""
        return self._axes[axis].true_mm_at(time_s)

    def moving(self, axis: int = 1) -> bool:
        """Whether the controller drives the motor of an axis."""
        return self._axes[axis].busy

    def start(self) -> None:
        """Make the line appear."""
        self._port.plug()

    def close(self) -> None:
        """Remove the line and end its threads."""
        self._port.close()
