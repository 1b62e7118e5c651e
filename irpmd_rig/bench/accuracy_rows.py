"""The accuracy rows of the goals, from measurements beside the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from irpmd_rig.bench.accuracy_plan import FREEFORM, TREADS
from irpmd_rig.bench.accuracy_truth import DEPTH_EQUATION, NOTHING, Compared

METHODS = (DEPTH_EQUATION, "generalised", "triangulation", "facets")
_TITLES = {
    "paper": "paper's recipe (N = 4, 0/40)",
    "precise": "precise recipe (N = 8, -60/40)",
    "noise": "paper's recipe, read noise twice as large",
    "bow": "precise recipe, glass bowed by 20 um",
    "warp": "precise recipe, projector distortion of 0.05 % outside the lens model",
}


Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One figure over all seeds.

    Attributes
    ----------
    name
        What was measured.
    unit
        Of the figures.
    worst, median
        Over `count` measurements; None where one of them (worst), or half of them (median), gave nothing.
    paper
        What the paper reached; empty where it says nothing.
    must, aim
        Largest figure that has to be reached, and that is meant to be; None where none is set.
    note
        What else is to be known.
    """

    name: str
    unit: str
    worst: float | None
    median: float | None
    count: int
    paper: str = ""
    must: float | None = None
    aim: float | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One object by all methods beside the truth.

    Attributes
    ----------
    case, seed, subject
        Which.
    default
        Method that the recipe's ``auto`` chose; empty where nothing could be computed.
    methods
        By name.
    """

    case: str
    seed: int
    subject: str
    default: str
    methods: dict[str, Compared]

    @property
    def chosen(self) -> Compared:
        """By the default method."""
        return self.methods.get(self.default, NOTHING)


@dataclass(frozen=True, slots=True)
class Calibration:
    """What calibrations found, measured minus true.

    Attributes
    ----------
    case, seed
        Which.
    fx_px
        Of the camera's.
    d_um, d_seen_um
        The paper's distance to the fitted glass plane, and its mean over the glass that is seen.
    model_d_um
        The rig model's.
    chi2
        Of the rig model, a degree of freedom.
    flexible
        Whether the rig model needed its free-form correction.
    """

    case: str
    seed: int
    fx_px: float
    d_um: float
    d_seen_um: float
    model_d_um: float
    chi2: float
    flexible: bool


def row(name: str, unit: str, figures: Iterable[float], **more: object) -> AccuracyRow:
    """Worst and median of sizes; what is not finite is worse than anything."""
    sizes = np.sort([abs(figure) if np.isfinite(figure) else np.inf for figure in figures])
    worst, median = (sizes[-1], float(np.median(sizes))) if sizes.size else (np.inf, np.inf)
    return AccuracyRow(name, unit, _known(worst), _known(median), int(sizes.size), **more)  # type: ignore[arg-type]


def step_rows(measurements: Sequence[Measurement]) -> list[AccuracyRow]:
    """Largest step errors of the treads: by every method, and by the default one beside its limits."""
    rows = []
    for case in _TITLES:
        for axis, subjects in TREADS.items():
            taken = [m for m in measurements if m.case == case and m.subject in subjects]
            if not taken:
                continue
            title = f"largest step error, {_TITLES[case]}, steps along {axis}"
            paper = "21.3 / 17.8" if (case, axis) == ("paper", "y") else ""
            whole = sum(np.isfinite(m.chosen.largest_step_um) for m in taken)
            note = "" if whole == len(taken) else f"all facets found in {whole} of {len(taken)} only"
            figures = _each(taken, lambda m: m.chosen.largest_step_um)
            limits = _limits(case, axis)
            rows.append(row(f"default method: {title}", "um", figures, paper=paper, note=note, **limits))
            for method in METHODS:
                figures = [m.methods[method].largest_step_um for m in taken if method in m.methods]
                rows += [row(f"{method}: {title}", "um", figures, paper=paper)] if figures else []
    return rows


def pixel_rows(measurements: Sequence[Measurement]) -> list[AccuracyRow]:
    """Depth of a pixel inside planar facets: the default method's, the others' beside it."""
    treads = [m for m in measurements if m.case == "paper" and m.subject != FREEFORM]
    title = "depth of a pixel inside planar facets, rms, paper's recipe"
    rows = [row(f"default method: {title}", "um", _each(treads, lambda m: m.chosen.pixel_um), must=5.0, aim=1.5)]
    for method in METHODS:
        figures = [m.methods[method].pixel_um for m in treads if method in m.methods]
        rows += [row(f"{method}: {title}", "um", figures)] if np.isfinite(figures).any() else []
    return rows if treads else []


def freeform_rows(measurements: Sequence[Measurement]) -> list[AccuracyRow]:
    """Two freeform mirrors: shape, shape with piston, step between them."""
    rows = []
    figures: tuple[tuple[str, Callable[[Compared], float], float, float], ...] = (
        ("depth rms, piston removed", lambda c: c.shape_um, 3.0, 0.3),
        ("depth rms, with piston", lambda c: c.absolute_um, 8.0, 1.0),
        ("step across the gap", lambda c: c.gap_um, 5.0, 1.0),
    )
    for case in ("paper", "precise"):
        taken = [m for m in measurements if m.case == f"freeform, {case}"]
        for name, figure, must, aim in figures if taken else ():
            title = f"two freeform mirrors, {name}, {_TITLES[case]}"
            values = _each(taken, lambda m, figure=figure: figure(m.chosen))  # type: ignore[misc]
            rows.append(row(f"default method: {title}", "um", values, must=must, aim=aim))
            beside = [figure(m.methods["triangulation"]) for m in taken if "triangulation" in m.methods]
            rows += [row(f"triangulation: {title}", "um", beside)] if beside else []
    return rows


def calibration_rows(calibrations: Sequence[Calibration]) -> list[AccuracyRow]:
    """What calibrations found, and whether chi2 says that a model is off."""
    paper = [c for c in calibrations if c.case == "paper"] or list(calibrations)
    rows = [
        row("fx", "px", _each(paper, lambda c: c.fx_px), paper="1.48 (its uncertainty)", must=0.3, aim=0.1),
        row("d, the paper's calibration", "um", _each(paper, lambda c: c.d_um), must=20.0, aim=5.0),
        row("d, the paper's mean over the seen part of the glass", "um", _each(paper, lambda c: c.d_seen_um)),
        row("d, rig model", "um", _each(paper, lambda c: c.model_d_um), must=20.0, aim=5.0),
    ]
    for case, title in _TITLES.items():
        taken = [c for c in calibrations if c.case == case]
        flexible = sum(c.flexible for c in taken)
        note = f"free-form correction used in {flexible} of {len(taken)}"
        rows += [row(f"chi2 of the rig model, {title}", "", _each(taken, lambda c: c.chi2), note=note)] if taken else []
    return rows if calibrations else []


def uncertainty_rows(measurements: Sequence[Measurement]) -> list[AccuracyRow]:
    """Mean of (error / stated sigma)^2 of the default method over all steps and seeds, and over pixels."""
    rows = []
    limits = "0.5..2, aim 0.8..1.25"
    for case, title in _TITLES.items():
        taken = [m.chosen for m in measurements if m.case == case]
        if not taken:
            continue
        squares = [_mean_square(c) for c in taken]
        pooled = [
            (error / sigma) ** 2 for c in taken for error, sigma in zip(c.step_errors_um, c.step_sigmas_um, strict=True)
        ]
        note = f"limits {limits}; worst: of one object at one seed, median: mean over all {len(pooled)} steps"
        mean = float(np.mean(pooled)) if pooled else np.nan
        rows.append(_with_median(row(f"chi2 of stated step uncertainties, {title}", "", squares, note=note), mean))
        together = [c.step_chi2 for c in taken]
        if np.isfinite(together).all():
            note = "by the steps' covariance; median: mean over all"
            rows.append(
                _with_median(
                    row(f"chi2 of stated step covariances, {title}", "", together, note=note), float(np.mean(together))
                )
            )
        pixels = [c.pixel_chi2 for c in taken]
        rows += [row(f"chi2 of stated pixel uncertainties, {title}", "", pixels)] if np.isfinite(pixels).all() else []
    return rows


def _mean_square(compared: Compared) -> float:
    pairs = zip(compared.step_errors_um, compared.step_sigmas_um, strict=True)
    squares = [(error / sigma) ** 2 for error, sigma in pairs]
    return float(np.mean(squares)) if squares else np.nan


def _with_median(found: AccuracyRow, median: float) -> AccuracyRow:
    return AccuracyRow(found.name, found.unit, found.worst, _known(median), found.count, note=found.note)


def _limits(case: str, axis: str) -> dict[str, Any]:
    if case == "paper":
        return {"must": 2.5, "aim": 1.0} if axis == "y" else {"must": 4.0, "aim": 1.2}
    return {"precise": {"must": 1.0, "aim": 0.3}, "noise": {}}.get(case, {"must": 4.0, "aim": 0.5})


def _each(items: Sequence[Item], figure: Callable[[Item], float]) -> list[float]:
    return [figure(item) for item in items]


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
