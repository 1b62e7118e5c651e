"""A camera through a GenTL producer, by harvesters; runs in the worker's process only."""

import logging
import signal
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np
from genicam import genapi, gentl
from harvesters.core import Callback, Harvester, ImageAcquirer

from drivers.camera.backend import INCOMPLETE, Incomplete, NodeFailed, NodeRefused, Nodes, Picture
from drivers.camera.harvesters_nodes import GenApiNodes, first_line, told_apart
from drivers.camera.options import HarvestersSettings
from drivers.camera.producers import producers
from drivers.camera.ximea_nodes import STREAM_LOST
from drivers.errors import ConfigurationError, NotConnected

_FREE = 1  # DEVICE_ACCESS_STATUS_READWRITE
_UNKNOWN = (0, 2, None)
_WHEEL_ERRORS = (genapi.GenericException, gentl.GenericException)


class _Flag(Callback):  # type: ignore[misc]  # harvesters has no types
    """Notes that harvesters discarded an incomplete frame: its `try_fetch` says nothing about it."""

    def __init__(self) -> None:
        self.raised = False

    def emit(self, context: object | None = None) -> None:  # noqa: ARG002 - the signature is harvesters'
        self.raised = True


class HarvestersBackend:
    """One camera.

    Parameters
    ----------
    device
        Name of the camera in the rig file.
    settings
        What the rig file says.
    """

    def __init__(self, device: str, settings: HarvestersSettings) -> None:
        self._device = device
        self._settings = settings
        self._harvester: Any = None
        self._acquirer: Any = None
        self._incomplete = _Flag()
        self._memory: list[bytes] = []
        self._lost_before = 0
        self._identity = ("", "", "")
        self.nodes: Nodes

    def open(self) -> None:
        """Find the camera and connect."""
        # harvesters tells by exceptions what matters, and logs tracebacks for what does not.
        logging.getLogger("harvesters").setLevel(logging.CRITICAL)
        paths = producers(self._device, self._settings.producer)
        self._harvester = Harvester()
        for path in paths:
            self._harvester.add_file(str(path))
        with told_apart():
            self._harvester.update()
        info = self._chosen([str(path) for path in paths])
        try:
            self._acquirer = self._harvester.create(info)
        except _WHEEL_ERRORS as error:
            raise NotConnected(
                self._device,
                f"the camera {info.property_dict['id_']} cannot be opened: {first_line(error)}",
                "end other programs that use it, and check that this user may (udev rule, group)",
            ) from None
        if threading.current_thread() is threading.main_thread():
            # An acquirer that is made in the main thread takes the interrupt signal for itself.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        self._acquirer.num_buffers = self._settings.buffers
        # A private method, since there is no other way: fresh memory for each acquisition takes 1 ms a buffer to
        # arm. A version of harvesters without it makes its own again.
        self._acquirer._create_raw_buffers = self._buffers
        self._acquirer.add_callback(ImageAcquirer.Events.INCOMPLETE_BUFFER, self._incomplete)
        self.nodes = GenApiNodes(self._acquirer.remote_device.node_map)

    def identity(self) -> tuple[str, str, str]:
        """Vendor, model and serial number, as listed."""
        return self._identity

    def start(self) -> None:
        """Announce buffers and start the acquisition."""
        self._incomplete.raised = False
        with told_apart():
            self._acquirer.start()
        self._lost_before = 0
        self._lost_before = self.lost()

    def stop(self) -> None:
        """End the acquisition."""
        with told_apart():
            self._acquirer.stop()

    def fetch(self, wait_s: float) -> Picture | Incomplete | None:
        """Return the next frame."""
        milliseconds = max(1, round(wait_s * 1e3))
        self._acquirer.timeout_period_on_update_event_data_call = milliseconds
        started_s = time.monotonic()
        while True:
            with told_apart():
                # The shortest bound: one wait for an event, of the length above.
                buffer = self._acquirer.try_fetch(timeout=1e-9, is_raw=True)
            if buffer is not None:
                return self._picture(buffer)
            if self._incomplete.raised:
                self._incomplete.raised = False
                return INCOMPLETE
            if time.monotonic() - started_s >= wait_s:
                return None

    def lost(self) -> int:
        """Tell how many frames the transport lost since `start`, as far as it knows."""
        stream = self._acquirer.data_streams[0]
        lost = 0
        with suppress(*_WHEEL_ERRORS, AttributeError, RuntimeError):
            lost = int(stream.num_underrun)
        with suppress(NodeFailed, NodeRefused, AttributeError):
            nodes = GenApiNodes(stream.node_map)
            for choice in STREAM_LOST:
                if nodes.has(choice.name):
                    lost = int(nodes.read(choice.name, fresh=True))
        return max(0, lost - self._lost_before)

    def xml(self) -> bytes | None:
        """Return the camera's description file."""
        with told_apart():
            port = self._acquirer.remote_device.port
            for information in port.url_info_list:
                scheme, _, rest = information.url.partition(":")
                if scheme.lower() == "local":
                    _, address, size = rest.split("?")[0].split(";")
                    return bytes(port.read(int(address, 16), int(size, 16))[1])
        return None

    def close(self) -> None:
        """Disconnect."""
        with suppress(*_WHEEL_ERRORS, AttributeError, RuntimeError):
            self._acquirer.destroy()
        with suppress(*_WHEEL_ERRORS, AttributeError, RuntimeError):
            self._harvester.reset()

    def _buffers(self, num_buffers: int = 0, size: int = 0) -> list[bytes]:
        if [len(buffer) for buffer in self._memory] != [size] * num_buffers:
            self._memory = []
            self._memory = [bytes(size) for _ in range(num_buffers)]
        return list(self._memory)

    def _picture(self, buffer: Any) -> Picture | Incomplete:
        def release() -> None:
            with told_apart():
                buffer.parent.queue_buffer(buffer)

        try:
            data = np.frombuffer(buffer.raw_buffer, np.uint8)
            padding = _told(buffer, "padding_x") or 0
            nanoseconds = _told(buffer, "timestamp_ns")
            return Picture(
                data=data[_told(buffer, "image_offset") or 0 : _told(buffer, "size_filled")],
                format_code=int(buffer.pixel_format),
                width_px=int(buffer.width),
                height_px=int(buffer.height),
                padding_bytes=int(padding),
                frame_id=int(buffer.frame_id),
                timestamp_s=None if nanoseconds is None else nanoseconds / 1e9,
                release=release,
            )
        except _WHEEL_ERRORS as error:
            release()
            raise NodeFailed(f"a buffer does not tell what it holds: {first_line(error)}") from None

    def _chosen(self, paths: list[str]) -> Any:
        wanted = {"serial_number": self._settings.serial_number, "model": self._settings.model}
        wanted = {key: value for key, value in wanted.items() if value is not None}
        listed = [(info, info.property_dict) for info in self._harvester.device_info_list]
        fitting = [(info, told) for info, told in listed if all(told.get(k) == v for k, v in wanted.items())]
        names = ", ".join(f"{told.get('model')} (serial number {told.get('serial_number')})" for _, told in listed)
        if not fitting:
            raise NotConnected(
                self._device,
                f"{' and '.join(paths)} finds no camera" + "".join(f", {k} {v!r}" for k, v in wanted.items()),
                f"choose one of: {names}"
                if listed
                else "plug it in, switch it on, check the udev rule and the producer",
            )
        if len(fitting) > 1:
            raise ConfigurationError(
                self._device,
                f"{len(fitting)} cameras fit: {names}",
                "set `serial_number` or `model`",
                ("serial_number",),
            )
        info, told = fitting[0]
        if told.get("access_status") not in (_FREE, *_UNKNOWN):
            raise NotConnected(
                self._device, f"the camera {told.get('id_')} is in use or may not be opened",
                "end the program that uses it, or give this user the right to (udev rule, group)",
            )  # fmt: skip
        vendor, model, serial_number = (str(told.get(key) or "") for key in ("vendor", "model", "serial_number"))
        self._identity = (vendor, model, serial_number)
        return info


def _told(buffer: Any, name: str) -> int | None:
    """Read what a producer may leave out."""
    try:
        return int(getattr(buffer, name))
    except (*_WHEEL_ERRORS, AttributeError, TypeError, RuntimeError):
        return None
