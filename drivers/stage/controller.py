"""One axis of a controller, spoken to in its dialect."""

from drivers.errors import Unsupported
from drivers.stage.axis import Axis, Drive
from drivers.stage.dialect import Command, Commands, Replies
from drivers.stage.frames import Status, Values, read_acknowledge, read_busy, read_status
from drivers.stage.port import Cancelled, Port, never


class Controller:
    """Turns actions of an axis into frames on its line, and answers into what they say."""

    def __init__(self, axis: Axis, port: Port) -> None:
        self.port = port
        self._axis = axis
        self._device = axis.device
        self._actions = axis.dialect.actions
        self._encoder = axis.encoder()

    @property
    def reads_position(self) -> bool:
        """Whether it tells where it is."""
        return self._actions.status is not None

    def move(self, counts: int, drive: Drive, cancelled: Cancelled) -> bool:
        """Send all commands of a move; False: cancelled before the one that starts it."""
        return self._perform(self._actions.move, counts, drive.code, cancelled)

    def set_speed(self, drive: Drive) -> None:
        """Send the speed, where that is not part of each move."""
        if self._actions.set_speed is not None:
            self._perform(self._actions.set_speed, 0, drive.code, never)

    def home(self, cancelled: Cancelled) -> bool:
        """Start homing; False: cancelled before it."""
        return self._perform(self._offered(self._actions.home, "home"), 0, 0, cancelled)

    def stop(self) -> None:
        """End the motion."""
        self._perform(self._offered(self._actions.stop, "stop"), 0, 0, never, urgent=True)

    def zero(self) -> None:
        """Set the controller's counts to zero, where it can."""
        if self._actions.zero is not None:
            self._perform(self._actions.zero, 0, 0, never)

    def status(self) -> Status:
        """Ask where the axis is and whether it moves."""
        command = self._actions.status
        if command is None:
            raise Unsupported(self._device, "the controller tells no position", "read a scale on the stage")
        answer = self._ask(command)
        return read_status(self._device, self._replies(), answer)

    def busy(self) -> bool:
        """Ask whether the axis moves."""
        command = self._actions.busy
        if command is None:
            return self.status().busy
        answer = self._ask(command)
        return read_busy(self._device, self._replies(), answer)

    def _ask(self, command: Command) -> bytes:
        frame = self._encoder.encode(command, Values(self._axis.settings.axis))
        return self.port.exchange(self._device, frame, self._replies(), pause_s=command.pause_s)

    def _perform(
        self, commands: Commands, counts: int, speed: int, cancelled: Cancelled, *, urgent: bool = False
    ) -> bool:
        values = Values(self._axis.settings.axis, counts, speed)
        # All frames are made before the first is sent: a value that does not fit leaves nothing half said.
        frames = [self._encoder.encode(command, values) for command in commands]
        with self.port.held(self._device, cancelled) as mine:
            if not mine:
                return False
            for command, frame in zip(commands, frames, strict=True):
                if not command.acknowledged:
                    if not self.port.send(
                        self._device, frame, pause_s=command.pause_s, cancelled=cancelled, urgent=urgent
                    ):
                        return False
                    continue
                if cancelled():
                    return False
                answer = self.port.exchange(
                    self._device, frame, self._replies(), pause_s=command.pause_s, urgent=urgent
                )
                read_acknowledge(self._device, self._replies(), answer, frame)
        return True

    def _replies(self) -> Replies:
        replies = self._axis.dialect.replies
        assert replies is not None, "a dialect whose commands have replies describes them"
        return replies

    def _offered(self, commands: Commands | None, action: str) -> Commands:
        if commands is None:
            raise Unsupported(
                self._device,
                f"a {self._axis.dialect.title} cannot {action} by software",
                "zero the axis by hand" if action == "home" else "use the emergency switch",
            )
        return commands
