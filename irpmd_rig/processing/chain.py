"""Which calibrations and which reference a run uses: found, checked for fitness, and loaded when needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.processing.archive import ARRAYS, Content
from irpmd_rig.processing.errors import Refused
from irpmd_rig.processing.rig_facts import RigFacts, rig_facts
from irpmd_rig.processing.wishes import NEED_A_REFERENCE, Wishes, wishes
from irpmd_rig.recipes.models import Method
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.library import ACTIVE, Library
from irpmd_rig.store.record import Kind, RunRecord
from irpmd_rig.store.results import CALIBRATION
from irpmd_rig.store.run_folder import RunFolder

# What each kind of run needs beside its frames: first what its recipe calls its calibration, then the rest.
NEEDS: Mapping[Kind, tuple[Kind, ...]] = {
    "calibrate-camera": (),
    "calibrate-plate": ("calibrate-camera",),
    "calibrate-geometry": ("calibrate-plate", "calibrate-camera"),
    "reference": ("calibrate-geometry", "calibrate-plate", "calibrate-camera"),
    "measure": ("calibrate-geometry", "calibrate-plate", "calibrate-camera", "reference"),
    "sequence": (),
    "align": ("calibrate-plate", "calibrate-camera"),
    "characterise": (),
}
_NEEDS_STAGE_AXIS = NEEDS["reference"]
_ANOTHER = "choose another one, or make it again"


def needs_of(kind: Kind, what: object = None) -> tuple[Kind, ...]:
    """Give what a run needs beside its frames; of a characterise it depends on ``what``."""
    return _NEEDS_STAGE_AXIS if kind == "characterise" and what == "stage-axis" else NEEDS[kind]


class Chain:
    """The calibrations and the reference of one run.

    Parameters
    ----------
    record
        The run's record: what it names in ``uses``, its camera, its rig and its recipe.
    library
        Where they are.

    Attributes
    ----------
    uses
        Kind to run id of what was found and fits.
    off
        Why the calibrations should not have been used, where the recipe says ``mark``; empty where nothing is wrong.
    without_reference
        Why a measurement has no reference whose method needs none; empty if it has one.

    Raises
    ------
    Refused
        If one is not named and none is active, is not there, or does not fit: every reason at once.
    ProcessingError
        If the rig or the recipe part of the record is wrong.
    """

    def __init__(self, record: RunRecord, library: Library) -> None:
        self._library = library
        self._record = record
        self._facts: RigFacts = rig_facts(record)
        self._folders: dict[Kind, RunFolder] = {}
        self._contents: dict[Kind, Content] = {}
        self.wishes: Wishes = wishes(record) if record.kind == "measure" else Wishes()
        self.uses: dict[Kind, str] = {}
        self.off: tuple[str, ...] = ()
        self.without_reference = ""
        needs = needs_of(record.kind, record.recipe.get("what"))
        optional: tuple[Kind, ...] = ()
        for kind in needs:
            if kind == "reference" and self._reference_is_optional():
                optional = ("reference",)
                continue
            # What the first calibration was made with comes with it.
            leads = kind in (needs[0], "reference")
            self._find(kind, self._named(kind) if leads else self._used_by(needs[0], kind))
        self._refuse_unfit()
        if optional:
            self._take_reference()

    @property
    def method(self) -> tuple[Method, str]:
        """Method of a measurement, and why this one."""
        return self.wishes.chosen(has_model=self.has_model)

    @property
    def method_needs_reference(self) -> bool:
        """Whether this is a measurement by a method that compares with a reference."""
        return self._record.kind == "measure" and self.method[0] in NEED_A_REFERENCE

    @property
    def has_model(self) -> bool:
        """Whether the calibration of the geometry has a rig model."""
        return self.content("calibrate-geometry").get("rig_model") is not None

    @property
    def stamp(self) -> tuple[tuple[str, str, int], ...]:
        """What tells these calibrations from others, and from the same ones computed again; raises Refused."""
        stamps = []
        for kind, folder in self._folders.items():
            try:
                changed = folder.results.path(CALIBRATION).stat().st_mtime_ns
            except (StoreError, OSError) as error:
                raise Refused(f"{kind} {folder.id} cannot be used: {error}", _ANOTHER) from None
            stamps.append((kind, folder.id, changed))
        return tuple(stamps)

    def content(self, kind: Kind) -> Content:
        """Give `calibration.json` of the run used for ``kind``; raises Refused if it cannot be read."""
        if kind not in self._contents:
            try:
                self._contents[kind] = self._folders[kind].results.read_json(CALIBRATION)
            except StoreError as error:
                raise Refused(f"{kind} {self.uses[kind]} cannot be used: {error}", _ANOTHER) from None
        return self._contents[kind]

    def document(self, kind: Kind, name: str) -> Content:
        """Give another JSON document of the run used for ``kind``; raises Refused if it cannot be read."""
        try:
            return self._folders[kind].results.read_json(name)
        except StoreError as error:
            raise Refused(f"{kind} {self.uses[kind]} cannot be used: {error}", _ANOTHER) from None

    def array(self, kind: Kind, name: str) -> NDArray[Any]:
        """Give one array of `arrays.npz` of the run used for ``kind``; raises Refused if it cannot be read."""
        try:
            with np.load(self._folders[kind].results.path(ARRAYS), allow_pickle=False) as file:
                array: NDArray[Any] = file[name]
        except (StoreError, OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise Refused(f"{kind} {self.uses[kind]} cannot be used: {error}", _ANOTHER) from None
        return array

    def check_size(self, size_px: tuple[int, int]) -> None:
        """Refuse calibrations of another picture size than (width, height) of the frames."""
        for kind in self.uses:
            theirs = tuple(self.content(kind)["size_px"])
            if theirs != size_px:
                raise Refused(
                    f"{kind} {self.uses[kind]} is for pictures of {theirs[0]} x {theirs[1]} px, "
                    f"the frames have {size_px[0]} x {size_px[1]}",
                    _ANOTHER,
                )

    def check_fringes(self, counts: Sequence[float]) -> None:
        """Refuse calibrations whose absolute phase is counted in other fringes than ``counts``."""
        reasons = self._other_fringes("calibrate-plate", counts) + self._other_fringes("reference", counts)
        if reasons:
            raise Refused("; ".join(reasons), _ANOTHER)

    def reference_positions(self, positions_mm: Sequence[float]) -> tuple[int, ...]:
        """Places, in the reference, of the stage positions of a measurement.

        Raises
        ------
        Refused
            If the reference has no position within the in-position window of one of them.
        """
        there: list[float] = self.content("reference")["positions_mm"]
        window = self._facts.stage1.in_position_mm
        places, far = [], []
        for position in positions_mm:
            place = min(range(len(there)), key=lambda k: abs(there[k] - position))
            places.append(place)
            # Positions come back from decimal text: a window's edge belongs to it.
            if abs(there[place] - position) > window + 1e-9:
                far.append(f"{position:g}")
        if far:
            raise Refused(
                f"reference {self.uses['reference']} was taken at {', '.join(f'{p:g}' for p in there)} mm, not at "
                f"{', '.join(far)} mm (in-position window {window:g} mm)",
                "take a reference at these positions",
            )
        return tuple(places)

    def _reference_is_optional(self) -> bool:
        """Whether no reference is named, and the method can do without."""
        return self.method[0] not in NEED_A_REFERENCE and self._named("reference") == ACTIVE

    def _take_reference(self) -> None:
        """Use the active reference for what is compared, if there is one that fits."""
        try:
            self._find("reference", ACTIVE)
            reasons = self._misfits("reference") + self._faults("reference")
            if self._record.fringes is not None:
                reasons += self._other_fringes("reference", self._record.fringes.counts)
        except Refused as error:
            reasons = [error.what]
        if reasons:
            self.uses.pop("reference", None)
            self._folders.pop("reference", None)
            self.without_reference = "; ".join(reasons)

    def _refuse_unfit(self) -> None:
        misfits = [reason for kind in self.uses for reason in self._misfits(kind)]
        faults = [reason for kind in self.uses for reason in self._faults(kind)]
        if misfits or (faults and self.wishes.if_calibration_is_off == "refuse"):
            raise Refused("; ".join(misfits + faults), _ANOTHER)
        self.off = tuple(faults)

    def _named(self, kind: Kind) -> str:
        record = self._record
        written = record.recipe.get("reference" if kind == "reference" else "calibration")
        return record.uses.get(kind) or (written if isinstance(written, str) else ACTIVE)

    def _find(self, kind: Kind, wanted: str) -> None:
        try:
            self._folders[kind] = self._library.resolve(kind, wanted)
        except StoreError as error:
            raise Refused(str(error), f"make a {kind}, activate one, or name one") from None
        self.uses[kind] = self._folders[kind].id

    def _used_by(self, first: Kind, kind: Kind) -> str:
        uses = self.content(first).get("uses")
        if not isinstance(uses, dict) or not isinstance(uses.get(kind), str):
            raise Refused(f"{first} {self.uses[first]} does not say which {kind} it used", _ANOTHER)
        named = self._record.uses.get(kind, ACTIVE)
        if named not in (ACTIVE, uses[kind]):
            raise Refused(f"{first} {self.uses[first]} goes with {kind} {uses[kind]}, not with {named}", _ANOTHER)
        return str(uses[kind])

    def _faults(self, kind: Kind) -> list[str]:
        """Give the reasons why what the run used for ``kind`` found may not be true any more, or never was."""
        run, content = self.uses[kind], self.content(kind)
        reasons = []
        ours, theirs = self._record.optics, content.get("camera_serial")
        if ours is not None and theirs is not None and ours.camera_serial != theirs:
            reasons.append(f"{kind} {run} was made with camera {theirs}, this is {ours.camera_serial}")
        limit = self._facts.calibration.max_age_days
        age = age_days(content)
        if limit is not None and age is None:
            reasons.append(f"{kind} {run} does not say when it was taken, the rig file allows {limit:g} days")
        if limit is not None and age is not None and age > limit:
            reasons.append(f"{kind} {run} is {age:.1f} days old, the rig file allows {limit:g}")
        if kind == "calibrate-geometry" and self._record.kind == "measure" and self.method[0] != "depth-equation":
            reasons += self._large_chi2()
        if kind == "reference" and set(NEED_A_REFERENCE) & {self.method[0], *self.wishes.compare}:
            reasons += self._before_geometry()
        return reasons

    def _before_geometry(self) -> list[str]:
        """Give the reason why the reference shows the rig as it was before its geometry was calibrated again."""
        reference, geometry = self.content("reference"), self.content("calibrate-geometry")
        theirs, ours = (reference.get("uses") or {}).get("calibrate-geometry"), self.uses["calibrate-geometry"]
        taken, calibrated = _created(reference), _created(geometry)
        if theirs == ours or taken is None or calibrated is None or taken >= calibrated:
            return []
        return [
            f"reference {self.uses['reference']} goes with calibrate-geometry {theirs} and is older than "
            f"calibrate-geometry {ours}"
        ]

    def _other_fringes(self, kind: Kind, counts: Sequence[float]) -> list[str]:
        """Give the reason why the absolute phase of what is used for ``kind``, if anything, is counted otherwise."""
        if kind not in self.uses:
            return []
        theirs = self.content(kind).get("counts")
        if not theirs:
            return [f"{kind} {self.uses[kind]} does not say its fringe counts"]
        if max(theirs) == max(counts):
            return []
        return [f"{kind} {self.uses[kind]} has {max(theirs):g} fringes at the finest, this run {max(counts):g}"]

    def _large_chi2(self) -> list[str]:
        chi2 = (self.content("calibrate-geometry").get("rig_model") or {}).get("chi2_per_dof", 0.0)
        if chi2 <= self.wishes.max_chi2:
            return []
        return [
            f"the rig model of calibrate-geometry {self.uses['calibrate-geometry']} does not describe its own frames: "
            f"chi2 {chi2:.3g} a degree of freedom, the recipe allows {self.wishes.max_chi2:g}"
        ]

    def _misfits(self, kind: Kind) -> list[str]:
        """Give the reasons why the run used for ``kind`` cannot be used with the others, or for this method."""
        run, content = self.uses[kind], self.content(kind)
        reasons = []
        if kind == "reference":
            camera = (content.get("uses") or {}).get("calibrate-camera")
            if camera != self.uses["calibrate-camera"]:
                reasons.append(
                    f"the optics differ: reference {run} goes with calibrate-camera {camera}, calibrate-geometry "
                    f"{self.uses['calibrate-geometry']} with {self.uses['calibrate-camera']}"
                )
        if kind == "calibrate-geometry" and self._record.kind == "measure":
            method, positions = self.method[0], self._record.positions_mm
            if method != "depth-equation" and not self.has_model:
                reasons.append(f"{kind} {run} has no rig model, which {method} needs: take it at several positions")
            if method == "depth-equation" and len(positions) > 2:
                reasons.append(f"the depth equation takes two positions, this run has {len(positions)}")
        return reasons


def age_days(content: Content) -> float | None:
    """Age of a calibration's frames; None if it does not say."""
    created = _created(content)
    return None if created is None else (datetime.now(UTC) - created).total_seconds() / 86400


def _created(content: Content) -> datetime | None:
    """When a calibration's frames were taken, a time without offset as UTC; None if it does not say."""
    try:
        created = datetime.fromisoformat(content["created"])
    except (KeyError, TypeError, ValueError):
        return None
    return created.replace(tzinfo=UTC) if created.tzinfo is None else created


def check_uses(record: RunRecord, library: Library) -> dict[Kind, str]:
    """Find and check, before anything moves, what a run will use.

    Parameters
    ----------
    record
        The run's record; ``positions_mm`` are those of the recipe.
    library
        Where calibrations and references are.

    Returns
    -------
    dict
        Kind to run id, ``active`` resolved.

    Raises
    ------
    Refused
        If one is missing or does not fit.
    ProcessingError
        If the rig part of the record is wrong.
    """
    chain = Chain(record, library)
    if chain.method_needs_reference and record.positions_mm:
        chain.reference_positions(record.positions_mm)
    if record.optics is not None:
        chain.check_size(record.optics.size_px)
    if record.fringes is not None:
        chain.check_fringes(record.fringes.counts)
    return dict(chain.uses)
