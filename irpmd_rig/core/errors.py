"""Errors of the measurement core: each says what was wrong and what is accepted."""


class MeasurementError(ValueError):
    """Base of every error that the measurement core raises on bad input."""


class FramesError(MeasurementError):
    """Frames or maps of a wrong shape or type, too few of them, or values that cannot be."""


class CountsError(MeasurementError):
    """A set of fringe counts that the chosen unwrapping cannot use."""


class CalibrationError(MeasurementError):
    """Data from which the quantity asked for cannot be determined."""


class EvaluationError(MeasurementError):
    """Facets or steps that cannot be found or measured."""
