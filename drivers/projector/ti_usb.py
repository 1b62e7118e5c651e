"""TI's API over USB, as a profile says."""

import time
from contextlib import suppress
from pathlib import Path

from drivers.errors import DeviceFault, InstrumentError, Refused, TimedOut
from drivers.projector.ti_api import Result, Value
from drivers.projector.usb_frames import Reply, StaleReply, decode_reply, decode_result, encode_request
from drivers.projector.usb_link import UsbAddress, UsbBackend, UsbLink
from drivers.projector.usb_profile import OperationLayout, UsbProfile


class UsbTransport:
    """A `drivers.projector.ti_api.Transport` over pyusb.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    profile
        A profile without unknowns.
    serial_number
        USB serial number of the box; None: the first that is found.
    backend
        The USB library.
    timeout_s
        Bound of one transfer; a call is at most two.
    """

    def __init__(
        self, device: str, profile: UsbProfile, serial_number: str | None, backend: UsbBackend, timeout_s: float
    ) -> None:
        self._device = device
        self._profile = profile
        self._timeout_s = timeout_s
        address = UsbAddress(
            int(profile.vendor_id),
            int(profile.product_id),
            int(profile.endpoint_out),
            int(profile.endpoint_in),
            int(profile.interface),
            serial_number,
        )
        self._link = UsbLink(device, address, backend, timeout_s)
        self._sequence = 0
        self._disturbed = False

    def open(self) -> None:
        """Find and claim the box, and throw away what a former user left in its replies."""
        self._link.open()
        self._disturbed = True

    def close(self) -> None:
        """Give the box back."""
        self._link.close()

    @property
    def is_open(self) -> bool:
        """Whether the box is claimed, as far as is known."""
        return self._link.is_open

    def call(self, operation: str, **values: Value) -> Result:
        """Carry out one operation.

        Raises
        ------
        Refused, DeviceFault
            The box says that it will not, or cannot.
        TimedOut, GarbledReply, DeviceLost
            Nobody knows whether it was carried out.
        """
        layout = self._profile.operations[operation]
        if operation == "RunBatchFile":
            values["file"] = Path(str(values["file"])).read_text("ascii")
        if self._disturbed:
            self.recover()
        self._sequence = (self._sequence + 1) % 256
        self._disturbed = True
        self._link.write(encode_request(self._profile, layout, self._sequence, values))
        reply = self._reply(layout)
        self._check_status(operation, reply.status)
        result = decode_result(self._profile, self._device, layout, reply.payload)
        self._disturbed = False
        return result

    def recover(self) -> None:
        """Clear halted endpoints and throw away late replies."""
        self._link.recover(int(self._profile.longest_reply_bytes))
        self._disturbed = False

    def _reply(self, layout: OperationLayout) -> Reply:
        give_up_s = time.monotonic() + self._timeout_s
        while (left_s := give_up_s - time.monotonic()) > 0.0:
            frame = self._link.read(int(self._profile.longest_reply_bytes), left_s)
            with suppress(StaleReply):
                return decode_reply(self._profile, self._device, layout, self._sequence, frame)
        raise TimedOut(self._device, "only replies to earlier requests came", "look at the projector, then retry")

    def _check_status(self, operation: str, status: int) -> None:
        if status == self._profile.status_done:
            return
        # The reply was sound: what was said is known.
        self._disturbed = False
        meaning = self._profile.statuses.get(str(status), "no known status")
        kind: type[InstrumentError] = DeviceFault if status in self._profile.fault_statuses else Refused
        raise kind(self._device, f"the box refuses {operation}: status {status}, {meaning}", "see its documents")
