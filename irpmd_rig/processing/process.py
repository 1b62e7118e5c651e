"""A run folder in, results out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.processing.align import align_run
from irpmd_rig.processing.calibrate import calibrate_camera_run, calibrate_plate_run, reference_run
from irpmd_rig.processing.calibrate_geometry import calibrate_geometry_run
from irpmd_rig.processing.chain import Chain
from irpmd_rig.processing.characterise import characterise_run
from irpmd_rig.processing.errors import FramesUnusable, ProcessingError
from irpmd_rig.processing.frames import FringeStation, damaged, fringe_stations
from irpmd_rig.processing.job import Job
from irpmd_rig.processing.measure import measure_run
from irpmd_rig.processing.optics import Optics, load_optics
from irpmd_rig.processing.phases import Phases
from irpmd_rig.processing.values import Announce, ProcessedRun, Progress
from irpmd_rig.processing.whole import withdraw_partial
from irpmd_rig.report.run import write_report
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import DiskFull, StoreError
from irpmd_rig.store.library import Library
from irpmd_rig.store.record import Kind, RunRecord
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Reason

MANIFEST = "manifest.jsonl"
_KINDS: Mapping[Kind, Callable[[Job], ProcessedRun]] = {
    "calibrate-camera": calibrate_camera_run,
    "calibrate-plate": calibrate_plate_run,
    "calibrate-geometry": calibrate_geometry_run,
    "reference": reference_run,
    "align": align_run,
    "characterise": characterise_run,
}


class Processor:
    """Computes runs one after the other, and remembers what the next one may need again.

    Parameters
    ----------
    threads
        For everything that is computed.
    """

    def __init__(self, threads: int = 1) -> None:
        self._phases = Phases(threads)
        self._chain: tuple[Path, RunRecord, Chain] | None = None
        self._optics: tuple[tuple[tuple[str, str, int], ...], Optics] | None = None

    def decode(self, folder: RunFolder, library: Library, station: int) -> None:
        """Decode a station ahead of time, while the stage moves; and load what the run will use.

        Raises
        ------
        ProcessingError
            If frames are missing or cannot be decoded, or what the run uses is refused.
        """
        with _typed_errors():
            record = folder.record()
            if record.kind == "sequence":
                return
            decoded = [(ready, self._phases.at(folder, ready)) for ready in _complete(folder, station)]
            if record.kind == "measure":
                rig = self._load(self._chained(folder, record, library)).rig
                for ready, phase in decoded:
                    if rig is not None and ready.orientation == "x":
                        self._phases.glass(ready, phase, rig.model, rig.outline_mm)

    def process(self, folder: RunFolder, library: Library, announce: Announce) -> ProcessedRun:
        """Compute a run's results and write them.

        Parameters
        ----------
        folder
            The run.
        library
            Calibrations and references.
        announce
            Is told how far it is.

        Returns
        -------
        ProcessedRun
            All of it is on disk.

        Raises
        ------
        ProcessingError
            With what was wrong, a remedy and the reason why the run ends.
        """
        try:
            with _typed_errors():
                withdraw_partial(folder.results)
                record, entries = folder.record(), _manifest(folder)
                chain = self._chained(folder, record, library)
                job = Job(folder, record, entries, chain, self._phases, announce)
                try:
                    if record.kind == "sequence":
                        return job.finished(frames=len(entries))
                    if record.kind == "measure":
                        return measure_run(job, self._load(job.chain))
                    return _KINDS[record.kind](job)
                except BaseException:
                    job.withdraw()
                    raise
        finally:
            self.forget()

    def forget(self) -> None:
        """Let go of what was decoded ahead; it is decoded again when it is needed."""
        self._phases.forget()
        self._chain = None

    def _chained(self, folder: RunFolder, record: RunRecord, library: Library) -> Chain:
        """Give what a run uses: found when its first station is decoded, the same until it is computed."""
        known = self._chain
        if known is None or known[:2] != (folder.path, record):
            known = self._chain = folder.path, record, Chain(record, library)
        return known[2]

    def _load(self, chain: Chain) -> Optics:
        key = chain.stamp
        if self._optics is None or self._optics[0] != key:
            self._optics = None
            self._optics = key, load_optics(chain)
        return self._optics[1]


def reported(done: ProcessedRun, folder: RunFolder, library: Library, announce: Announce) -> ProcessedRun:
    """Write the report of a run that was computed: the last of its results.

    Parameters
    ----------
    done
        What was computed.
    folder, library, announce
        As `Processor.process`.

    Raises
    ------
    ProcessingError
        If it cannot be written.
    """
    announce(Progress("the report is written", 1.0))
    with _typed_errors():
        names = write_report(folder, library)
    for name in names:
        announce(Progress(f"{name} is written", 1.0, name))
    return replace(done, files=(*done.files, *names))


def process(folder: RunFolder, library: Library, announce: Announce, *, threads: int = 1) -> ProcessedRun:
    """Compute a run's results in this process: see `Processor.process`."""
    return Processor(threads).process(folder, library, announce)


def reconstruct(path: Path, library: Library, announce: Announce, *, threads: int = 1) -> ProcessedRun:
    """Compute the results of any run folder again, also of one written by hand.

    Parameters
    ----------
    path
        The folder: `run.yaml`, `manifest.jsonl` and the frames that it names.
    library
        Where the calibrations and references lie that it uses.
    announce
        Is told how far it is.
    threads
        For everything that is computed.

    Raises
    ------
    ProcessingError
        As `Processor.process`; also if a frame is not what it was when it was taken (by its checksum).
    """
    with RunFolder(path) as folder:
        with _typed_errors():
            bad = damaged(folder, folder.manifest())
        if bad:
            raise FramesUnusable(
                f"{len(bad)} frames are missing or damaged: {', '.join(bad[:5])}", "restore them, or measure again"
            )
        done = process(folder, library, announce, threads=threads)
        return reported(done, folder, library, announce)


def _manifest(folder: RunFolder) -> tuple[ManifestEntry, ...]:
    entries = folder.manifest()
    if not (folder.path / MANIFEST).is_file():
        raise FramesUnusable(
            f"{folder.path} has no {MANIFEST}: which frame is what is not known", "write it, one line a frame"
        )
    if not entries:
        raise FramesUnusable(f"{folder.path / MANIFEST} names no frame", "measure again, or complete it")
    return entries


def _complete(folder: RunFolder, station: int) -> tuple[FringeStation, ...]:
    entries = folder.frames(station=station, role="fringes")
    sets = sorted({(entry.label, entry.orientation) for entry in entries})
    return tuple(found for label, orientation in sets for found in fringe_stations(entries, label, orientation))


class _typed_errors:  # noqa: N801 - a context manager
    """Turns what the core and the store complain of into ProcessingError."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, DiskFull):
            raise ProcessingError(str(error), "delete or move old runs", reason=Reason.DISK_FULL) from error
        if isinstance(error, StoreError):
            raise ProcessingError(str(error), "mend the folder, or measure again") from error
        if isinstance(error, MeasurementError):
            raise ProcessingError(str(error), "see what was said, then measure again") from error


__all__ = ["Processor", "process", "reconstruct", "reported"]
