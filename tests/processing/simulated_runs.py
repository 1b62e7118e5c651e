"""Run folders as a daemon would leave them: the plan of a recipe, carried out on the simulated rig."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from irpmd_rig.core import fringe_images
from irpmd_rig.recipes.models import Recipe
from irpmd_rig.recipes.plan import Shot, Station, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.store import Fringes, Library, ManifestEntry, Optics, RunFolder, RunRecord, RunState, Store, Transition
from sims.rig import SimulatedRig
from sims.world import World

SERIAL = "XM-0001"
SIZE_PX = 384
NOMINAL_MM = (3.9868, 7.0248, 5.0062, 6.0986)
"""Steps of the world's object mirror_step_y: the paper, Table 2."""


def rig_part(world: World) -> dict:
    """What a rig file says of this world: nominal places, misalignments excluded."""
    camera, glass, board = world.camera, world.glass, world.board
    return {
        "name": "simulated rig",
        "drawing": {
            "camera_xy_mm": list(camera.position_mm[:2]),
            "heading": list(camera.axis[:2]),
            "d_point_mm": list(glass.centre_mm[:2]),
        },
        "checkerboard": {"squares": list(board.squares), "square_mm": board.square_mm},
        "stage1": {"driver": "serial", "in_position_mm": 0.01},
        "calibration": {"max_age_days": None},
    }


@dataclass
class SimulatedRuns:
    """A store whose runs are taken on a simulated rig."""

    store: Store
    rig: SimulatedRig
    # Whether frames are said to have been checked when they were taken; if not, it is done when they are computed.
    checked: bool = True
    # The stages stand where they were sent last.
    _at_mm: dict[str, float] = field(default_factory=lambda: {"stage1": 0.0, "stage2": 0.0})

    @property
    def library(self) -> Library:
        return Library(self.store)

    def take(self, text: str, after_station: Callable[[RunFolder, int], None] | None = None) -> RunFolder:
        """Take all frames of a recipe; the run is left as `reconstructing`."""
        recipe, _ = read_recipe(text)
        folder = self.store.create_run(self._record(recipe), Transition(RunState.QUEUED), text)
        for state in (RunState.PREPARING, RunState.RUNNING):
            folder.append_state(Transition(state))
        for station in plan(recipe).stations:
            self._arrange(station)
            self._expose(station)
            for shot in station.shots:
                self._shoot(folder, station, shot)
            folder.flush()
            if after_station is not None:
                after_station(folder, station.index)
        folder.append_state(Transition(RunState.RECONSTRUCTING))
        folder.close()
        return folder

    def succeeded(self, folder: RunFolder) -> None:
        """Let a run succeed, and activate it if it is a calibration or reference."""
        folder.append_state(Transition(RunState.SUCCEEDED))
        if folder.record().kind != "measure":
            self.library.activate(folder.id)

    def _record(self, recipe: Recipe) -> RunRecord:
        fringes = getattr(recipe, "fringes", None)
        return RunRecord(
            kind=recipe.kind,
            name=recipe.name,
            nominal_steps_mm=recipe.nominal_steps_mm,
            fringes=fringes and Fringes(counts=fringes.counts, steps=fringes.steps),
            positions_mm=getattr(recipe, "positions_mm", ()),
            optics=Optics(camera_serial=SERIAL, size_px=self.rig.world.camera.size_px),
            recipe=recipe.model_dump(mode="json"),
            rig=rig_part(self.rig.world),
        )

    def _arrange(self, station: Station) -> None:
        scene = station.prompt.scene if station.prompt else None
        if scene is not None:
            self.rig.set_glass(scene.glass)
            self.rig.set_lamp(scene.lamp)
            self.rig.place(scene.subject, pose=scene.pose)
        for name, target in (("stage1", station.stage1_mm), ("stage2", station.stage2_mm)):
            if target is not None and target != self._at_mm[name]:
                getattr(self.rig, f"move_{name}")(target)
                self._at_mm[name] = target

    def _expose(self, station: Station) -> None:
        """So that the brightest parts reach 85 % of full scale."""
        camera = self.rig.world.camera
        picture = self._white() if station.lit else None
        self.exposure_us, bright = camera.exposure_us * 4, np.inf
        while bright >= 2**camera.bits - 1:
            self.exposure_us /= 4
            self.rig.set_exposure(self.exposure_us)
            bright = np.percentile(self._frame(picture), 99.5)
        self.exposure_us *= 0.85 * (2**camera.bits - 1) / bright
        self.rig.set_exposure(self.exposure_us)

    def _shoot(self, folder: RunFolder, station: Station, shot: Shot) -> None:
        entry = ManifestEntry(
            station=station.index,
            label=shot.label,
            role=shot.role,
            orientation=shot.orientation,
            view=shot.view,
            counts=shot.counts or None,
            steps=shot.steps or None,
            stage1_mm=self._at_mm["stage1"],
            stage1_measured=True,
            stage2_mm=self._at_mm["stage2"],
            exposure_us=self.exposure_us,
            led="infrared",
            bits=self.rig.world.camera.bits,
            checks={"ok": True} if self.checked else {},
        )
        if shot.role == "fringes":
            patterns = fringe_images(shot.counts, shot.steps, self.rig.world.projector.size_px, shot.orientation)
            for number, patterns_of_set in enumerate(patterns):
                for step, pattern in enumerate(patterns_of_set):
                    folder.write_frame(self._frame(pattern), entry.model_copy(update={"set": number, "step": step}))
        else:
            folder.write_frame(self._frame(self._white() if shot.role == "white" else None), entry)

    def _frame(self, picture: np.ndarray | None) -> np.ndarray:
        self.rig.show(picture)
        return self.rig.capture()

    def _white(self) -> np.ndarray:
        width, height = self.rig.world.projector.size_px
        return np.full((height, width), 255, dtype=np.uint8)
