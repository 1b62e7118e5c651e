"""TI's API through the lab's own copy of TI's library, in a process that can be ended if the library hangs."""

from pathlib import Path

from drivers.errors import DeviceFault, DeviceLost, NotConnected, TimedOut
from drivers.projector.child import Child
from drivers.projector.ti_api import OPERATIONS, Result, Value


class LibraryTransport:
    """A `drivers.projector.ti_api.Transport` by ctypes.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    library
        Path of the library.
    timeout_s
        Bound of one call.
    """

    def __init__(self, device: str, library: Path, timeout_s: float) -> None:
        self._device = device
        self._library = library
        self._timeout_s = timeout_s
        self._child: Child | None = None

    def open(self) -> None:
        """Load the library and let it find the box.

        Raises
        ------
        ConfigurationError
            It cannot be loaded, or lacks an operation.
        NotConnected
            It finds no box.
        """
        self.close()
        child = Child(self._device, "drivers.projector.ti_process", {"library": str(self._library)})
        try:
            child.greet()
        except (TimedOut, DeviceLost) as error:
            raise NotConnected(self._device, f"TI's library does not start: {error.what}", error.remedy) from None
        self._child = child

    def close(self) -> None:
        """End the process."""
        child, self._child = self._child, None
        if child is not None:
            child.end()

    @property
    def is_open(self) -> bool:
        """Whether the process is there, as far as is known."""
        return self._child is not None

    def call(self, operation: str, **values: Value) -> Result:
        """Call one function.

        Raises
        ------
        DeviceFault
            It returns an error; TI's library does not say which. The box may have been switched off and on: its process
            was ended, so that nothing is believed of what lies in the box.
        TimedOut
            It does not return; its process was ended.
        DeviceLost
            Its process has ended.
        """
        child = self._child
        if child is None:
            raise DeviceLost(self._device, "TI's library is not loaded", "open the projector again")
        data = b""
        for name, kind in OPERATIONS[operation].parameters:
            if kind == "bytes" and isinstance(found := values.pop(name), bytes):
                data = found
        try:
            answer = child.call(operation, data, timeout_s=self._timeout_s, values=values)
        except (DeviceFault, DeviceLost, TimedOut):
            self.close()
            raise
        result: Result = answer["result"]
        return result

    def recover(self) -> None:
        """Load the library again if its process was ended: a light may still be on."""
        if not self.is_open:
            self.open()
