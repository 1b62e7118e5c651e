"""Recipes of the reproduction, as texts: a lab carries out the same ones on its rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isqrt

VISIBLE = "green"
"""LED that stands for visible light."""

_OTHERS = ("generalised", "triangulation", "facets")
_TAIL = "exposure_us: auto               # so that nothing saturates\npixel_format: Mono8\n"


@dataclass(frozen=True, slots=True)
class Way:
    """How something is measured: fringes, stage positions and method.

    Attributes
    ----------
    name
        In names of recipes and in what is said of them.
    steps
        Phase steps of a set.
    positions_mm
        Of stage1.
    method
        Of reconstruction; the others are computed beside it as far as they can be.
    counts
        Periods across the projector, the finest first.
    """

    name: str
    steps: int
    positions_mm: tuple[float, float]
    method: str
    counts: tuple[int, int, int] = (64, 63, 56)

    @property
    def _fringes(self) -> str:
        return f"fringes:\n  counts: {list(self.counts)}\n  steps: {self.steps}\n"

    def plate(self, positions_mm: Sequence[float]) -> str:
        """White plate at positions of stage2."""
        return (
            f"kind: calibrate-plate\nname: Plate, {len(positions_mm)} positions\n"
            f"positions_mm: {list(positions_mm)}\n{self._fringes}{_TAIL}"
        )

    def geometry(self) -> str:
        """Reference plane, glass and rig model, from the sprayed mirror."""
        return (
            f"kind: calibrate-geometry\nname: Geometry, {self.name}\n"
            f"positions_mm: [0, -40, -80, 40]\n{self._fringes}{_TAIL}"
        )

    def reference(self, led: str = "") -> str:
        """Reference mirror at the positions of the measurements."""
        return (
            f"kind: reference\nname: Reference, {self.name}{_in(led)}\n"
            f"positions_mm: {list(self.positions_mm)}\n{self._fringes}{_light(led)}{_TAIL}"
        )

    def measure(self, subject: str, nominal_mm: Sequence[float] = (), led: str = "") -> str:
        """Measure an object; a calibration that is off is marked, for the error is what is asked for."""
        filtered = "phase_filter: true              # as in the paper; it stays inside facets\n"
        paper = self.method == "depth-equation"
        others = _OTHERS if paper else ("triangulation",)
        return (
            f"kind: measure\nname: {subject}, {self.name}{_in(led)}\nobject: {subject}\n"
            f"positions_mm: {list(self.positions_mm)}\n{self._fringes}method: {self.method}\n"
            f"{filtered if paper else ''}compare: [{', '.join(others)}]\nif_calibration_is_off: mark\n"
            f"{f'nominal_steps_mm: {list(nominal_mm)}' + chr(10) if nominal_mm else ''}{_light(led)}{_TAIL}"
        )


CAMERA = f"kind: calibrate-camera\nname: Camera, 30 poses of the board\nposes: 30\nplate_mm: 100.0\n{_TAIL}"

PAPER = Way("the paper's recipe", 4, (0.0, 40.0), "depth-equation")
"""Four steps, positions 0 and 40 mm, the depth equation on filtered phases; the other methods beside it."""
PRECISE = Way("precise", 8, (-60.0, 40.0), "facets")
"""Eight steps, a baseline of 100 mm, facet by facet."""


def paper_with(count: int) -> Way:
    """Return the paper's recipe with another optimum set of fringe counts: N, N - 1, N - sqrt(N).

    Parameters
    ----------
    count
        Of the finest set, a square.
    """
    return Way(f"{count} fringes", 4, PAPER.positions_mm, PAPER.method, (count, count - 1, count - isqrt(count)))


def _light(led: str) -> str:
    return f"light: {{led: {led}, intensity: 0.6}}\n" if led else ""


def _in(led: str) -> str:
    return f", {led} light" if led else ""
