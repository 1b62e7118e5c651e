"""The simulated rig as whoever runs it sees it: put something in place, move, show, take a frame."""

from numbers import Integral, Real
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from sims.boards import board_pose
from sims.errors import SimulationError
from sims.maps import LightMaps
from sims.optics import LightMap, Trace, trace
from sims.render import exposure, projected_light, render
from sims.setup import Setup, turned_glass
from sims.surfaces import SUBJECTS

if TYPE_CHECKING:
    from sims.world import World


class SimulatedRig:
    """A world with its instruments; every frame and move is a function of the seed and the calls before.

    It begins with the mirror in place, the glass in place, both stages at 0, infrared light, a black picture,
    the lamp off, and the camera's exposure and bits of the world. It is not for several threads at once.

    Parameters
    ----------
    world : World
    seed : int, optional
        Another seed than the world's: other noise and other board poses, the same instruments.

    Raises
    ------
    SimulationError
        The seed is not a whole number from 0 to 2^63 - 1.
    """

    def __init__(self, world: "World", *, seed: int | None = None) -> None:
        if seed is not None:
            if not _is_whole(seed) or not 0 <= seed < 2**63:
                raise SimulationError(f"a seed is a whole number from 0 to 2^63 - 1, not {seed!r}")
            world = world.model_copy(update={"seed": int(seed)})
        self.world = world
        self._setup = Setup("mirror")
        self._light = self.world.lights.infrared
        self._exposure_us = self.world.camera.exposure_us
        self._bits: int = self.world.camera.bits
        self._lamp = False
        self._picture = projected_light(self.world.projector, None)
        self._moves = np.random.default_rng([self.world.seed, 0x57A6E])
        self._frames = 0
        self._maps = LightMaps(self.world)

    @property
    def setup(self) -> Setup:
        """What stands where, truly: the stages' displacements with their errors."""
        return self._setup

    @property
    def picture(self) -> NDArray[np.float32]:
        """Light of the picture shown (`sims.render.projected_light`)."""
        return self._picture

    def place(self, subject: str, *, pose: int = 0) -> None:
        """Put a subject in front of the camera.

        Parameters
        ----------
        subject : str
            "mirror", "plate", "board" (in its free pose number `pose`), "board_on_plate", "nothing", or an
            object of the world.

        Raises
        ------
        SimulationError
            The world has no such subject or pose.
        WorldError
            The board's ranges leave no room for this pose in the image.
        """
        known = (*SUBJECTS, *self.world.objects)
        if not isinstance(subject, str) or subject not in known:
            raise SimulationError(f"there is no subject '{subject}': this world has {', '.join(known)}")
        poses = self.world.board.poses if subject == "board" else 1
        if not _is_whole(pose) or not 0 <= pose < poses:
            raise SimulationError(f"'{subject}' has poses 0 to {poses - 1}, not {pose!r}")
        if subject == "board":
            board_pose(self.world, int(pose))
        self._change(subject=subject, pose=int(pose))

    def set_glass(self, present: bool) -> None:
        """Put the ground glass in or take it away."""
        self._change(glass=bool(present))

    def turn_glass(self, about_x_deg: float, about_y_deg: float) -> None:
        """Turn the ground glass by its screws, from where it is (right-handed, about its centre).

        Raises
        ------
        SimulationError
            It would lean by more than its screws allow.
        """
        self._change(glass_turn_deg=turned_glass(self._setup.glass_turn_deg, about_x_deg, about_y_deg))

    def move_stage1(self, position_mm: float) -> None:
        """Move camera, mirror and object; positive is away from the glass. The stage's errors are added.

        Raises
        ------
        SimulationError
            The position is outside the stage's travel.
        """
        stage = self.world.stage1
        _check_travel("stage1", position_mm, *stage.travel_mm)
        noise = self._moves.standard_normal() * stage.position_noise_um * 1e-3
        self._change(stage1_mm=float(position_mm * (1 + stage.scale_error_ppm * 1e-6) + noise))

    def move_stage2(self, position_mm: float) -> None:
        """Move the plate away from the camera. The stage's noise is added.

        Raises
        ------
        SimulationError
            The position is outside the stage's travel.
        """
        stage = self.world.stage2
        _check_travel("stage2", position_mm, 0.0, stage.travel_mm)
        noise = self._moves.standard_normal() * stage.position_noise_um * 1e-3
        self._change(stage2_mm=float(position_mm + noise))

    def set_light(self, light: Literal["infrared", "visible"]) -> None:
        """Choose the light source.

        Raises
        ------
        SimulationError
            There is no such light.
        """
        if light not in ("infrared", "visible"):
            raise SimulationError(f"there is no light '{light}': infrared and visible are")
        self._light = getattr(self.world.lights, light)

    def set_exposure(self, exposure_us: float) -> None:
        """Set the camera's exposure in microseconds.

        Raises
        ------
        SimulationError
            It is not a number above 0 and up to 1e9.
        """
        if not _is_number(exposure_us) or not 0 < exposure_us <= 1e9:
            raise SimulationError(f"an exposure is a positive number of microseconds, at most 1e9, not {exposure_us!r}")
        self._exposure_us = float(exposure_us)

    def set_bits(self, bits: Literal[8, 10]) -> None:
        """Set the bits of a pixel.

        Raises
        ------
        SimulationError
            It is neither 8 nor 10.
        """
        if not _is_whole(bits) or bits not in (8, 10):
            raise SimulationError(f"the camera has 8 or 10 bits, not {bits!r}")
        self._bits = int(bits)

    def set_lamp(self, on: bool) -> None:
        """Turn the flood light on or off."""
        self._lamp = bool(on)

    def show(self, image: NDArray[np.uint8] | None) -> None:
        """Show a picture until the next one; None is black.

        Parameters
        ----------
        image : (rows, columns) uint8 of the projector's size, or None.

        Raises
        ------
        SimulationError
            It has another shape or type.
        """
        columns, rows = self.world.projector.size_px
        if image is not None and not isinstance(image, np.ndarray):
            raise SimulationError(f"the projector shows arrays, not a {type(image).__name__}")
        if image is not None and (image.shape != (rows, columns) or image.dtype != np.uint8):
            raise SimulationError(
                f"the projector shows uint8 pictures of shape ({rows}, {columns}), "
                f"not {image.dtype} of shape {image.shape}"
            )
        self._picture = projected_light(self.world.projector, image)

    def capture(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Take a frame of the present setup.

        Returns
        -------
        (H, W) uint8 (8 bits) or uint16 (10 bits).
        """
        shot = exposure(
            self.world,
            self._light,
            exposure_us=self._exposure_us,
            bits=self._bits,
            lamp=self._lamp,
            frame=self._frames,
        )
        self._frames += 1
        return render(self.world.camera, self._picture, self.light_map(), shot)

    def trace(self) -> Trace:
        """Exact truth of the present setup (`sims.optics.trace`)."""
        return trace(self.world, self._setup)

    def light_map(self) -> LightMap:
        """Light map of the present setup, traced once and kept for the last few setups."""
        return self._maps.of(self._setup)

    def _change(self, **what: object) -> None:
        present = {name: getattr(self._setup, name) for name in Setup.__slots__}
        self._setup = Setup(**{**present, **what})  # type: ignore[arg-type]


def _check_travel(name: str, position_mm: float, low: float, high: float) -> None:
    if not _is_number(position_mm) or not low <= position_mm <= high:
        raise SimulationError(f"{name} travels from {low} to {high} mm, not to {position_mm!r}")


def _is_whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
