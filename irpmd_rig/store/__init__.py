"""What is on disk: run folders that a person can read, an index that can be made again from them, and exports.

`Store` makes and finds runs, `RunFolder` is one of them, `Library` says which serve as calibrations and references.
"""

from irpmd_rig.store.entries import ManifestEntry, Orientation, Role
from irpmd_rig.store.errors import (
    DiskFull,
    ExportError,
    FileNotInRun,
    NotUsable,
    RunFolderError,
    RunInUse,
    RunNotFound,
    StoreError,
    TransitionRefused,
    WriteFailed,
)
from irpmd_rig.store.library import ACTIVE, REFERENCE, Library, LibraryItem
from irpmd_rig.store.record import CALIBRATIONS, KINDS, Fringes, Kind, Optics, RunRecord, software_versions
from irpmd_rig.store.results import Results
from irpmd_rig.store.run_folder import Reconciliation, RunFolder
from irpmd_rig.store.states import ENDED, ENDED_BADLY, TRANSITIONS, Reason, RunState, Transition, check_transition
from irpmd_rig.store.store import Store
from irpmd_rig.store.summary import RunSummary

__all__ = [
    "ACTIVE",
    "CALIBRATIONS",
    "ENDED",
    "ENDED_BADLY",
    "KINDS",
    "REFERENCE",
    "TRANSITIONS",
    "DiskFull",
    "ExportError",
    "FileNotInRun",
    "Fringes",
    "Kind",
    "Library",
    "LibraryItem",
    "ManifestEntry",
    "NotUsable",
    "Optics",
    "Orientation",
    "Reason",
    "Reconciliation",
    "Results",
    "Role",
    "RunFolder",
    "RunFolderError",
    "RunInUse",
    "RunNotFound",
    "RunRecord",
    "RunState",
    "RunSummary",
    "Store",
    "StoreError",
    "Transition",
    "TransitionRefused",
    "WriteFailed",
    "check_transition",
    "software_versions",
]
