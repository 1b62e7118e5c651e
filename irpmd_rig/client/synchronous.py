"""The client for ordinary scripts."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from irpmd_rig.client import _calls as calls
from irpmd_rig.client._calls import Control, ExportForm, PictureFormat, Recipe
from irpmd_rig.client.connection import Connection
from irpmd_rig.client.errors import NotInTime, ServiceUnreachable
from irpmd_rig.client.settings import (
    array_of,
    has_ended,
    may_have_ended,
    succeeded,
)
from irpmd_rig.client.stream import Place
from irpmd_rig.service import models
from irpmd_rig.service.models import Event, Run
from irpmd_rig.store.entries import ManifestEntry


class Client(Connection):
    """The daemon of a rig.

    Every method raises `ProblemError` where the service refuses, and `ServiceUnreachable` where it does not answer.

    Parameters
    ----------
    url
        Address of the service; None: ``IRPMD_RIG_URL`` of the environment, else ``http://127.0.0.1:8321``.
    token
        Its token, or the file in which that is; None: the file that ``IRPMD_RIG_TOKEN`` names, else ``data/token``
        below the working folder.
    timeout_s
        Bound of an answer; commands that move something have a longer one.

    Attributes
    ----------
    lease_id : str or None
        Lease that is sent with every request; `take_lease` sets it.

    Raises
    ------
    TokenUnreadable, ClientError
        The file of the token cannot be read, or the address is none.
    """

    # --- the rig

    def health(self) -> models.Health:
        """Ask whether the service is alive; needs no token."""
        return self._send(calls.health())

    def rig(self) -> models.Rig:
        """Instruments, positions, lease, and every reason why a run would not begin now."""
        return self._send(calls.rig())

    def metrics(self) -> str:
        """Figures of the daemon, as Prometheus reads them."""
        return (self._send(calls.metrics(self.url))).decode()

    def stop(self) -> models.Stop:
        """Stop everything now; it is latched: nothing starts until `clear_stop`. Needs no lease."""
        return self._send(calls.stop())

    def clear_stop(self) -> None:
        """Allow starting again; the queue stays held."""
        self._send(calls.clear_stop())

    def take_lease(self, owner: str, duration_s: float = 600.0, *, override: bool = False) -> models.Lease:
        """Take control by hand; all further requests of this client carry the lease."""
        lease = self._send(calls.take_lease(owner, duration_s, override=override))
        self.lease_id = lease.id
        return lease

    def renew_lease(self, duration_s: float = 600.0) -> models.Lease:
        """Let the lease end so many seconds from now."""
        return self._send(calls.renew_lease(duration_s))

    def release_lease(self) -> None:
        """Give the lease back; the rig is made safe if it was commanded by hand."""
        self._send(calls.release_lease())
        self.lease_id = None

    @contextmanager
    def lease(self, owner: str, duration_s: float = 600.0, *, override: bool = False) -> Iterator[models.Lease]:
        """Hold the lease for the length of a ``with`` block."""
        lease = self.take_lease(owner, duration_s, override=override)
        try:
            yield lease
        finally:
            self.release_lease()

    # --- calibrations, references, recipes

    def calibrations(self) -> tuple[models.Calibration, ...]:
        """Calibrations that measurements may use, newest first."""
        return self._send(calls.calibrations())

    def references(self) -> tuple[models.Calibration, ...]:
        """References that measurements may use, newest first."""
        return self._send(calls.references())

    def activate_calibration(self, run_id: str) -> models.Calibration:
        """Let recipes that say ``active`` get this calibration."""
        return self._send(calls.activate(run_id, reference=False))

    def activate_reference(self, run_id: str) -> models.Calibration:
        """Let recipes that say ``active`` get this reference."""
        return self._send(calls.activate(run_id, reference=True))

    def recipes(self) -> tuple[models.Recipe, ...]:
        """Recipes that ship with the daemon."""
        return self._send(calls.recipes())

    def validate(self, recipe: Recipe) -> models.Validation:
        """Tell everything that is wrong with a recipe, and what it would take; nothing is run."""
        return self._send(calls.validate(recipe))

    # --- runs

    def submit(self, recipe: Recipe, *, idempotency_key: str | None = None) -> Run:
        """Let a run of a recipe wait in the queue.

        Parameters
        ----------
        recipe
            The path of a file, the name of a recipe that ships with the daemon, or YAML text.
        idempotency_key
            The same key gives the same run again, however often this is called.
        """
        return self._send(calls.submit(recipe, idempotency_key))

    def runs(self, limit: int = 100, before: str | None = None) -> tuple[Run, ...]:
        """Runs, newest first, at most 1000 at a time; `before`: only those older than the one of this id."""
        return self._send(calls.runs(limit, before))

    def run(self, run_id: str) -> Run:
        """One run, as it is now."""
        return self._send(calls.run(run_id))

    def act(
        self, run_id: str, action: Control, answer: Literal["done", "abort"] = "done", prompt: int | None = None
    ) -> Run:
        """Abort, pause, resume, answer (the prompt of that id, or whichever waits) or retry a run; needs the lease."""
        return self._send(calls.act(run_id, action, answer, prompt))

    def delete_run(self, run_id: str) -> None:
        """Delete an ended run with its folder."""
        self._send(calls.delete_run(run_id))

    def queue(self) -> models.Queue:
        """What waits, and whether it may start."""
        return self._send(calls.queue())

    def hold_queue(self) -> models.Queue:
        """Let no run start by itself."""
        return self._send(calls.queue_action("hold"))

    def resume_queue(self) -> models.Queue:
        """Let the queue go on."""
        return self._send(calls.queue_action("resume"))

    def carry_out(
        self,
        recipe: Recipe,
        *,
        activate: bool = False,
        on_event: Callable[[Event], None] | None = None,
        timeout_s: float | None = None,
    ) -> Run:
        """Submit a recipe, let the queue go on, and wait until the run has succeeded.

        Parameters
        ----------
        recipe, on_event, timeout_s
            As `submit` and `wait` take them.
        activate
            Let recipes that say ``active`` get this calibration or reference.

        Raises
        ------
        RunFailed
            It ended otherwise.
        NotInTime
            As `wait`.
        """
        run = self.submit(recipe)
        run = succeeded(self.wait(run.id, on_event=on_event, on_begin=self.resume_queue, timeout_s=timeout_s))
        if activate:
            self._send(calls.activate(run.id, reference=run.kind == "reference"))
        return run

    def wait(
        self,
        run_id: str,
        *,
        on_event: Callable[[Event], None] | None = None,
        on_begin: Callable[[], object] | None = None,
        timeout_s: float | None = None,
    ) -> Run:
        """Wait for the end of a run, over broken connections and starts of the daemon.

        Parameters
        ----------
        run_id
            Which run.
        on_event
            Is given what happens to it from now on.
        on_begin
            Called once, as soon as nothing of what happens is missed any more.
        timeout_s
            Bound; None: none. It is looked at whenever the service says anything, at least every quarter of a minute.

        Raises
        ------
        NotInTime
            It has not ended by then.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        for events in self._follow(run_id, Place()):
            if on_begin is not None:
                on_begin()
                on_begin = None
            for event in events:
                if on_event is not None:
                    on_event(event)
            run = self._ended(run_id) if may_have_ended(events) else None
            if run is not None:
                return run
            if end_s is not None and time.monotonic() > end_s:
                break
        raise NotInTime(f"run {run_id} has not ended within {timeout_s} s; it goes on")

    def events(
        self, run_id: str | None = None, *, after: int | None = None, limit: int | None = None
    ) -> Iterator[Event]:
        """Read what happens, over broken connections.

        Parameters
        ----------
        run_id
            Only what concerns this run; None: everything.
        after
            Id of the last event that was seen; None: only what comes from now on.
        limit
            End after so many events.
        """
        for events in self._follow(run_id, Place(after, limit)):
            yield from events

    # --- files

    def frames(self, run_id: str) -> tuple[ManifestEntry, ...]:
        """Frames of a run that count, oldest first, each with how it was taken."""
        return self._send(calls.frames(run_id))

    def results(self, run_id: str) -> tuple[models.ResultFile, ...]:
        """Files among the results of a run."""
        return self._send(calls.results(run_id))

    def result(self, run_id: str, name: str = "result.json") -> Any:
        """Content of a JSON file among the results of a run."""
        content: bytes = self._send(calls.result(run_id, name))
        return json.loads(content)

    def array(self, run_id: str, name: str) -> NDArray[Any]:
        """Array of an npy file among the results of a run; raises ClientError if it is none."""
        return array_of(self._send(calls.result(run_id, name)), name)

    def download(self, run_id: str, path: str, target: Path) -> Path:
        """Save a file of a run: ``results/points.ply``, say; whole or not at all.

        Parameters
        ----------
        run_id, path
            Which file: ``results/...`` or ``frames/...``.
        target
            Where to, or the folder into which it goes under its own name.

        Raises
        ------
        OSError
            It cannot be written.
        """
        return self._save(calls.file_path(run_id, path), target, path)

    def export(self, run_id: str, form: ExportForm, target: Path) -> Path:
        """Save a run in another format; as `download`."""
        return self._save(calls.export_path(run_id, form), target, f"{run_id}.{form}")

    # --- instruments, by whoever has the lease

    def camera_settings(self, **settings: Any) -> models.CameraInForce:
        """Set the camera: exposure_us, gain_db, pixel_format, region, frame_rate_hz; returns what is in force."""
        return self._send(calls.camera_settings(settings))

    def camera_frame(self) -> NDArray[Any]:
        """Take one frame, (H, W), with the settings given last."""
        return array_of(self._send(calls.camera_frame("npy")), "the frame")

    def camera_picture(self, form: PictureFormat = "png") -> bytes:
        """Take one frame as a file."""
        return self._send(calls.camera_frame(form))

    def projector_show(self, picture: Literal["white", "black", "fringes"], **fringes: Any) -> None:
        """Show white, black, or one step of fringes (count, step, steps, axis), and leave it on."""
        self._send(calls.projector("show", {"picture": picture, **fringes}))

    def projector_led(self, led: str, intensity: float) -> None:
        """Light one LED at a fraction of its full drive, all others off; 0 is off."""
        self._send(calls.projector("led", {"led": led, "intensity": intensity}))

    def projector_park(self, *, parked: bool = True) -> None:
        """Park the mirrors, or make them ready again."""
        self._send(calls.projector("park", {"parked": parked}))

    def stage_move(self, name: str, position_mm: float) -> models.Position:
        """Move a stage and wait until it stands there."""
        return self._send(calls.stage(name, "move", {"position_mm": position_mm}))

    def stage_home(self, name: str) -> models.Position:
        """Let a stage find its own zero."""
        return self._send(calls.stage(name, "home"))

    def stage_zero(self, name: str, position_mm: float, confirmed_by: str) -> models.Position:
        """Call the place where a stage stands `position_mm`, on the word of a person."""
        return self._send(calls.stage(name, "zero", {"position_mm": position_mm, "confirmed_by": confirmed_by}))

    def stage_stop(self, name: str) -> models.DeviceStop:
        """Stop a stage, whatever has it."""
        return self._send(calls.stage_stop(name))

    # --- inside

    def _ended(self, run_id: str) -> Run | None:
        """Return a run that has ended; None: it has not, or that cannot be asked just now."""
        try:
            run = self.run(run_id)
        except ServiceUnreachable:
            return None
        return run if has_ended(run) else None
