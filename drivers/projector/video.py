"""The driver of any projector with a video input: a full-screen window on the display that it is."""

from typing import ClassVar

from drivers.errors import Unsupported
from drivers.projector.base import PatternProjector
from drivers.projector.screen import Screen, ScreenSettings
from drivers.projector.source import PatternSource
from drivers.values import Led, ProjectorCapabilities, ProjectorCondition, ProjectorStatus, SyncOutput


class VideoProjector(PatternProjector):
    """A projector, monitor or rig that shows a display (a `drivers.protocols.Projector`); its light is set by hand.

    Parameters
    ----------
    name
        Name in the rig file.
    settings
        The display.
    """

    Settings: ClassVar = ScreenSettings

    def __init__(self, name: str, settings: ScreenSettings) -> None:
        super().__init__(name)
        self._screen = Screen(name, settings, self._talking, self._gate.pause)

    def capabilities(self) -> ProjectorCapabilities:
        """Tell what the projector can do."""
        return ProjectorCapabilities(
            model="display",
            size_px=self._screen.size_px,
            leds=(),
            pattern_limit=None,
            can_load=True,
            self_paced=False,
            has_sync=False,
            can_park=False,
            unverified=("display_delay_s, from the window to the light, is a setting: measure it with the camera",),
        )

    @property
    def _source(self) -> PatternSource:
        return self._screen

    @property
    def _reached(self) -> bool:
        return self._screen.is_open

    def _reach(self) -> None:
        self._screen.open()

    def _release(self) -> None:
        self._screen.close()

    def _light_off(self) -> None:
        self._screen.dark()

    def _set_light(self, led: Led, intensity: float) -> None:  # noqa: ARG002 - refused, as below
        raise Unsupported(self._name, f"a video signal does not switch the LED {led}", "set the light at the projector")

    def _set_sync(self, sync: SyncOutput) -> None:  # noqa: ARG002
        raise Unsupported(self._name, "a video signal has no sync output", "trigger the camera by software")

    def _set_parked(self, *, parked: bool) -> None:  # noqa: ARG002
        raise Unsupported(self._name, "a video signal does not park mirrors", "park them at the projector")

    def _check_health(self) -> None:
        return

    def _read_status(self) -> ProjectorStatus:
        condition = self._condition
        if condition is ProjectorCondition.RUNNING and not self._screen.running():
            condition = ProjectorCondition.DARK
        shown = self._shown if condition is ProjectorCondition.SHOWING else None
        return ProjectorStatus(condition, shown, None, None, None)
