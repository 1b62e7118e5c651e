"""A frame as a TIFF file that says itself how it was taken."""

from __future__ import annotations

import hashlib
import json
import re
from io import BufferedRandom
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from irpmd_rig.store.durable import place_file
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import RunFolderError

Image = NDArray[np.uint8] | NDArray[np.uint16]
FRAMES = "frames"


def checked_image(image: Image) -> Image:
    """Return the image; raises RunFolderError unless it is a grey picture of uint8 or uint16."""
    if image.ndim != 2 or image.size == 0 or image.dtype not in (np.uint8, np.uint16):
        raise RunFolderError(f"a frame is uint8 or uint16 of shape (H, W), not {image.dtype} of shape {image.shape}")
    return image


def frame_path(entry: ManifestEntry) -> str:
    """Path of a new frame in its run's folder: its number, and what a person looks for."""
    parts = [f"{entry.index:05d}", f"station{entry.station}", entry.label, entry.role]
    parts += [f"{name}{value}" for name in ("view", "set", "step") if (value := getattr(entry, name)) is not None]
    if entry.orientation != "x":
        parts.append(entry.orientation)
    return f"{FRAMES}/{re.sub(r'[^A-Za-z0-9_-]', '-', '_'.join(parts))}.tif"


def place_frame(folder: Path, image: Image, entry: ManifestEntry) -> ManifestEntry:
    """Write a frame beside its place, sync and rename it; returns its entry with the file's checksum.

    The entry is in the file as well (ImageDescription, JSON), so that a frame is never without its meaning.
    """
    digest = ""

    def write(stream: BufferedRandom) -> None:
        nonlocal digest
        # No metadata of tifffile's own: the description is ours, and the pixels lie in one piece.
        tifffile.imwrite(stream, image, description=entry.line(), metadata=None, photometric="minisblack")
        stream.seek(0)
        digest = hashlib.file_digest(stream, "sha256").hexdigest()

    place_file(folder / entry.path, write)
    return entry.model_copy(update={"sha256": digest})


def read_image(path: Path) -> Image:
    """Read a frame.

    Raises
    ------
    RunFolderError
        If it is no TIFF file with one grey picture of uint8 or uint16.
    """
    try:
        return checked_image(tifffile.imread(path))
    except Exception as error:  # a damaged file makes the library raise anything
        raise RunFolderError(f"{path}: not a frame: {error}") from error


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def described_entry(path: Path) -> ManifestEntry | None:
    """Read the entry that a frame carries; None if it is no whole frame of ours."""
    try:
        with tifffile.TiffFile(path) as file:
            entry = ManifestEntry.model_validate(json.loads(file.pages.first.description))
            file.pages.first.asarray()
        return entry.model_copy(update={"sha256": checksum(path)})
    except Exception:  # a damaged file makes the library raise anything
        return None
