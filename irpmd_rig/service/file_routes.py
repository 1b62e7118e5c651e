"""Frames, results and exports of a run, as files."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.background import BackgroundTask
from starlette.responses import FileResponse, Response

from irpmd_rig.report.policy import POLICY
from irpmd_rig.service.desk import Desk, TheDesk
from irpmd_rig.service.documented import DISK, RUN, binary, problems
from irpmd_rig.service.models import ResultFile
from irpmd_rig.service.pictures import MEDIA_TYPES, PictureFormat, encoded
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.export import SUFFIXES, export_run
from irpmd_rig.store.frame_file import FRAMES, read_image

router = APIRouter(prefix="/runs/{run_id}", tags=["files"])

Export = Literal["hdf5", "ply", "tiff", "png", "csv"]

_TYPES = {
    ".tif": "image/tiff",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".npy": MEDIA_TYPES["npy"],
    ".npz": "application/x-npz",
    ".ply": "application/x-ply",
    ".csv": "text/csv",
    ".json": "application/json",
    ".html": "text/html",
    ".h5": "application/x-hdf5",
}
_OTHER = "application/octet-stream"
_HEADERS = {"Content-Security-Policy": "default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox"}
# A report is a page: it may show what is in it, and run the one script that turns a surface, known by its hash.
_REPORT_HEADERS = {"Content-Security-Policy": f"{POLICY}; sandbox allow-scripts"}


@router.get("/frames", responses=problems(*RUN, "invalid"))
async def frames(desk: TheDesk, run_id: str) -> tuple[ManifestEntry, ...]:
    """Frames that count, oldest first, each with how it was taken."""
    return await desk.filing(lambda: desk.daemon.store.run(run_id).manifest())


@router.get(
    "/frames/{path:path}",
    response_class=Response,
    responses=binary(*MEDIA_TYPES.values()) | problems(*RUN, "no-such-file", "invalid"),
)
async def frame(
    desk: TheDesk, run_id: str, path: str, form: Annotated[PictureFormat, Query(alias="format")] = "tiff"
) -> Response:
    """One frame by its path below `frames`; TIFF as it is on disk, or turned into PNG or npy."""
    file = await desk.filing(lambda: desk.daemon.store.run(run_id).file(f"{FRAMES}/{path}"))
    if form == "tiff":
        return _sent(file, file.name)
    content = await desk.filing(lambda: encoded(read_image(file), form))
    return Response(content, media_type=MEDIA_TYPES[form], headers=_HEADERS)


@router.get("/results", responses=problems(*RUN, "invalid"))
async def results(desk: TheDesk, run_id: str) -> tuple[ResultFile, ...]:
    """Files among the results; they are there when the run has ended."""

    def listed() -> tuple[ResultFile, ...]:
        found = desk.daemon.store.run(run_id).results
        paths = [found.path(name) for name in found.names() if (found.folder / name).is_file()]
        return tuple(
            ResultFile(name=path.name, bytes=path.stat().st_size, media_type=_media_type(path)) for path in paths
        )

    return await desk.filing(listed)


@router.get(
    "/results/{name}",
    response_class=Response,
    responses=binary(*_TYPES.values(), _OTHER) | problems(*RUN, "no-such-file", "invalid"),
)
async def result(desk: TheDesk, run_id: str, name: str) -> Response:
    """One result: map, points, table, picture, report."""
    file = await desk.filing(lambda: desk.daemon.store.run(run_id).results.path(name))
    return _sent(file, file.name)


@router.get(
    "/exports/{form}",
    response_class=Response,
    responses=binary(*_TYPES.values()) | problems(*RUN, *DISK, "nothing-to-export", "no-such-file", "invalid"),
)
async def export(desk: TheDesk, run_id: str, form: Export) -> Response:
    """Frames and results as HDF5 (NeXus), or the result as points, depth map, picture or step table."""
    folder, file = await desk.filing(_exported, desk, run_id, form)
    return _sent(file, file.name, BackgroundTask(shutil.rmtree, folder, ignore_errors=True))


def _exported(desk: Desk, run_id: str, form: Export) -> tuple[Path, Path]:
    run = desk.daemon.store.run(run_id)
    # On the disk of the store, whose room is known; named so that a later start clears away what is left behind.
    folder = Path(tempfile.mkdtemp(prefix=".new-export-", dir=desk.daemon.store.root))
    try:
        return folder, export_run(run, form, folder / f"{run_id}{SUFFIXES[form]}")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _sent(file: Path, name: str, after: BackgroundTask | None = None) -> FileResponse:
    page = file.suffix == ".html"
    return FileResponse(
        file,
        media_type=_media_type(file),
        headers=_REPORT_HEADERS if page else _HEADERS,
        filename=name,
        background=after,
        content_disposition_type="inline" if page else "attachment",
    )


def _media_type(file: Path) -> str:
    return _TYPES.get(file.suffix, _OTHER)
