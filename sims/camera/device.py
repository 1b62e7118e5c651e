"""The simulated camera: registers on one side, the world on the other."""

from collections.abc import Callable
from threading import RLock
from typing import cast

from sims.camera.acquisition import Acquisition, Counters, Picture, Plan, Render, Sink
from sims.camera.faults import CameraFaults
from sims.camera.features import MODES, SOURCES, TRIGGERS
from sims.camera.nodemap import XML_ADDRESS, NodeMap, Register, Value
from sims.camera.parameters import CameraSettings, Parameters
from sims.camera.wire import Refusal, Status
from sims.clock import WorldClock

__all__ = ["CameraTwin", "Picture"]

_SOFTWARE, _LINE = (number for _, number in SOURCES)


class CameraTwin:
    """A camera as its GenTL producer and the world see it.

    Parameters
    ----------
    render : callable
        `render(exposure_start_s, exposure_us, bits)` returns what the whole sensor sees: (height, width),
        uint8 for 8 bits, uint16 for 10. It is called in the camera's exposure thread as the clock reaches the
        exposure's start (later where the thread is late: the first argument tells the true moment). Where the
        picture takes long, it may take note of the world's state and return a callable without arguments that
        makes the picture; that is called once, in order, in the camera's readout thread after the readout.
    clock : WorldClock
        The time that the camera lives in.
    settings : CameraSettings
        What the camera is.

    Attributes
    ----------
    faults : CameraFaults
        Faults to inject.
    """

    def __init__(self, render: Render, clock: WorldClock, settings: CameraSettings | None = None):
        self.settings = settings or CameraSettings()
        self._clock = clock
        self._render = render
        self._lock = RLock()
        self._parameters = Parameters(self.settings)
        self.node_map = NodeMap(tuple(self._parameters.features.values()), self.settings.model)
        self._acquisition: Acquisition | None = None
        self._epoch_s = self._clock.now()
        self._latched_ns = 0
        self._sink: Sink | None = None
        self._plugged = True
        self._on_unplug: Callable[[], None] = lambda: None
        self.faults = CameraFaults(self._unplug, self._replug)

    # ---- the world's side ----

    def trigger(self, time_s: float, *, rising: bool = True) -> None:
        """Take an edge on the hardware trigger line (Line1) at `time_s` of the clock; does not wait."""
        with self._lock:
            trigger = self._parameters.trigger()
            acquisition = self._acquisition
        if acquisition is not None and trigger is not None and trigger[1:] == (_LINE, 0 if rising else 1):
            acquisition.trigger(time_s)

    @property
    def counters(self) -> Counters:
        """Frames and triggers since the last AcquisitionStart."""
        with self._lock:
            return self._acquisition.counters if self._acquisition is not None else Counters()

    @property
    def acquiring(self) -> bool:
        """Whether frames are being acquired, or triggers awaited."""
        with self._lock:
            return self._acquisition is not None and self._acquisition.running

    @property
    def plugged(self) -> bool:
        """Whether the camera can be found."""
        return self._plugged

    def close(self) -> None:
        """End the acquisition and wait for its threads."""
        self._end_acquisition()
        if self._acquisition is not None:
            self._acquisition.join()

    # ---- the server's side ----

    @property
    def identity(self) -> tuple[str, str, str, str, str, str]:
        """Id, vendor, model, serial number, version, user's name."""
        texts = [str(self._parameters.get(f"Device{name}")) for name in ("VendorName", "ModelName", "SerialNumber")]
        return (
            f"irpmd-rig {texts[2]}",
            texts[0],
            texts[1],
            texts[2],
            str(self._parameters.get("DeviceVersion")),
            "",
        )

    def on_unplug(self, call: Callable[[], None]) -> None:
        """Have `call` called whenever the plug is pulled."""
        self._on_unplug = call

    def open(self) -> None:
        """Begin a client's session: settings are as after power-up, triggers off."""
        with self._lock:
            self._parameters.reset()

    def release(self) -> None:
        """End a client's session, hence its acquisition."""
        self._end_acquisition()

    def attach(self, sink: Sink) -> None:
        """Send frames to `sink`."""
        with self._lock:
            self._sink = sink

    def detach(self, sink: Sink) -> None:
        """Send frames nowhere, if they go to `sink`."""
        with self._lock:
            if self._sink is sink:
                self._sink = None

    def payload_bytes(self) -> int:
        """Size of a frame as the camera is set now."""
        with self._lock:
            return self._parameters.frame().payload_bytes

    def to_ns(self, moment_s: float) -> int:
        """Time stamp, in ns, of a moment of the clock."""
        return max(0, round((moment_s - self._epoch_s) * 1e9))

    def read(self, address: int, size: int) -> bytes:
        """Bytes at an address: a register, or a part of the XML.

        Raises
        ------
        Refusal
            If there is nothing, or a fault is injected.
        """
        if address >= XML_ADDRESS:
            xml = self.node_map.xml[address - XML_ADDRESS :][:size]
            if len(xml) < size:
                raise Refusal(Status.INVALID_ADDRESS, "the XML ends before")
            return xml
        register = self.node_map.register(address, size)
        self.faults.check("read", register.feature.name)
        with self._lock:
            return register.encode(self._value(register))

    def write(self, address: int, data: bytes) -> None:
        """Write a register.

        Raises
        ------
        Refusal
            If there is none, the value is out of range, it cannot be written now, or a fault is injected.
        """
        register = self.node_map.register(address, len(data))
        name = register.feature.name
        if register.part != "value":
            raise Refusal(Status.ACCESS_DENIED, f"the limits of {name} can only be read")
        self.faults.check("write", name)
        if register.feature.kind == "command":
            self._command(name)
            return
        with self._lock:
            self._parameters.set(name, register.decode(data), acquiring=self.acquiring)
            pixel_format = self._parameters.frame().pixel_format
        if name == "PixelFormat":
            pixel_format.prepare()

    # ---- inside ----

    def _value(self, register: Register) -> Value:
        name = register.feature.name
        if register.part != "value":
            low, high, step = self._parameters.limits(name)
            limit = {"minimum": low, "maximum": high, "increment": step}[register.part]
            return limit if register.feature.kind == "float" else int(limit)
        if name == "DeviceTemperature":
            return self.faults.temperature_c
        if name == "TimestampLatchValue":
            return self._latched_ns
        if name == "CounterValue":
            return self._count()
        return self._parameters.get(name)

    def _count(self) -> int:
        counters = self.counters
        values = (counters.transferred, counters.skipped, counters.missed_triggers)
        return values[cast(int, self._parameters.get("CounterSelector"))]

    def _command(self, name: str) -> None:
        match name:
            case "AcquisitionStart":
                self._start_acquisition()
            case "AcquisitionStop":
                self._end_acquisition()
            case "TriggerSoftware":
                self._software_trigger()
            case "TimestampLatch":
                self._latched_ns = self.to_ns(self._clock.now())
            case "TimestampReset":
                self._epoch_s = self._clock.now()

    def _software_trigger(self) -> None:
        with self._lock:
            trigger = self._parameters.trigger()
            selected = TRIGGERS[cast(int, self._parameters.get("TriggerSelector"))][0]
            acquisition = self._acquisition
        if acquisition is not None and trigger is not None and trigger[:2] == (selected, _SOFTWARE):
            acquisition.trigger(self._clock.now())

    def _plan(self) -> Plan:
        mode = MODES[cast(int, self._parameters.get("AcquisitionMode"))][0]
        count = cast(int, self._parameters.get("AcquisitionFrameCount"))
        frames = {"Continuous": None, "SingleFrame": 1, "MultiFrame": count}[mode]
        trigger = self._parameters.trigger()
        in_bursts = trigger is not None and trigger[0] == "FrameBurstStart"
        burst = cast(int, self._parameters.get("AcquisitionBurstFrameCount")) if in_bursts else 1
        return Plan(frames, trigger is not None, burst)

    def _start_acquisition(self) -> None:
        with self._lock:
            if self.acquiring or not self._plugged:
                return
            previous = self._acquisition
            self._acquisition = Acquisition(
                self._plan(),
                self.settings,
                self._parameters.frame,
                self._render,
                self._clock,
                self.faults,
                lambda: self._sink,
            )
            self._acquisition.start(previous)

    def _end_acquisition(self) -> None:
        with self._lock:
            acquisition = self._acquisition
        if acquisition is not None:
            acquisition.end()

    def _unplug(self) -> None:
        with self._lock:
            self._plugged = False
        self._end_acquisition()
        self._on_unplug()

    def _replug(self) -> None:
        with self._lock:
            if self._plugged:
                return
            self._parameters.reset()
            self._epoch_s = self._clock.now()
            self._plugged = True
