"""Errors of the simulated world."""


class WorldError(ValueError):
    """A world file that cannot be read, or that describes a world that cannot be."""


class SimulationError(ValueError):
    """Something that the simulated rig was asked to do and cannot do."""
