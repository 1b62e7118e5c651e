"""A run as one HDF5 file by the conventions of NeXus (https://manual.nexusformat.org), made from its folder.

/entry (NXentry)                title, times, identifier, recipe
/entry/user, /entry/sample
/entry/instrument/camera        NXdetector: data (frames, H, W), count_time
/entry/instrument/stage1, ...   NXpositioner: value per frame
/entry/instrument/projector     NXcollection: fringe set, step, count, light per frame
/entry/frames (NXdata)          the frames again, as a link: the default plot where there is no result
/entry/process (NXprocess)      an NXdata for every map among the results: the first depth map is the default plot
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, BinaryIO

import h5py
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import ExportError
from irpmd_rig.store.record import RunRecord, software_versions
from irpmd_rig.store.run_folder import RunFolder

# Names carry their unit as the last part.
_UNITS = ("mm", "um", "rad", "deg", "px", "dn", "us", "s")
_TEXT = h5py.string_dtype()


class _Patient(io.RawIOBase):
    """A stream that keeps a write error to itself until it is asked: HDF5 crashes the process if it meets one."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def write(self, content: Any) -> int:
        try:
            if self.error is None:
                self._stream.write(content)
                self._stream.flush()
        except OSError as error:
            self.error = error
        return memoryview(content).nbytes

    def readinto(self, content: Any) -> int:
        return self._stream.readinto(content)  # type: ignore[attr-defined, no-any-return]

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def truncate(self, size: int | None = None) -> int:
        return self._stream.truncate(size)

    def flush(self) -> None:
        """Every write is flushed already."""


def write_nexus(stream: BinaryIO, folder: RunFolder) -> None:
    """Write a run as HDF5, frame by frame.

    Parameters
    ----------
    stream
        Open for writing and reading.
    folder
        The run.

    Raises
    ------
    RunFolderError, ExportError
        If the run cannot be read, or its frames differ in size or type.
    OSError
        If the disk refuses.
    """
    patient = _Patient(stream)
    try:
        with h5py.File(patient, "w") as file:
            _write(file, folder, patient)
    finally:
        # Whatever else went wrong after it went wrong because of it.
        if patient.error is not None:
            raise patient.error


def _write(file: h5py.File, folder: RunFolder, patient: _Patient) -> None:
    entries, record = folder.manifest(), folder.record()
    file.attrs.update(NX_class="NXroot", default="entry", creator="irpmd-rig", file_time=_now())
    file.attrs.update(HDF5_Version=h5py.version.hdf5_version, h5py_version=h5py.__version__)
    entry = _group(file, "entry", "NXentry")
    _describe(entry, record, folder, entries)
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = str(record.rig.get("name", "phase-measuring deflectometry"))
    if entries:
        _write_stages(instrument, entries)
        _write_light(instrument, entries)
        _write_camera(_group(instrument, "camera", "NXdetector"), record, folder, entries, patient)
        _link_frames(entry, len(entries))
    _write_results(entry, record, folder)


def _describe(entry: h5py.Group, record: RunRecord, folder: RunFolder, entries: Sequence[ManifestEntry]) -> None:
    texts = {
        "title": record.name or f"{record.kind} {folder.id}",
        "entry_identifier": folder.id,
        "experiment_description": f"infrared phase-measuring deflectometry: {record.kind}",
        "program_name": "irpmd-rig",
    }
    for name, text in texts.items():
        entry[name] = text
    entry["program_name"].attrs["version"] = record.versions.get("irpmd-rig", "")
    times = [frame.time for frame in entries if frame.time is not None]
    if times:
        entry["start_time"], entry["end_time"] = min(times).isoformat(), max(times).isoformat()
    elif record.created is not None:
        entry["start_time"] = record.created.isoformat()
    if record.operator:
        _group(entry, "user", "NXuser")["name"] = record.operator
    if record.sample:
        _group(entry, "sample", "NXsample")["name"] = record.sample
    _note(entry, "notes", "text/plain", record.notes)
    _note(entry, "recipe", "application/yaml", folder.recipe_text() or "")
    _note(entry, "run", "application/json", record.model_dump_json())


def _note(parent: h5py.Group, name: str, kind: str, text: str) -> None:
    if text:
        note = _group(parent, name, "NXnote")
        note["type"], note["data"] = kind, text


def _write_stages(instrument: h5py.Group, entries: Sequence[ManifestEntry]) -> None:
    for name in ("stage1", "stage2"):
        positions = _column(entries, f"{name}_mm")
        if np.isnan(positions).all():
            continue
        stage = _group(instrument, name, "NXpositioner")
        stage["name"] = name
        stage["value"] = positions
        stage["value"].attrs["units"] = "mm"
        stage["measured"] = np.array([getattr(frame, f"{name}_measured") for frame in entries], dtype=np.uint8)


def _write_light(instrument: h5py.Group, entries: Sequence[ManifestEntry]) -> None:
    """What was shown, frame by frame; -1 stands for none among whole numbers, NaN among others."""
    light = _group(instrument, "projector", "NXcollection")
    for name in ("station", "set", "step", "steps", "view"):
        light[name] = np.array([-1 if (value := getattr(frame, name)) is None else value for frame in entries])
    for name in ("label", "role", "orientation", "led"):
        light.create_dataset(name, data=[getattr(frame, name) or "" for frame in entries], dtype=_TEXT)
    light["intensity"] = _column(entries, "intensity")
    light["fringe_count"] = np.array([_fringe_count(frame) for frame in entries])


def _fringe_count(frame: ManifestEntry) -> float:
    if frame.set is None or frame.counts is None or frame.set >= len(frame.counts):
        return np.nan
    return frame.counts[frame.set]


def _write_camera(
    camera: h5py.Group, record: RunRecord, folder: RunFolder, entries: Sequence[ManifestEntry], patient: _Patient
) -> None:
    if record.optics is not None:
        camera["serial_number"] = record.optics.camera_serial
    camera["count_time"] = _column(entries, "exposure_us") * 1e-6
    camera["count_time"].attrs["units"] = "s"
    if entries[0].bits is not None:
        camera["bit_depth_readout"] = entries[0].bits
    first = folder.read_frame(entries[0])
    data = camera.create_dataset("data", shape=(len(entries), *first.shape), dtype=first.dtype)
    data.attrs.update(units="counts", long_name="frames (DN)")
    for index, frame in enumerate(entries):
        image = folder.read_frame(frame)
        if image.shape != first.shape or image.dtype != first.dtype:
            raise ExportError(f"{frame.path} is {image.dtype} {image.shape}, other frames {first.dtype} {first.shape}")
        data[index] = image
        if patient.error is not None:
            return


def _link_frames(entry: h5py.Group, count: int) -> None:
    frames = _group(entry, "frames", "NXdata")
    entry.attrs["default"] = "frames"
    # A hard link, and the attribute that says which of the two names is the original.
    frames["data"] = entry["instrument/camera/data"]
    frames["data"].attrs["target"] = "/entry/instrument/camera/data"
    frames["frame"] = np.arange(count)
    frames.attrs.update(signal="data", axes=["frame", ".", "."], frame_indices=0)


def _write_results(entry: h5py.Group, record: RunRecord, folder: RunFolder) -> None:
    names = [name for name in folder.results.names() if name.endswith((".npy", ".json"))]
    if not names:
        return
    process = _group(entry, "process", "NXprocess")
    process["program"] = "irpmd-rig"
    process["version"] = (record.versions or software_versions()).get("irpmd-rig", "")
    newest = max(folder.results.path(name).stat().st_mtime for name in names)
    process["date"] = datetime.fromtimestamp(newest, UTC).isoformat()
    for name in names:
        stem, _, kind = name.rpartition(".")
        if kind == "json":
            _note(process, stem, "application/json", json.dumps(folder.results.read_json(name)))
        else:
            _write_map(process, stem, folder.results.read_array(name))
    if "depth_mm" in process:
        entry.attrs["default"], process.attrs["default"] = "process", "depth_mm"


def _write_map(process: h5py.Group, name: str, values: NDArray[Any]) -> None:
    """Write an array as an NXdata; the axes of a map are pixel rows and columns."""
    if not np.issubdtype(values.dtype, np.number) and values.dtype != np.bool_:
        return
    data = _group(process, name, "NXdata")
    data["data"] = values.astype(np.uint8) if values.dtype == np.bool_ else values
    data["data"].attrs["long_name"] = name
    if (unit := name.rpartition("_")[2]) in _UNITS:
        data["data"].attrs["units"] = unit
    axes = ["."] * values.ndim
    if values.ndim == 2:
        for position, (axis, length) in enumerate(zip(("row", "column"), values.shape, strict=True)):
            axes[position] = axis
            data[axis] = np.arange(length)
            data[axis].attrs["units"] = "px"
            data.attrs[f"{axis}_indices"] = position
    data.attrs.update(signal="data", axes=axes)


def _group(parent: h5py.Group, name: str, kind: str) -> h5py.Group:
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    return group


def _column(entries: Sequence[ManifestEntry], name: str) -> NDArray[np.float64]:
    return np.array([np.nan if (value := getattr(frame, name)) is None else value for frame in entries], dtype=float)


def _now() -> str:
    return datetime.now(UTC).isoformat()
