"""The closed set of errors that a driver raises: which device, what happened, and what mends it."""


class InstrumentError(Exception):
    """Base of every error of an instrument; raise one of its subclasses.

    Parameters
    ----------
    device
        Name of the instrument in the rig file, e.g. ``"stage1"``.
    what
        What happened, in one line.
    remedy
        What a person can do about it, in one line.
    """

    def __init__(self, device: str, what: str, remedy: str) -> None:
        # All three are arguments of the base, so that an error survives pickling between processes.
        super().__init__(device, what, remedy)
        self.device = device
        self.what = what
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.device}: {self.what} ({self.remedy})"


class NotConnected(InstrumentError):
    """The instrument is not there or not open: it was never reached."""


class DeviceLost(InstrumentError):
    """The instrument was there and went away: unplugged, switched off, or its process died."""


class TimedOut(InstrumentError):
    """The instrument is there, but the bound passed before what was asked; it may still be under way."""


class Refused(InstrumentError):
    """The instrument or its driver refuses this value, or this operation in the present state."""


class Unsupported(InstrumentError):
    """Something that the instrument cannot do at all: no such node, command or capability."""


class LimitReached(InstrumentError):
    """A limit of travel: a target outside the soft limits, or a limit switch that ended a move."""


class MotionFailed(InstrumentError):
    """A move that stalled, was stopped, or ended outside its in-position window."""


class IncompleteFrame(InstrumentError):
    """A frame arrived with parts missing; its pixels are not passed on."""


class FramesLost(InstrumentError):
    """Frames that were exposed never arrived."""


class DeviceFault(InstrumentError):
    """The instrument reports a fault of its own: over-temperature, LED fault, node error."""


class GarbledReply(InstrumentError):
    """An answer came that the protocol does not know."""


class ConfigurationError(InstrumentError):
    """A setting that is wrong or missing: rig file, dialect, profile, port, producer or display.

    Parameters
    ----------
    device, what, remedy
        As for every instrument error.
    location
        Path of the setting within what the driver was given, e.g. ``("axis", "counts_per_mm")``; empty where
        none is to blame. The reader of a rig file turns it into a line and a column.
    """

    def __init__(self, device: str, what: str, remedy: str, location: tuple[str | int, ...] = ()) -> None:
        super().__init__(device, what, remedy)
        self.location = location
