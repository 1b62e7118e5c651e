"""A GigE Vision camera through Aravis, without a vendor's producer."""

import ctypes
from collections.abc import Callable
from contextlib import suppress
from ctypes import byref, c_int, c_size_t, c_uint64
from typing import ClassVar

import numpy as np

from drivers.camera.aravis_library import AravisLibrary
from drivers.camera.aravis_nodes import AravisNodes
from drivers.camera.backend import INCOMPLETE, Incomplete, NodeFailed, NodeRefused, Nodes, Picture
from drivers.camera.camera import WorkerCamera
from drivers.camera.options import AravisSettings
from drivers.errors import ConfigurationError, NotConnected

_SUCCESS = 0
# Block ids of GigE Vision 1 go from 1 to 65535 and begin again at 1.
_LAST_ID = 65535
_CHECK = 1


class AravisCamera(WorkerCamera):
    """A GigE Vision camera without its maker's software."""

    Settings: ClassVar = AravisSettings
    backend = "aravis"


class AravisBackend:
    """One camera; runs in the worker's process only.

    Parameters
    ----------
    device
        Name of the camera in the rig file.
    settings
        What the rig file says.
    """

    def __init__(self, device: str, settings: AravisSettings) -> None:
        self._device = device
        self._settings = settings
        self._library: AravisLibrary
        self._camera: int | None = None
        self._stream: int | None = None
        self._turns = 0
        self._last_id = 0
        self._lost_before = 0
        self.nodes: Nodes

    def open(self) -> None:
        """Connect to the camera at the address."""
        try:
            self._library = AravisLibrary(self._settings.library)
        except (OSError, AttributeError) as error:
            raise ConfigurationError(
                self._device, f"Aravis cannot be used: {error}", "install Aravis 0.8 (Debian: gir1.2-aravis-0.8)",
                ("library",),
            ) from None  # fmt: skip
        for other in (b"Fake", b"USB3Vision"):
            self._library.arv_disable_interface(other)
        try:
            camera = self._library.arv_open_device(self._settings.address.encode())
        except (NodeFailed, NodeRefused) as error:
            raise self._absent(str(error)) from None
        if not camera:
            raise self._absent("no answer")
        self._camera = camera
        if not self._library.arv_gv_device_is_controller(camera):
            raise self._absent("another program controls it, or one that was killed did a moment ago")
        self._library.arv_device_set_range_check_policy(camera, _CHECK)
        self._library.arv_device_set_access_check_policy(camera, _CHECK)
        self.nodes = AravisNodes(self._library, camera)
        self._check_identity()
        with suppress(NodeFailed, NodeRefused):
            # A client that was killed leaves its camera streaming.
            self.nodes.execute("AcquisitionStop")

    def identity(self) -> tuple[str, str, str]:
        """Nothing is listed: the nodes tell."""
        return "", "", ""

    def start(self) -> None:
        """Announce buffers and start the acquisition."""
        payload_bytes = int(self.nodes.read("PayloadSize"))
        stream = self._library.arv_device_create_stream(self._camera, None, None)
        if not stream:
            raise NodeFailed("the camera offers no stream")
        self._stream = stream
        self._turns = self._last_id = 0
        self._library.set_number(stream, "packet-resend", int(self._settings.resend))
        for _ in range(self._settings.buffers):
            self._library.arv_stream_push_buffer(stream, self._library.arv_buffer_new(payload_bytes, None))
        self._lost_before = 0
        self._lost_before = self.lost()
        try:
            self.nodes.execute("AcquisitionStart")
        except (NodeFailed, NodeRefused):
            self._release_stream()
            raise

    def stop(self) -> None:
        """End the acquisition."""
        try:
            self.nodes.execute("AcquisitionStop")
        finally:
            self._release_stream()

    def fetch(self, wait_s: float) -> Picture | Incomplete | None:
        """Return the next frame."""
        buffer = self._library.arv_stream_timeout_pop_buffer(self._stream, round(wait_s * 1e6))
        if not buffer:
            return None
        release = self._release(buffer)
        if self._library.arv_buffer_get_status(buffer) != _SUCCESS:
            release()
            return INCOMPLETE
        size, across, down = c_size_t(), c_int(), c_int()
        address = self._library.arv_buffer_get_data(buffer, byref(size))
        self._library.arv_buffer_get_image_padding(buffer, byref(across), byref(down))
        nanoseconds = self._library.arv_buffer_get_timestamp(buffer)
        return Picture(
            data=np.ctypeslib.as_array((ctypes.c_uint8 * size.value).from_address(address)),
            format_code=self._library.arv_buffer_get_image_pixel_format(buffer),
            width_px=self._library.arv_buffer_get_image_width(buffer),
            height_px=self._library.arv_buffer_get_image_height(buffer),
            padding_bytes=across.value,
            frame_id=self._unwrapped(self._library.arv_buffer_get_frame_id(buffer)),
            timestamp_s=nanoseconds / 1e9 if nanoseconds else None,
            release=release,
        )

    def lost(self) -> int:
        """Frames that found no buffer since `start`."""
        if self._stream is None:
            return 0
        complete, failed, no_buffer = c_uint64(), c_uint64(), c_uint64()
        self._library.arv_stream_get_statistics(self._stream, byref(complete), byref(failed), byref(no_buffer))
        return no_buffer.value - self._lost_before

    def xml(self) -> bytes | None:
        """Return the camera's description file."""
        return self.nodes.xml() if isinstance(self.nodes, AravisNodes) else None

    def close(self) -> None:
        """Disconnect."""
        if self._camera is not None:
            with suppress(NodeFailed, NodeRefused):
                if self._stream is not None:
                    self.stop()
            self._library.unref(self._camera)
            self._camera = None

    def _release(self, buffer: int) -> Callable[[], None]:
        stream = self._stream
        return lambda: self._library.arv_stream_push_buffer(stream, buffer)

    def _release_stream(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            self._library.unref(stream)

    def _unwrapped(self, frame_id: int) -> int:
        if frame_id < self._last_id <= _LAST_ID:
            self._turns += 1
        self._last_id = frame_id
        return frame_id + self._turns * _LAST_ID

    def _check_identity(self) -> None:
        for name, wanted in (
            ("DeviceModelName", self._settings.model),
            ("DeviceSerialNumber", self._settings.serial_number),
        ):
            if wanted is not None and self.nodes.has(name) and (found := self.nodes.read(name)) != wanted:
                raise self._absent(f"its {name} is {found!r}, not {wanted!r}")

    def _absent(self, reason: str) -> NotConnected:
        return NotConnected(
            self._device,
            f"no camera to use at {self._settings.address}: {reason}",
            "check `address`, cable and firewall, and that no other program has the camera",
        )
