"""What stands where in the world at one moment."""

from dataclasses import dataclass


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
    """

    subject: str
    pose: int = 0
    glass: bool = True
    stage1_mm: float = 0.0
    stage2_mm: float = 0.0
