"""The whole chain once: calibration from scratch, reference and a measurement, taken on the simulated rig.

`chain` is the paper's, with a geometry at one position; `rig_chain` has one at several, and what then is possible.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from simulated_runs import NOMINAL_MM, SIZE_PX, SimulatedRuns

from irpmd_rig.processing import ProcessedRun
from irpmd_rig.processing.process import Processor
from irpmd_rig.store import RunFolder, Store
from sims.rig import SimulatedRig
from sims.world import load_world

WORLD = Path(__file__).parents[2] / "configs" / "worlds" / "aligned.yaml"

RECIPES = (
    "{kind: calibrate-camera, name: camera, poses: 16}",
    "{kind: calibrate-plate, name: plate, positions_mm: [0, 20, 40, 60, 80, 100, 120, 140, 160, 180, 200]}",
    "{kind: calibrate-geometry, name: geometry, positions_mm: [0]}",
    "{kind: reference, name: reference, positions_mm: [0, 40]}",
    f"{{kind: measure, name: a mirror step, object: mirror_step_y, nominal_steps_mm: {list(NOMINAL_MM)}}}",
)


@dataclass(frozen=True)
class Chain:
    """Runs by kind, and what came out of each."""

    runs: SimulatedRuns
    folders: dict[str, RunFolder]
    processed: dict[str, ProcessedRun]
    told: list[tuple[str, float, str | None]]

    def content(self, kind: str) -> dict:
        name = "result.json" if kind == "measure" else "calibration.json"
        return self.folders[kind].results.read_json(name)


RIG_RECIPES = (
    "{kind: calibrate-geometry, name: rig, positions_mm: [0, -60, 40]}",
    "{kind: reference, name: reference, positions_mm: [0, 40]}",
    "{kind: measure, name: by all methods, object: mirror_step_y, max_chi2: 10, "
    f"nominal_steps_mm: {list(NOMINAL_MM)}, compare: [triangulation, generalised, depth-equation]}}",
)


@pytest.fixture(scope="session")
def rig_chain(chain: Chain, tmp_path_factory: pytest.TempPathFactory) -> Chain:
    """The same rig and calibrations of camera and plate, in a store of its own."""
    root = tmp_path_factory.mktemp("rig") / "data"
    shutil.copytree(chain.runs.store.root, root)
    runs = SimulatedRuns(Store(root), SimulatedRig(chain.runs.rig.world))
    return carried_out(Chain(runs, {}, {}, []), RIG_RECIPES)


@pytest.fixture(scope="session")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    world = load_world(WORLD).with_camera_size(SIZE_PX)
    runs = SimulatedRuns(Store(tmp_path_factory.mktemp("data")), SimulatedRig(world))
    return carried_out(Chain(runs, {}, {}, []), RECIPES)


def carried_out(chain: Chain, recipes: tuple[str, ...]) -> Chain:
    """Take and compute runs one after the other, each with those before it."""
    runs, processor = chain.runs, Processor(2)
    for text in recipes:
        folder = runs.take(text, lambda folder, station: processor.decode(folder, runs.library, station))
        kind = folder.record().kind
        chain.told.clear()
        chain.processed[kind] = processor.process(
            folder, runs.library, lambda p: chain.told.append((p.text, p.fraction, p.file))
        )
        runs.succeeded(folder)
        chain.folders[kind] = folder
    return chain
