"""Every call of the service as a value: what is sent, and how the answer is read. Both clients send these."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar
from urllib.parse import quote

import httpx
from pydantic import TypeAdapter, ValidationError

from irpmd_rig.client.errors import ClientError
from irpmd_rig.service import models
from irpmd_rig.store.entries import ManifestEntry

Answer = TypeVar("Answer")
Recipe = str | Path
"""A recipe: the path of a YAML file, or the name of one that ships with the daemon, or YAML text (several lines)."""

# A stage may need a minute for its travel, a LED a second; the daemon bounds everything itself.
COMMAND_LIMIT_S = 120.0


@dataclass(frozen=True, slots=True)
class Call(Generic[Answer]):
    """One request.

    Attributes
    ----------
    method, path
        What is asked, below the address of the service.
    read
        Makes the result of the answer.
    body
        Sent as JSON; None: there is none.
    params, headers
        Of the request.
    timeout_s
        Bound of the answer, where the client's own is too short.
    """

    method: str
    path: str
    read: Callable[[httpx.Response], Answer]
    body: Mapping[str, Any] | None = None
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    timeout_s: float | None = None


def reader(kind: Any) -> Callable[[httpx.Response], Any]:
    """Read answers as values of a type."""
    adapter: TypeAdapter[Any] = TypeAdapter(kind)

    def read(response: httpx.Response) -> Any:
        try:
            return adapter.validate_json(response.content)
        except ValidationError as error:
            raise ClientError(f"an answer cannot be read: {error}; are client and daemon of one version?") from None

    return read


def nothing(response: httpx.Response) -> None:
    """Read an answer that says no more than that it is done."""
    del response


def content(response: httpx.Response) -> bytes:
    """Read an answer as it is."""
    return response.content


_RUN, _RUNS = reader(models.Run), reader(tuple[models.Run, ...])
_QUEUE, _LEASE, _RIG = reader(models.Queue), reader(models.Lease), reader(models.Rig)
_LIBRARY, _CALIBRATION = reader(tuple[models.Calibration, ...]), reader(models.Calibration)
_POSITION, _DEVICE_STOP, _CAMERA = reader(models.Position), reader(models.DeviceStop), reader(models.CameraInForce)
_STOP, _HEALTH, _VALIDATION = reader(models.Stop), reader(models.Health), reader(models.Validation)
_FRAMES = reader(tuple[ManifestEntry, ...])
_RECIPES, _FILES = reader(tuple[models.Recipe, ...]), reader(tuple[models.ResultFile, ...])

Control = Literal["abort", "pause", "resume", "answer", "retry"]
PictureFormat = Literal["tiff", "png", "npy"]
ExportForm = Literal["hdf5", "ply", "tiff", "png", "csv"]


# --- the rig


def health() -> Call[models.Health]:
    return Call("GET", "/health", _HEALTH)


def rig() -> Call[models.Rig]:
    return Call("GET", "/rig", _RIG)


def metrics(url: str) -> Call[bytes]:
    # At the root, where Prometheus looks.
    return Call("GET", str(httpx.URL(url).copy_with(path="/metrics")), content)


def stop() -> Call[models.Stop]:
    return Call("POST", "/stop", _STOP, timeout_s=COMMAND_LIMIT_S)


def clear_stop() -> Call[None]:
    return Call("DELETE", "/stop", nothing)


def take_lease(owner: str, duration_s: float, *, override: bool) -> Call[models.Lease]:
    return Call("POST", "/lease", _LEASE, {"owner": owner, "duration_s": duration_s, "override": override})


def renew_lease(duration_s: float) -> Call[models.Lease]:
    return Call("PUT", "/lease", _LEASE, {"duration_s": duration_s})


def release_lease() -> Call[None]:
    return Call("DELETE", "/lease", nothing, timeout_s=COMMAND_LIMIT_S)


# --- calibrations, references, recipes


def calibrations() -> Call[tuple[models.Calibration, ...]]:
    return Call("GET", "/calibrations", _LIBRARY)


def references() -> Call[tuple[models.Calibration, ...]]:
    return Call("GET", "/references", _LIBRARY)


def activate(run_id: str, *, reference: bool) -> Call[models.Calibration]:
    collection = "references" if reference else "calibrations"
    return Call("POST", f"/{collection}/{_part(run_id)}/activate", _CALIBRATION)


def recipes() -> Call[tuple[models.Recipe, ...]]:
    return Call("GET", "/recipes", _RECIPES)


def validate(recipe: Recipe) -> Call[models.Validation]:
    return Call("POST", "/recipes/validate", _VALIDATION, recipe_body(recipe))


# --- runs


def submit(recipe: Recipe, idempotency_key: str | None) -> Call[models.Run]:
    headers = {} if idempotency_key is None else {"Idempotency-Key": idempotency_key}
    return Call("POST", "/runs", _RUN, recipe_body(recipe), headers=headers)


def runs(limit: int, before: str | None) -> Call[tuple[models.Run, ...]]:
    params = {"limit": limit} | ({} if before is None else {"before": before})
    return Call("GET", "/runs", _RUNS, params=params)


def run(run_id: str) -> Call[models.Run]:
    return Call("GET", f"/runs/{_part(run_id)}", _RUN)


def act(run_id: str, action: Control, answer: str = "done", prompt: int | None = None) -> Call[models.Run]:
    body = {"action": action} | ({"answer": answer, "prompt": prompt} if action == "answer" else {})
    return Call("POST", f"/runs/{_part(run_id)}/actions", _RUN, body, timeout_s=COMMAND_LIMIT_S)


def delete_run(run_id: str) -> Call[None]:
    return Call("DELETE", f"/runs/{_part(run_id)}", nothing)


def frames(run_id: str) -> Call[tuple[ManifestEntry, ...]]:
    return Call("GET", f"/runs/{_part(run_id)}/frames", _FRAMES)


def results(run_id: str) -> Call[tuple[models.ResultFile, ...]]:
    return Call("GET", f"/runs/{_part(run_id)}/results", _FILES)


def result(run_id: str, name: str) -> Call[bytes]:
    return Call("GET", file_path(run_id, f"results/{name}"), content, timeout_s=COMMAND_LIMIT_S)


def queue() -> Call[models.Queue]:
    return Call("GET", "/queue", _QUEUE)


def queue_action(action: Literal["hold", "resume"]) -> Call[models.Queue]:
    return Call("POST", "/queue/actions", _QUEUE, {"action": action})


# --- instruments


def camera_settings(settings: Mapping[str, Any]) -> Call[models.CameraInForce]:
    return Call("POST", "/devices/camera/settings", _CAMERA, settings, timeout_s=COMMAND_LIMIT_S)


def camera_frame(form: PictureFormat) -> Call[bytes]:
    params = {"format": form}
    return Call("POST", "/devices/camera/frame", content, params=params, timeout_s=COMMAND_LIMIT_S)


def projector(command: Literal["show", "led", "park"], body: Mapping[str, Any]) -> Call[None]:
    return Call("POST", f"/devices/projector/{command}", nothing, body, timeout_s=COMMAND_LIMIT_S)


def stage(
    name: str, command: Literal["move", "home", "zero"], body: Mapping[str, Any] | None = None
) -> Call[models.Position]:
    return Call("POST", f"/devices/{_part(name)}/{command}", _POSITION, body, timeout_s=COMMAND_LIMIT_S)


def stage_stop(name: str) -> Call[models.DeviceStop]:
    return Call("POST", f"/devices/{_part(name)}/stop", _DEVICE_STOP, timeout_s=COMMAND_LIMIT_S)


# --- parts


def recipe_body(recipe: Recipe) -> dict[str, str]:
    """Send a file's text or a text, or name a recipe of the daemon.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    if isinstance(recipe, Path):
        return {"text": recipe.read_text(encoding="utf-8")}
    # One word is no recipe: a recipe has a kind and a name at least.
    return {"recipe": recipe} if recipe and not any(mark in recipe for mark in ":\n{") else {"text": recipe}


def events_path(run_id: str | None) -> str:
    """Address of the events of one run, or of everything."""
    return "/events" if run_id is None else f"/runs/{_part(run_id)}/events"


def export_path(run_id: str, form: str) -> str:
    """Address of a run in another format."""
    return f"/runs/{_part(run_id)}/exports/{_part(form)}"


def file_path(run_id: str, path: str) -> str:
    """Address of a file of a run: ``frames/...`` or ``results/...``."""
    return f"/runs/{_part(run_id)}/" + "/".join(_part(part) for part in path.split("/"))


def _part(text: str) -> str:
    """Make a text one part of an address, whatever is in it."""
    return quote(text, safe="")
