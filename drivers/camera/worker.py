"""The process that owns one camera: `python -m drivers.camera.worker DESCRIPTOR`, started by `drivers.camera.link`.

One thread, since the GenTL binding holds the interpreter lock while it waits. It waits for frames in short
slices and looks at its channel in between; it ends when the channel does.
"""

import select
import signal
import socket
import sys
import time
from collections.abc import Callable

from drivers.camera.backend import Backend, Incomplete, NodeFailed, NodeRefused, Picture
from drivers.camera.channel import Channel, ChannelError, Message
from drivers.camera.control import CameraControl
from drivers.camera.counting import FrameCount
from drivers.camera.messages import capabilities_message, dump_message, error_message, settings_from, settings_message
from drivers.camera.options import AravisSettings, HarvestersSettings
from drivers.camera.pixels import BY_CODE, BY_NAME, PixelFormat, unpack
from drivers.camera.ring import RingWriter
from drivers.errors import (
    ConfigurationError,
    DeviceFault,
    DeviceLost,
    GarbledReply,
    InstrumentError,
    Refused,
)

SLICE_S = 0.01
FULL_RING_SLICE_S = 0.001
IDLE_SLICE_S = 1.0
# No call into a vendor's library takes longer; the kernel ends a process that hangs in one, parent or no parent.
HANG_LIMIT_S = 90.0


class Acquisition:
    """One arming: what is counted, and where the frames go."""

    def __init__(self, session: int, count: FrameCount, frames: tuple[PixelFormat, int, int], *, triggered: bool):
        self.session = session
        self.count = count
        self.form, self.width_px, self.height_px = frames
        self._triggered = triggered
        self._awaited = 0

    @property
    def expects(self) -> bool:
        """Whether a frame may come: not between the software triggers, where the next command comes first."""
        return not self._triggered or self._awaited > 0

    def triggered(self) -> None:
        """Note a software trigger."""
        self._awaited += 1

    def arrived(self, frames: int) -> None:
        """Note frames that came or will never come."""
        self._awaited = max(0, self._awaited - frames)


class Worker:
    """Serves one camera to the program at the other end of the channel."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._device = "camera"
        self._backend: Backend | None = None
        self._control: CameraControl | None = None
        self._options: HarvestersSettings | AravisSettings = HarvestersSettings()
        self._trigger = "free"
        self._ring: RingWriter | None = None
        self._acquisition: Acquisition | None = None
        self._first_id: int | None = None
        self._ids_advance = False
        self._operations: dict[str, Callable[[Message], object]] = {
            "open": self._open,
            "capabilities": lambda _: capabilities_message(self._camera[1].capabilities()),
            "configure": self._configure,
            "arm": self._arm,
            "trigger": self._software_trigger,
            "stop": lambda _: self._stop(),
            "probe": self._probe,
            "temperature": lambda _: self._camera[1].temperature_c(),
            "dump": lambda _: dump_message(self._camera[0].xml(), self._camera[0].nodes.all()),
        }

    def run(self) -> None:
        """Serve until the channel closes."""
        poll = select.poll()
        poll.register(self._channel.fileno(), select.POLLIN)
        try:
            while True:
                signal.setitimer(signal.ITIMER_REAL, HANG_LIMIT_S)
                if poll.poll(1e3 * self._pause_s()):
                    for message in self._channel.receive():
                        self._answer(message)
                elif self._acquisition is not None and self._acquisition.expects:
                    self._take_frame(self._acquisition)
        except (EOFError, OSError, ChannelError):
            pass
        finally:
            if self._backend is not None:
                self._backend.close()
            self._channel.close()

    # ---- messages ----

    @property
    def _camera(self) -> tuple[Backend, CameraControl]:
        if self._backend is None or self._control is None:
            raise Refused(self._device, "the camera is not open", "open it first")
        return self._backend, self._control

    def _answer(self, message: Message) -> None:
        reply: Message = {"reply": message.get("request")}
        descriptor = None
        try:
            reply["result"] = self._operations[str(message.get("do"))](message)
            if message.get("do") == "arm" and self._ring is not None:
                descriptor, reply["ring"] = self._ring.descriptor, True
        except InstrumentError as error:
            reply["error"] = error_message(error)
        except (NodeFailed, NodeRefused) as error:
            reply["error"] = error_message(self._explained(error))
        self._channel.send(reply, descriptor)

    def _explained(self, error: NodeFailed | NodeRefused) -> InstrumentError:
        if isinstance(error, NodeRefused):
            return Refused(self._device, f"the camera refuses: {error}", "check the setting, and dump the nodes")
        if self._control is not None and self._control.alive():
            return DeviceFault(self._device, f"the camera failed: {error}", "try again; if it stays, replug the camera")
        return DeviceLost(self._device, f"the camera is gone: {error}", "check its cable, then try again")

    def _open(self, message: Message) -> None:
        self._device = str(message["device"])
        self._options = backend_settings(message)
        backend = _backend(self._device, self._options)
        self._backend = backend
        try:
            backend.open()
        except NodeFailed as error:
            raise DeviceLost(self._device, f"the camera went away: {error}", "check its cable, then open it") from None
        self._control = CameraControl(self._device, backend.nodes, self._options, backend.identity())

    def _configure(self, message: Message) -> Message:
        _, control = self._camera
        if self._acquisition is not None:
            raise Refused(self._device, "frames are being taken", "stop first")
        settings = settings_from(message["settings"])
        in_force = control.configure(settings)
        self._trigger = in_force.trigger
        return settings_message(in_force)

    def _arm(self, message: Message) -> Message:
        backend, control = self._camera
        self._stop()
        control.check_temperature(self._options.hottest_c)
        name, width, height = control.frame_format()
        form = BY_NAME[name]
        values = width * height * form.channels
        ring = self._fitting_ring(values * form.kind.itemsize)
        count = FrameCount(message["frames"], self._first_id, advances=self._ids_advance)
        session = int(message["session"])
        backend.start()
        self._acquisition = Acquisition(session, count, (form, width, height), triggered=self._trigger == "software")
        try:
            if self._trigger != "free":
                control.wait_until_ready()
            exposure_us = control.exposure_us()
        except (InstrumentError, NodeFailed, NodeRefused):
            self._stop()
            raise
        return {"slots": ring.slots, "slot_bytes": ring.slot_bytes, "exposure_us": exposure_us}

    def _software_trigger(self, _: Message) -> None:
        control = self._camera[1]
        if self._acquisition is None or self._trigger != "software":
            raise Refused(self._device, "the camera is not armed for a software trigger", "configure and arm it")
        control.trigger()
        self._acquisition.triggered()

    def _probe(self, _: Message) -> None:
        """Tell why no frame came: gone, lost on the way, or nothing at all."""
        backend, control = self._camera
        if not control.alive():
            raise DeviceLost(self._device, "the camera does not answer any more", "check its cable, then try again")
        if self._acquisition is not None:
            self._report_lost(self._acquisition, self._acquisition.count.silent(backend.lost()))

    def _stop(self) -> None:
        acquisition, self._acquisition = self._acquisition, None
        if acquisition is not None and self._backend is not None:
            self._first_id = acquisition.count.first_id
            self._ids_advance = acquisition.count.advances
            self._backend.stop()

    # ---- frames ----

    def _pause_s(self) -> float:
        if self._acquisition is None or self._ring is None or not self._acquisition.expects:
            return IDLE_SLICE_S
        # Without a free slot frames stay with the camera's library, which counts what it loses.
        return 0.0 if self._ring.free_slot() is not None else FULL_RING_SLICE_S

    def _fitting_ring(self, slot_bytes: int) -> RingWriter:
        if self._ring is not None and self._ring.slot_bytes != slot_bytes:
            self._ring.close()
            self._ring = None
        if self._ring is None:
            self._ring = RingWriter(self._options.slots, slot_bytes)
        return self._ring

    def _take_frame(self, acquisition: Acquisition) -> None:
        backend, _ = self._camera
        slot = self._ring.free_slot() if self._ring is not None else None
        if slot is None:
            return
        try:
            found = backend.fetch(SLICE_S)
            if isinstance(found, Picture):
                self._pass_on(acquisition, found, slot)
            elif isinstance(found, Incomplete):
                acquisition.arrived(1)
                self._channel.send({"session": acquisition.session, "incomplete": acquisition.count.incomplete()})
            if acquisition.count.complete:
                self._stop()
        except (NodeFailed, NodeRefused) as error:
            self._acquisition = None
            self._channel.send({"session": acquisition.session, "error": error_message(self._explained(error))})
        except GarbledReply as error:
            self._stop()
            self._channel.send({"session": acquisition.session, "error": error_message(error)})

    def _pass_on(self, acquisition: Acquisition, picture: Picture, slot: int) -> None:
        received_s = time.monotonic()
        backend, _ = self._camera
        try:
            first = acquisition.count.first
            lost = backend.lost() if first else 0
            arrival = acquisition.count.frame(picture.frame_id, lost, picture.timestamp_s)
            self._report_lost(acquisition, arrival.lost)
            if arrival.index is None:
                return
            form = self._copy(acquisition, picture, slot)
        finally:
            picture.release()
        acquisition.arrived(1)
        assert self._ring is not None
        self._ring.take(slot)
        self._channel.send({
            "session": acquisition.session,
            "slot": slot,
            "shape": form.shape(acquisition.width_px, acquisition.height_px),
            "bits": form.bits,
            "index": arrival.index,
            "frame_id": picture.frame_id,
            "timestamp_s": picture.timestamp_s,
            "received_s": received_s,
        })  # fmt: skip

    def _copy(self, acquisition: Acquisition, picture: Picture, slot: int) -> PixelFormat:
        form = acquisition.form
        told = (picture.format_code, picture.width_px, picture.height_px)
        if told != (form.code, acquisition.width_px, acquisition.height_px) or self._ring is None:
            named = BY_CODE[told[0]].name if told[0] in BY_CODE else f"pixel format {told[0]:#010x}"
            raise GarbledReply(
                self._device,
                f"a frame of {told[1]} x {told[2]} {named} came, "
                f"not of {acquisition.width_px} x {acquisition.height_px} {form.name}",
                "configure the camera again; if that does not help, replug it",
            )
        out = self._ring.array(slot, form.shape(acquisition.width_px, acquisition.height_px), form.kind)
        try:
            unpack(
                picture.data, form, width_px=acquisition.width_px, height_px=acquisition.height_px,
                padding_bytes=picture.padding_bytes, out=out,
            )  # fmt: skip
        except ValueError as error:
            raise GarbledReply(self._device, f"a frame cannot be read: {error}", "dump the camera's nodes") from None
        return form

    def _report_lost(self, acquisition: Acquisition, frames: int) -> None:
        if frames:
            acquisition.arrived(frames)
            self._channel.send({"session": acquisition.session, "lost": frames})


def backend_settings(message: Message) -> HarvestersSettings | AravisSettings:
    """Make a backend's settings again."""
    model = AravisSettings if message["backend"] == "aravis" else HarvestersSettings
    return model.model_validate(message["options"])


def _backend(device: str, settings: HarvestersSettings | AravisSettings) -> Backend:
    try:
        if isinstance(settings, AravisSettings):
            from drivers.camera.aravis_backend import AravisBackend

            return AravisBackend(device, settings)
        from drivers.camera.harvesters_backend import HarvestersBackend

        return HarvestersBackend(device, settings)
    except ImportError as error:
        raise ConfigurationError(
            device, f"{error.name} is not installed", "pip install harvesters", ("driver",)
        ) from None


def main() -> None:
    """Serve the channel whose descriptor is the only argument."""
    # A terminal's interrupt is for the program, which then closes the camera.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    Worker(Channel(socket.socket(fileno=int(sys.argv[1])))).run()


if __name__ == "__main__":
    main()
