"""What the driver does with a camera's nodes, found by probing through the one table."""

import math
import time
from dataclasses import replace

from drivers.camera import ximea_nodes as table
from drivers.camera.backend import NodeFailed, NodeRefused, Nodes
from drivers.camera.options import CameraOptions
from drivers.camera.pixels import BY_NAME
from drivers.camera.ximea_nodes import Choice, Value
from drivers.errors import DeviceFault, GarbledReply, Refused, TimedOut, Unsupported
from drivers.values import CameraCapabilities, CameraSettings, Region, Trigger

READY_LIMIT_S = 2.0
_READY_POLL_S = 0.001


class CameraControl:
    """Settings, triggers and capabilities of one opened camera.

    Parameters
    ----------
    device
        Name of the camera in the rig file.
    nodes
        Its node map.
    options
        The driver's settings.
    identity
        Vendor, model and serial number, where no node tells.
    """

    def __init__(self, device: str, nodes: Nodes, options: CameraOptions, identity: tuple[str, str, str]) -> None:
        self._device = device
        self._nodes = nodes
        self._options = options
        self._identity = identity

    # ---- what it is ----

    def capabilities(self) -> CameraCapabilities:
        """Tell what the camera can do."""
        vendor, model, serial_number = (
            str(self._value(choices) or listed)
            for choices, listed in zip((table.VENDOR, table.MODEL, table.SERIAL_NUMBER), self._identity, strict=True)
        )
        return CameraCapabilities(
            vendor=vendor,
            model=model,
            serial_number=serial_number,
            sensor_size_px=self._sensor_size(),
            pixel_formats=self._formats(),
            triggers=self._triggers(),
            exposure_range_us=self._range(table.EXPOSURE_US),
            gain_range_db=self._range(table.GAIN_DB),
            frame_rate_range_hz=self._range(table.FRAME_RATE_HZ),
            has_region=self._has_region(),
            has_temperature=self._find(table.TEMPERATURE_C) is not None,
            unverified=self._unverified(),
        )

    def temperature_c(self) -> float:
        """Read the temperature."""
        choice = self._need(table.TEMPERATURE_C, "a temperature")
        return self._as_number(choice, self._nodes.read(choice.name, fresh=True))

    def check_temperature(self, limit_c: float | None) -> None:
        """Raise DeviceFault where the camera tells a temperature above `limit_c`; None: do not look."""
        if limit_c is None or self._find(table.TEMPERATURE_C) is None:
            return
        temperature_c = self.temperature_c()
        if temperature_c > limit_c:
            raise DeviceFault(
                self._device,
                f"the camera is too hot: {temperature_c:.1f} C, more than {limit_c:g} C",
                "let it cool, and look at its mounting and the air around it; or raise hottest_c",
            )

    def alive(self) -> bool:
        """Whether the camera answers."""
        try:
            choice = self._find(table.ALIVE)
            if choice is not None:
                self._nodes.read(choice.name, fresh=True)
        except (NodeFailed, NodeRefused):
            return False
        return True

    # ---- what it is set to ----

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; returns what is in force."""
        self._no_trigger()
        for choice in table.AUTOMATICS_OFF:
            self._switch((choice,))
        self._switch(table.GAMMA)
        if settings.pixel_format is not None:
            self._set_format(settings.pixel_format)
        self._set_region(settings.region)
        # A long exposure would bound the frame rate of an earlier setting, and the other way round.
        self._switch(table.FRAME_RATE_OFF)
        self._set_number(table.EXPOSURE_US, settings.exposure_us, "an exposure time", "us")
        self._set_number(table.GAIN_DB, settings.gain_db, "a gain", "dB")
        self._set_rate(settings)
        self._set_trigger(settings.trigger)
        return self._in_force(settings)

    def exposure_us(self) -> float | None:
        """Tell the exposure time that is in force."""
        return self._number(table.EXPOSURE_US)

    def frame_format(self) -> tuple[str, int, int]:
        """Tell pixel format, width and height of the frames to come."""
        name = self._value(table.PIXEL_FORMAT)
        width, height = self._number(table.WIDTH), self._number(table.HEIGHT)
        if name is None or width is None or height is None:
            raise Unsupported(
                self._device, "the camera does not tell the size or format of its frames", "dump its nodes"
            )
        if str(name) not in BY_NAME:
            raise Unsupported(
                self._device,
                f"its pixel format {name} is not known to the driver",
                f"configure one of: {', '.join(self._formats()) or 'none'}",
            )
        return str(name), int(width), int(height)

    # ---- triggers ----

    def trigger(self) -> None:
        """Start an exposure."""
        self._nodes.execute(self._need(table.TRIGGER_SOFTWARE, "a software trigger").name)

    def wait_until_ready(self) -> None:
        """Wait until the camera would answer a trigger, where it tells."""
        status = self._find(table.READY)
        if status is None or not self._switch(table.READY_SELECTOR):
            return
        deadline_s = time.monotonic() + READY_LIMIT_S
        while not self._nodes.read(status.name, fresh=True):
            if time.monotonic() > deadline_s:
                raise TimedOut(
                    self._device,
                    f"the camera was not ready for a trigger within {READY_LIMIT_S:g} s",
                    "arm again; if that does not help, replug the camera",
                )
            time.sleep(_READY_POLL_S)

    def _no_trigger(self) -> None:
        selector, mode = self._find(table.TRIGGER_SELECTOR), self._find(table.TRIGGER_MODE)
        if mode is None:
            return
        for kind in self._nodes.entries(selector.name) if selector else ("",):
            if selector:
                self._nodes.write(selector.name, kind)
            if self._nodes.has(mode.name) and self._nodes.writable(mode.name):
                self._nodes.write(mode.name, "Off")

    def _set_trigger(self, trigger: Trigger) -> None:
        if trigger == "free":
            return
        if trigger not in self._triggers():
            raise Unsupported(
                self._device,
                f"the camera has no {trigger} trigger",
                f"it offers: {', '.join(self._triggers())}" + self._line_remedy(trigger),
            )
        selector = self._find(table.TRIGGER_SELECTOR)
        if selector is not None:
            self._nodes.write(selector.name, table.TRIGGER_KIND)
        source = self._source(trigger)
        if trigger == "hardware":
            self._make_input(source)
            edge = self._find(table.TRIGGER_EDGE)
            if edge is not None:
                self._nodes.write(edge.name, f"{self._options.trigger_edge.capitalize()}Edge")
        self._nodes.write(self._need(table.TRIGGER_SOURCE, "a trigger source").name, source)
        self._nodes.write(self._need(table.TRIGGER_MODE, "a trigger").name, "On")

    def _line_remedy(self, trigger: Trigger) -> str:
        source = self._find(table.TRIGGER_SOURCE)
        if trigger != "hardware" or source is None:
            return ""
        return f"; its trigger sources are {', '.join(self._nodes.entries(source.name))}: set trigger_line to one"

    def _make_input(self, line: str) -> None:
        selector, mode = table.LINE_INPUT
        if self._nodes.has(selector.name) and line in self._nodes.entries(selector.name):
            self._nodes.write(selector.name, line)
            self._switch((mode,))

    def _triggers(self) -> tuple[Trigger, ...]:
        kinds: list[Trigger] = ["free"]
        if self._find(table.TRIGGER_MODE) and self._find(table.TRIGGER_SOURCE):
            if self._find(table.TRIGGER_SOFTWARE) and self._source("software"):
                kinds.append("software")
            if self._source("hardware"):
                kinds.append("hardware")
        return tuple(kinds)

    def _source(self, trigger: Trigger) -> str:
        line = self._options.trigger_line
        wanted = table.SOFTWARE_SOURCES if trigger == "software" else (line,) if line else table.LINE_SOURCES
        entries = self._nodes.entries(self._need(table.TRIGGER_SOURCE, "a trigger source").name)
        return next((name for name in wanted if name in entries), "")

    # ---- single settings ----

    def _set_format(self, name: str) -> None:
        choice = self._need(table.PIXEL_FORMAT, "a choice of pixel formats")
        formats = self._formats()
        if name not in formats:
            raise Unsupported(
                self._device, f"the camera and the driver share no pixel format {name!r}",
                f"choose one of: {', '.join(formats)}",
            )  # fmt: skip
        if self._value((choice,)) != name:
            self._nodes.write(choice.name, name)

    def _set_region(self, region: Region | None) -> None:
        if not self._has_region():
            if region is not None:
                raise Unsupported(self._device, "the camera reads no region of its sensor", "leave `region` out")
            return
        whole = region or Region(0, 0, *self._sensor_size())
        for choices in (table.COLUMN, table.ROW):
            self._nodes.write(choices[0].name, 0)
        for choices, pixels, what in (
            (table.WIDTH, whole.width_px, "a width"),
            (table.HEIGHT, whole.height_px, "a height"),
            (table.COLUMN, whole.column_px, "a first column"),
            (table.ROW, whole.row_px, "a first row"),
        ):
            self._set_number(choices, pixels, what, "px")
        name, width, _ = self.frame_format()
        if width % BY_NAME[name].group_px:
            raise Refused(
                self._device,
                f"a width of {width} px is refused with {name}",
                f"give a multiple of {BY_NAME[name].group_px}",
            )

    def _set_rate(self, settings: CameraSettings) -> None:
        if settings.frame_rate_hz is None:
            if not self._find(table.FRAME_RATE_OFF) and (limits := self._range(table.FRAME_RATE_HZ)):
                rate = self._find(table.FRAME_RATE_HZ)
                if rate is not None and self._nodes.writable(rate.name):
                    self._set_number(table.FRAME_RATE_HZ, limits[1], "a frame rate", "Hz")
            return
        self._need(table.FRAME_RATE_HZ, "a frame rate")
        self._switch(table.FRAME_RATE_ON)
        self._set_number(table.FRAME_RATE_HZ, settings.frame_rate_hz, "a frame rate", "Hz")

    def _set_number(self, choices: tuple[Choice, ...], value: float | None, what: str, unit: str) -> None:
        if value is None:
            return
        choice = self._need(choices, what)
        is_integer = self._nodes.kind(choice.name) == "integer"
        wanted = value * choice.unit
        try:
            if not math.isfinite(wanted):
                raise NodeRefused("no number")
            self._nodes.write(choice.name, round(wanted) if is_integer else float(wanted))
        except NodeRefused as refusal:
            raise Refused(
                self._device, f"{what} of {value:g} {unit} is refused: {refusal}", self._accepted(choice, unit)
            ) from None

    def _accepted(self, choice: Choice, unit: str) -> str:
        try:
            low, high, step = self._nodes.limits(choice.name)
        except (NodeFailed, NodeRefused):
            return "stop the acquisition, and see the node's description"
        steps = f" in steps of {step / choice.unit:g}" if step else ""
        return f"give {low / choice.unit:g} to {high / choice.unit:g} {unit}{steps}"

    def _switch(self, choices: tuple[Choice, ...]) -> bool:
        """Set the first of the switches that exists; False: there is none, or it cannot be set."""
        choice = self._find(choices)
        if choice is None or choice.value is None:
            return False
        kind = self._nodes.kind(choice.name)
        if kind == "enumeration" and choice.value not in self._nodes.entries(choice.name):
            return False
        if self._nodes.read(choice.name) == choice.value:
            return True
        if not self._nodes.writable(choice.name):
            return False
        self._nodes.write(choice.name, choice.value)
        return True

    # ---- reading ----

    def _in_force(self, settings: CameraSettings) -> CameraSettings:
        name, width, height = self.frame_format()
        rate = self._number(table.FRAME_RATE_HZ)
        # Switched off, the node's number means nothing.
        is_free = settings.frame_rate_hz is None and self._find(table.FRAME_RATE_OFF) is not None
        column, row = (int(self._number(choices) or 0) for choices in (table.COLUMN, table.ROW))
        return replace(
            settings,
            exposure_us=self.exposure_us(),
            gain_db=self._number(table.GAIN_DB),
            pixel_format=name,
            region=Region(column, row, width, height) if self._has_region() else None,
            frame_rate_hz=rate if settings.trigger == "free" and not is_free else None,
        )

    def _sensor_size(self) -> tuple[int, int]:
        sizes = []
        for sensor, used in ((table.SENSOR_WIDTH, table.WIDTH), (table.SENSOR_HEIGHT, table.HEIGHT)):
            value = self._number(sensor) or self._number(used)
            if value is None:
                raise Unsupported(self._device, "the camera does not tell its size", "dump its nodes")
            sizes.append(int(value))
        return sizes[0], sizes[1]

    def _has_region(self) -> bool:
        return all(self._find(choices) for choices in (table.COLUMN, table.ROW, table.WIDTH, table.HEIGHT))

    def _formats(self) -> tuple[str, ...]:
        choice = self._find(table.PIXEL_FORMAT)
        if choice is None:
            return ()
        return tuple(name for name in self._nodes.entries(choice.name) if name in BY_NAME)

    def _range(self, choices: tuple[Choice, ...]) -> tuple[float, float] | None:
        choice = self._find(choices)
        if choice is None:
            return None
        low, high, _ = self._nodes.limits(choice.name)
        return low / choice.unit, high / choice.unit

    def _number(self, choices: tuple[Choice, ...]) -> float | None:
        choice = self._find(choices)
        return None if choice is None else self._as_number(choice, self._nodes.read(choice.name)) / choice.unit

    def _as_number(self, choice: Choice, value: Value) -> float:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            what = f"its node {choice.name} holds {str(value)[:40]!r} in the place of a number"
            raise GarbledReply(self._device, what, "dump its nodes")
        return number

    def _value(self, choices: tuple[Choice, ...]) -> Value | None:
        choice = self._find(choices)
        return None if choice is None else self._nodes.read(choice.name)

    def _find(self, choices: tuple[Choice, ...]) -> Choice | None:
        return next((choice for choice in choices if self._nodes.has(choice.name)), None)

    def _need(self, choices: tuple[Choice, ...], what: str) -> Choice:
        choice = self._find(choices)
        if choice is None:
            raise Unsupported(
                self._device,
                f"the camera offers no {what.removeprefix('a ').removeprefix('an ')}",
                f"it has none of the nodes {', '.join(choice.name for choice in choices)}; dump its nodes",
            )
        return choice

    def _unverified(self) -> tuple[str, ...]:
        rows = (table.TEMPERATURE_C, table.LINE_INPUT, table.FRAME_RATE_ON)
        found = [choice.unverified for choices in rows if (choice := self._find(choices)) and choice.unverified]
        return (
            *found,
            *(table.UNVERIFIED_FORMATS[name] for name in self._formats() if name in table.UNVERIFIED_FORMATS),
        )
