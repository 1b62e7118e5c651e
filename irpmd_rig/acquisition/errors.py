"""What can go wrong with a rig as a whole; what goes wrong with one instrument is in `drivers.errors`."""


class AcquisitionError(Exception):
    """Base of the errors of this package.

    Parameters
    ----------
    what
        What happened, in one line.
    remedy
        What a person can do about it, in one line.
    """

    def __init__(self, what: str, remedy: str) -> None:
        super().__init__(what, remedy)
        self.what = what
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.what} ({self.remedy})"


class SimulationError(AcquisitionError):
    """A simulated world that does not start, is not there, is another one, or refuses what it is asked."""


class RigError(AcquisitionError):
    """A rig on which this cannot be done: it is not open, or nobody is there to do it."""
