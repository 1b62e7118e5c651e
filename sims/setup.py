"""What stands where in the world at one moment."""

from dataclasses import dataclass

from sims.errors import SimulationError

# The screws of the glass's mount have no longer way.
LARGEST_TURN_DEG = 5.0


@dataclass(frozen=True, slots=True)
class Setup:
    """Everything that geometry depends on; equal setups look equal.

    Attributes
    ----------
    subject : str
        "mirror", "plate", "board", "board_on_plate", "nothing", or the name of one of the world's objects.
    pose : int
        Which of the free poses the board has.
    glass : bool
        Whether the ground glass is in place.
    stage1_mm, stage2_mm : float
        True displacements along the stages' axes.
    glass_turn_deg : tuple of float
        By how much people have turned the glass about its centre since it was set up, about x and about y: it adds
        to the tilts of the world.
    """

    subject: str
    pose: int = 0
    glass: bool = True
    stage1_mm: float = 0.0
    stage2_mm: float = 0.0
    glass_turn_deg: tuple[float, float] = (0.0, 0.0)


def turned_glass(before_deg: tuple[float, float], about_x_deg: float, about_y_deg: float) -> tuple[float, float]:
    """Return where the glass is after its screws were turned, from where it was.

    Raises
    ------
    SimulationError
        The screws do not reach so far, or what was asked is no angle.
    """
    after_deg = (before_deg[0] + about_x_deg, before_deg[1] + about_y_deg)
    if not all(abs(angle) <= LARGEST_TURN_DEG for angle in after_deg):
        raise SimulationError(f"the screws turn the glass by at most {LARGEST_TURN_DEG:g} degrees, not {after_deg}")
    return after_deg
