"""Everything that was taken, by what it was for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from irpmd_rig.bench.accuracy_truth import Truth
from irpmd_rig.reproduce.scheme import Task
from irpmd_rig.reproduce.taken import NO_STEPS, Steps, Taken

Content = Mapping[str, Any]

OURS = "facets"
DEPTH_EQUATION = "depth-equation"


@dataclass(frozen=True, slots=True)
class Entry:
    """A line of the list of runs.

    Attributes
    ----------
    task
        What was asked for.
    run_id
        Folder of the run.
    recipe_file
        Where its recipe lies.
    """

    task: Task
    run_id: str
    recipe_file: str


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """What a reproduction found.

    Attributes
    ----------
    seed, size_px
        Of the world, of the camera.
    world
        Content of the world file.
    truth
        Of the mirror step in the world as it is drawn.
    calibrations
        By key, as `irpmd_rig.reproduce.scheme.Task` has it; of several of one key the first.
    measurements
        In the order in which they were taken.
    runs
        All of them.
    seconds
        How long it took.
    """

    seed: int
    size_px: int
    world: Content
    truth: Truth
    calibrations: Mapping[str, tuple[str, Content]]
    measurements: Sequence[Taken]
    runs: Sequence[Entry]
    seconds: float

    def of(self, use: str, subject: str) -> Taken | None:
        """First measurement of an object for a use; None if there is none."""
        return next((m for m in self.measurements if (m.task.use, m.task.subject) == (use, subject)), None)

    def all_of(self, use: str) -> list[Taken]:
        """Every measurement for a use."""
        return [m for m in self.measurements if m.task.use == use]


def steps_of(taken: Taken | None, method: str) -> Steps:
    """Steps of a measurement by a method; without any where there are none."""
    return NO_STEPS if taken is None else taken.steps.get(method, NO_STEPS)
