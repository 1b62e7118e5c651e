"""A lab for the accuracy bench: recipes carried out in a simulated world without instruments, computed in-process."""

from __future__ import annotations

import json
import logging
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import fringe_images
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.processing.process import Processor
from irpmd_rig.programs import module_command, module_environment
from irpmd_rig.recipes.models import Recipe
from irpmd_rig.recipes.plan import plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.recipes.stations import Shot, Station
from irpmd_rig.store import Fringes, Library, ManifestEntry, Optics, RunFolder, RunRecord, RunState, Store, Transition

SERIAL = "simulated"
_PROJECTOR_PX = (1024, 768)
_WHITE = 0
_LED = "infrared"  # of recipes that name no light
_REQUEST, _PATTERNS, _FRAMES = "request.json", "patterns.npy", "frames"

_log = logging.getLogger(__name__)

Content = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Order:
    """One run to be taken.

    Attributes
    ----------
    recipe
        As text.
    world
        World file.
    rig
        What a rig file says of it.
    noise_seed
        Of the run's noise.
    """

    recipe: str
    world: Path
    rig: Content
    noise_seed: int


AnyOrder = TypeVar("AnyOrder", bound=Order)


@dataclass(frozen=True, slots=True)
class Done:
    """A run that was taken and computed.

    Attributes
    ----------
    recipe
        What was carried out.
    content
        Its `result.json` or `calibration.json`; empty for a measurement that could not be computed.
    folder
        Its folder, with results; its frames are deleted as soon as the next run is asked for.
    """

    recipe: Recipe
    content: Content
    folder: RunFolder


class Lab:
    """Takes runs one after the other; while one is computed, the frames of the next are rendered.

    Parameters
    ----------
    folder
        Where everything lies; whoever made it deletes it.
    size_px
        Columns of the camera.
    threads
        For what is computed.
    """

    def __init__(self, folder: Path, size_px: int, threads: int) -> None:
        self._folder = folder
        self._size_px = size_px
        self._store = Store(folder / "data")
        self._library = Library(self._store)
        self._processor = Processor(threads)
        self._rendered = 0

    def carry_out(self, orders: Iterable[AnyOrder]) -> Iterator[tuple[AnyOrder, Done]]:
        """Carry out orders in turn; every calibration and reference is activated for what follows.

        Raises
        ------
        MeasurementError
            A world that cannot be simulated.
        ProcessingError
            A calibration or reference that cannot be computed.
        """
        with ThreadPoolExecutor(1) as renderer:
            ahead: tuple[AnyOrder, Future[Path]] | None = None
            for order in orders:
                following = order, renderer.submit(self._render, order)
                if ahead is not None:
                    yield from self._computed(*ahead)
                ahead = following
            if ahead is not None:
                yield from self._computed(*ahead)

    def _computed(self, order: AnyOrder, rendered: Future[Path]) -> Iterator[tuple[AnyOrder, Done]]:
        folder, recipe = self._taken(order, rendered.result())
        try:
            yield order, self._compute(folder, recipe)
        finally:
            shutil.rmtree(folder.path / "frames")

    def _render(self, order: Order) -> Path:
        """Frames of all stations of an order, in a folder."""
        recipe, _ = read_recipe(order.recipe)
        stations = plan(recipe).stations
        patterns = _Patterns()
        request = {"patterns": _PATTERNS, "stations": [_asked(station, patterns, _led(recipe)) for station in stations]}
        self._rendered += 1
        folder = self._folder / f"rendered-{self._rendered}"
        folder.mkdir()
        (folder / _REQUEST).write_text(json.dumps(request))
        np.save(folder / _PATTERNS, np.concatenate(patterns.images))
        command = module_command("sims", "frames", str(order.world), str(folder / _REQUEST))
        command += ["--out", str(folder / _FRAMES), "--seed", str(order.noise_seed), "--size-px", str(self._size_px)]
        run_sims(command)
        return folder

    def _taken(self, order: Order, rendered: Path) -> tuple[RunFolder, Recipe]:
        """Put rendered frames into the folder of a run."""
        recipe, _ = read_recipe(order.recipe)
        folder = self._store.create_run(self._record(recipe, order), Transition(RunState.QUEUED), order.recipe)
        for state in (RunState.PREPARING, RunState.RUNNING):
            folder.append_state(Transition(state))
        taken = json.loads((rendered / _FRAMES / "frames.json").read_text())["stations"]
        for station, state in zip(plan(recipe).stations, taken, strict=True):
            frames = np.load(rendered / _FRAMES / state["file"], mmap_mode="r")
            for frame, entry in zip(frames, _entries(station, state, _led(recipe)), strict=True):
                folder.write_frame(np.array(frame), entry)
            folder.flush()
        shutil.rmtree(rendered)
        return folder, recipe

    def _compute(self, folder: RunFolder, recipe: Recipe) -> Done:
        folder.append_state(Transition(RunState.RECONSTRUCTING))
        try:
            with folder:
                self._processor.process(folder, self._library, lambda _: None)
        except ProcessingError as error:
            if recipe.kind != "measure":
                raise
            _log.warning("%s could not be measured: %s", recipe.name, error)
            return Done(recipe, {}, folder)
        folder.append_state(Transition(RunState.SUCCEEDED))
        if recipe.kind == "measure":
            return Done(recipe, folder.results.read_json("result.json"), folder)
        self._library.activate(folder.id)
        return Done(recipe, folder.results.read_json("calibration.json"), folder)

    def _record(self, recipe: Recipe, order: Order) -> RunRecord:
        fringes = getattr(recipe, "fringes", None)
        return RunRecord(
            kind=recipe.kind,
            name=recipe.name,
            fringes=fringes and Fringes(counts=fringes.counts, steps=fringes.steps),
            positions_mm=getattr(recipe, "positions_mm", ()),
            optics=Optics(camera_serial=SERIAL, size_px=(self._size_px, self._size_px)),
            nominal_steps_mm=recipe.nominal_steps_mm,
            recipe=recipe.model_dump(mode="json"),
            rig=dict(order.rig),
        )


def run_sims(command: list[str]) -> None:
    """Run a program of the simulator; raises MeasurementError with its complaint."""
    ended = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        env=module_environment(),
    )
    if ended.returncode:
        raise MeasurementError(ended.stderr.strip().removeprefix("error: ") or f"{command[4]} of the simulator failed")


class _Patterns:
    """Pictures of a run: white, and every set of fringes once."""

    def __init__(self) -> None:
        width, height = _PROJECTOR_PX
        self.images: list[NDArray[np.uint8]] = [np.full((1, height, width), 255, np.uint8)]
        self._first: dict[tuple[tuple[float, ...], int, str], int] = {}

    def of(self, shot: Shot) -> list[int | None]:
        """Numbers of the pictures of a shot; None for black."""
        if shot.role == "white":
            return [_WHITE]
        if shot.role != "fringes":
            return [None]
        key = shot.counts, shot.steps, shot.orientation
        if key not in self._first:
            self._first[key] = sum(len(images) for images in self.images)
            images = fringe_images(shot.counts, shot.steps, _PROJECTOR_PX, shot.orientation)
            self.images.append(images.reshape(-1, *images.shape[2:]))
        first = self._first[key]
        return list(range(first, first + shot.frames))


def _led(recipe: Recipe) -> str:
    return _LED if recipe.light is None else recipe.light.led


def _asked(station: Station, patterns: _Patterns, led: str) -> dict[str, Any]:
    scene = station.prompt.scene if station.prompt is not None else None
    return {
        "scene": scene and {"subject": scene.subject, "pose": scene.pose, "glass": scene.glass, "lamp": scene.lamp},
        "stage1_mm": station.stage1_mm,
        "stage2_mm": station.stage2_mm,
        "light": "infrared" if led == "infrared" else "visible",
        "exposure_us": None if station.exposure_us == "auto" else station.exposure_us,
        "metered_on": _WHITE if station.lit else None,
        "pictures": [picture for shot in station.shots for picture in patterns.of(shot)],
    }


def _entries(station: Station, state: Content, led: str) -> Iterator[ManifestEntry]:
    """Manifest lines of a station's frames, in the order in which they were asked for."""
    for shot in station.shots:
        entry = ManifestEntry(
            station=station.index,
            label=shot.label,
            role=shot.role,
            orientation=shot.orientation,
            view=shot.view,
            counts=shot.counts or None,
            steps=shot.steps or None,
            stage1_mm=state["stage1_mm"],
            stage1_measured=True,
            stage2_mm=state["stage2_mm"],
            exposure_us=state["exposure_us"],
            led=led,
            bits=state["bits"],
            checks={"ok": True},
        )
        if shot.role != "fringes":
            yield entry
            continue
        for number in range(shot.frames):
            yield entry.model_copy(update={"set": number // shot.steps, "step": number % shot.steps})
