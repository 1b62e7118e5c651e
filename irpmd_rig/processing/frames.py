"""Frames of a run folder as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from irpmd_rig.processing.errors import FramesUnusable
from irpmd_rig.store.entries import ManifestEntry, Orientation
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.frame_file import checksum
from irpmd_rig.store.run_folder import RunFolder

Frame = NDArray[Any]

# Readings of a stage that rests scatter by less.
_SAME_PLACE_MM = 0.02
_RETAKE = "measure again, or complete the folder"


@dataclass(frozen=True, slots=True)
class FringeStation:
    """The frames of one full set of fringe patterns at one place of the stages.

    Attributes
    ----------
    number
        The station.
    label, orientation
        What stood before the camera, and along which axis of the projector the phase grows.
    counts, steps
        Fringe counts of the sets and phase steps of each.
    entries
        Manifest entries, by set and step.
    """

    number: int
    label: str
    orientation: Orientation
    counts: tuple[float, ...]
    steps: int
    entries: tuple[ManifestEntry, ...]

    @property
    def stage1_mm(self) -> float:
        """Stage 1 of these frames; raises FramesUnusable if it is not known."""
        return _one_position(self.label, [entry.stage1_mm for entry in self.entries], "stage1_mm")

    @property
    def stage2_mm(self) -> float:
        """Stage 2 of these frames; raises FramesUnusable if it is not known."""
        return _one_position(self.label, [entry.stage2_mm for entry in self.entries], "stage2_mm")

    @property
    def measured(self) -> bool:
        """Whether the stage position was read back at every frame."""
        return all(entry.stage1_measured for entry in self.entries)

    @property
    def full_scale_dn(self) -> float | None:
        """Largest value of the camera; None if the number of bits is not known."""
        bits = self.entries[0].bits
        return None if bits is None else float(2**bits - 1)

    @property
    def checked(self) -> bool:
        """Whether every frame was checked when it was taken."""
        return all(entry.checks for entry in self.entries)

    @property
    def key(self) -> tuple[tuple[str, str | None, int | None], ...]:
        """What tells these frames from any others of the same folder, a repetition included."""
        return tuple((entry.path, entry.sha256, entry.index) for entry in self.entries)


def fringe_stations(
    entries: Sequence[ManifestEntry], label: str, orientation: Orientation = "x"
) -> tuple[FringeStation, ...]:
    """Full sets of fringes of one label, in the order of the stations.

    Raises
    ------
    FramesUnusable
        If there is none, or one lacks frames.
    """
    wanted = [e for e in entries if e.label == label and e.role == "fringes" and e.orientation == orientation]
    if not wanted:
        raise FramesUnusable(f"there are no fringe frames labelled {label!r} along {orientation}", _RETAKE)
    numbers = sorted({entry.station for entry in wanted})
    return tuple(_station(number, [e for e in wanted if e.station == number], label) for number in numbers)


def at_same_positions(
    stations: Sequence[FringeStation], others: Sequence[FringeStation], window_mm: float
) -> tuple[FringeStation, ...]:
    """Of other stations, the one that is nearest to each; raises FramesUnusable if it is beside its position."""
    nearest = []
    for station in stations:
        found = min(others, key=lambda other: abs(other.stage1_mm - station.stage1_mm))
        if abs(found.stage1_mm - station.stage1_mm) > window_mm + 1e-9:
            raise FramesUnusable(
                f"there are no fringes along y at {station.stage1_mm:g} mm: the nearest are at {found.stage1_mm:g} mm",
                "measure again, or complete the folder",
            )
        nearest.append(found)
    return tuple(nearest)


def check_along_y(stations: Sequence[FringeStation], across: Sequence[FringeStation]) -> None:
    """Check that fringes along y are as those along x: the phases of both are taken as equally fine and noisy.

    Parameters
    ----------
    stations, across
        Along x and along y, in the same order, as many.

    Raises
    ------
    FramesUnusable
        If they differ in fringe counts or phase steps at any of them.
    """
    for along_x, along_y in zip(stations, across, strict=True):
        if (along_y.counts, along_y.steps) != (along_x.counts, along_x.steps):
            raise FramesUnusable(
                f"station {along_x.number} ({along_x.label}): fringes along y differ from those along x in fringe "
                "counts or phase steps",
                "measure again",
            )


def _station(number: int, entries: list[ManifestEntry], label: str) -> FringeStation:
    where = f"station {number} ({label})"
    first = entries[0]
    if first.counts is None or first.steps is None:
        raise FramesUnusable(
            f"{where}: fringe counts and phase steps are not known",
            "give counts and steps in run.yaml or in the manifest",
        )
    if any((e.counts, e.steps, e.bits, e.exposure_us) != (first.counts, first.steps, first.bits, first.exposure_us)
           for e in entries):  # fmt: skip
        raise FramesUnusable(f"{where}: frames differ in fringe counts, steps, bits or exposure", _RETAKE)
    places = [(set_number, step) for set_number in range(len(first.counts)) for step in range(first.steps)]
    found = {(entry.set, entry.step): entry for entry in entries}
    missing = [place for place in places if place not in found]
    if missing or len(found) != len(entries) or len(found) != len(places):
        what = f"set {missing[0][0]} step {missing[0][1]} is missing" if missing else "some set and step is there twice"
        raise FramesUnusable(f"{where}: {len(entries)} frames for {len(places)} patterns: {what}", _RETAKE)
    ordered = tuple(found[place] for place in places)
    return FringeStation(number, label, first.orientation, first.counts, first.steps, ordered)


def _one_position(label: str, positions: list[float | None], name: str) -> float:
    known = {position for position in positions if position is not None}
    if None in positions or not known:
        raise FramesUnusable(f"{name} of the {label} frames is not known", f"give {name} in the manifest")
    if len(known) > 1 and max(known) - min(known) > _SAME_PLACE_MM:
        raise FramesUnusable(f"{name} of the {label} frames of one station goes from {min(known)} to {max(known)}",
                             _RETAKE)  # fmt: skip
    return float(np.mean([position for position in positions if position is not None]))


def read_fringes(folder: RunFolder, station: FringeStation, out: Frame | None = None) -> Frame:
    """Read all frames of a station, (sets, steps, H, W).

    Parameters
    ----------
    folder
        The run folder.
    station
        Which.
    out
        An array of an earlier station that is overwritten if it fits: fresh memory costs as much as decoding.

    Raises
    ------
    FramesUnusable
        If a file is missing, damaged, or of another size or type than the first.
    """
    first = read_frame(folder, station.entries[0])
    shape = (len(station.counts), station.steps, *first.shape)
    fits = out is not None and out.shape == shape and out.dtype == first.dtype
    frames: Frame = out if out is not None and fits else np.empty(shape, first.dtype)
    flat = frames.reshape(-1, *first.shape)
    flat[0] = first
    for place, entry in enumerate(station.entries[1:], start=1):
        read_frame(folder, entry, flat[place])
    return frames


def read_frame(folder: RunFolder, entry: ManifestEntry, out: Frame | None = None) -> Frame:
    """Read one frame, (H, W); raises FramesUnusable as `read_fringes`."""
    try:
        with tifffile.TiffFile(folder.file(entry.path)) as file:
            page = file.pages.first
            if len(file.pages) != 1 or len(page.shape) != 2 or page.dtype not in (np.uint8, np.uint16):
                raise FramesUnusable(f"{entry.path} is no single grey frame of 8 or 16 bits", _RETAKE)
            if out is None:
                out = np.empty(page.shape, page.dtype)
            if page.shape != out.shape or page.dtype != out.dtype:
                raise FramesUnusable(
                    f"{entry.path} is {page.shape} {page.dtype}, the frames before it {out.shape} {out.dtype}", _RETAKE
                )
            # Frames of the store are one uncompressed block: read into place, without a copy in between.
            if page.is_memmappable and out.flags.c_contiguous:
                file.filehandle.seek(page.dataoffsets[0])
                if file.filehandle.readinto(memoryview(out).cast("B")) != out.nbytes:  # type: ignore[arg-type]
                    raise FramesUnusable(f"{entry.path} is cut off", _RETAKE)
            else:
                out[:] = page.asarray()
    except FramesUnusable:
        raise
    except (OSError, StoreError, ValueError, KeyError, IndexError, TypeError, tifffile.TiffFileError) as error:
        raise FramesUnusable(f"{entry.path} cannot be read: {error}", _RETAKE) from None
    return out


def picture(
    folder: RunFolder, entries: Sequence[ManifestEntry], label: str, role: str, station: int | None = None
) -> Frame:
    """Read the one white or black frame of a label (and station); raises FramesUnusable if there is not just one."""
    found = [e for e in entries if e.label == label and e.role == role and (station is None or e.station == station)]
    if len(found) != 1:
        where = "" if station is None else f" at station {station}"
        raise FramesUnusable(f"{len(found)} {role} frames labelled {label!r}{where}; one is needed", _RETAKE)
    return read_frame(folder, found[0])


def damaged(folder: RunFolder, entries: Sequence[ManifestEntry]) -> tuple[str, ...]:
    """Paths of frames that are gone, or whose checksum is not the manifest's."""
    found = []
    for entry in entries:
        try:
            good = entry.sha256 in (None, checksum(folder.file(entry.path)))
        except (OSError, StoreError):
            good = False
        if not good:
            found.append(entry.path)
    return tuple(found)
