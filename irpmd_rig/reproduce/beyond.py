"""What the paper leaves out: repeatability, and errors against misalignment, noise and fringe count."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.report.content import Block, Picture, Section, Table, Text
from irpmd_rig.report.figures_graphs import Series, curves, step_deviations
from irpmd_rig.report.wording import fixed, micrometres, number, signed
from irpmd_rig.reproduce.results import DEPTH_EQUATION, OURS, Results, steps_of
from irpmd_rig.reproduce.taken import Taken

METHODS = (DEPTH_EQUATION, "generalised", "triangulation", OURS)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Repeated:
    """One step over many measurements by one calibration.

    Attributes
    ----------
    method, name
        Which.
    values_um
        Measured minus true, one a measurement.
    random_um, sigma_um
        Stated: what differs at every repetition, and all parts together; medians.
    """

    method: str
    name: str
    values_um: Array
    random_um: float
    sigma_um: float

    @property
    def mean_um(self) -> float:
        """Mean error."""
        return float(self.values_um.mean())

    @property
    def deviation_um(self) -> float:
        """Standard deviation of one measurement."""
        return float(self.values_um.std(ddof=1))


def repeated(results: Results, method: str) -> tuple[Repeated, ...]:
    """Steps of the repeated measurements in which all were found and the method's checks passed."""
    taken = (steps_of(m, method) for m in results.all_of("repeat"))
    found = [steps for steps in taken if steps.errors_um and steps.passed]
    if len(found) < 2:
        return ()
    errors, random, sigma = (
        np.array([getattr(s, name) for s in found]) for name in ("errors_um", "random_um", "sigmas_um")
    )
    return tuple(
        Repeated(
            method, f"{k + 1}-{k + 2}", errors[:, k], float(np.median(random[:, k])), float(np.median(sigma[:, k]))
        )
        for k in range(errors.shape[1])
    )


def repeatability_content(results: Results) -> dict[str, Any]:
    """Repeatability as JSON."""
    return {
        "runs": [m.run_id for m in results.all_of("repeat")],
        "steps": [
            {
                "method": step.method,
                "step": step.name,
                "measurements": int(step.values_um.size),
                "mean_error_um": step.mean_um,
                "standard_deviation_um": step.deviation_um,
                "stated_random_um": step.random_um,
                "stated_sigma_um": step.sigma_um,
            }
            for method in (DEPTH_EQUATION, OURS)
            for step in repeated(results, method)
        ],
    }


def repeatability_section(results: Results) -> tuple[Section, Table] | None:
    """Mean, standard deviation and stated uncertainty of each step; None where nothing was repeated."""
    by_method = {method: repeated(results, method) for method in (DEPTH_EQUATION, OURS)}
    by_method = {method: steps for method, steps in by_method.items() if steps}
    if not by_method:
        return None
    every = [step for steps in by_method.values() for step in steps]
    rows = tuple(
        (
            f"{step.method}, {step.name}",
            str(step.values_um.size),
            signed(step.mean_um, 2),
            fixed(step.deviation_um, 2),
            fixed(step.random_um, 2),
            number(step.deviation_um / step.random_um),
            fixed(step.sigma_um, 2),
        )
        for step in every
    )
    columns = (
        "step",
        "measurements",
        "mean error",
        "standard deviation",
        "stated, random",
        "found over stated",
        "stated, all parts",
    )
    count = len(results.all_of("repeat"))
    table = Table(
        columns,
        rows,
        f"Repeatability over {count} measurements, one calibration and reference, new noise (µm); left out is where a "
        "step was not found or the method's own checks failed",
    )
    names = [step.name for step in next(iter(by_method.values()))]
    series = [
        Series(method, [s.mean_um for s in steps], [s.deviation_um for s in steps])
        for method, steps in by_method.items()
    ]
    caption = f"Mean error of each step over {count} measurements; bars of one and (thin) two standard deviations."
    blocks: list[Block] = [
        table,
        Picture("repeatability", step_deviations(names, series, beside="true"), caption, caption),
    ]
    ours = by_method.get(OURS, ())
    if ours:
        off = np.concatenate([(s.values_um - s.mean_um) / s.random_um for s in ours])
        # Of every step one degree of freedom went into its mean.
        chi2 = float(np.sum(off**2) / (off.size - len(ours)))
        blocks.append(Text(f"Chi2 of the stated random part, {OURS}: {chi2:.2f} a degree of freedom."))
    blocks.append(Text(f"Runs: {', '.join(m.run_id for m in results.all_of('repeat'))}."))
    return Section("Repeatability", tuple(blocks)), table


@dataclass(frozen=True, slots=True)
class Sweep:
    """Measurements of one object in which one quantity changes.

    Attributes
    ----------
    use
        Of the measurements; its name in files and in JSON.
    heading, x_label, x_name
        In words, with the unit; the last as short as a column's head.
    x
        The quantity, of a measurement.
    told
        What was done.
    """

    use: str
    heading: str
    x_label: str
    x_name: str
    x: Callable[[Taken], float]
    told: str


def _at(taken: Taken) -> float:
    return taken.task.at


SWEEPS = (
    Sweep(
        "stage-tilt",
        "Error against the stage's tilt",
        "tilt of the stage's axis about y (°)",
        "tilt (°)",
        _at,
        "Geometry and reference are calibrated anew at every tilt; the glass keeps its 0.1° and the projector its 1°.",
    ),
    Sweep(
        "read-noise",
        "Error against noise",
        "phase noise of a pixel (mrad)",
        "noise (mrad)",
        lambda taken: taken.phase_noise_mrad,
        "The camera's read noise is 1 to 12 times that of the paper's camera, 13 electrons; reference and object are "
        "taken with it, the geometry is calibrated without.",
    ),
    Sweep(
        "fringe-count",
        "Error against fringe count",
        "fringes of the finest set",
        "fringes",
        _at,
        "Sets of N, N - 1 and N - √N fringes; plate, geometry, reference and object are taken anew with each.",
    ),
)


def sweep_content(results: Results, sweep: Sweep) -> list[dict[str, Any]]:
    """Points of a sweep as JSON, one a run and method."""
    return [
        {
            "at": taken.task.at,
            "phase_noise_mrad": _or_none(taken.phase_noise_mrad),
            "method": method,
            "largest_error_um": _or_none(steps_of(taken, method).largest_um),
            "rms_error_um": _or_none(steps_of(taken, method).rms_um),
            "largest_sigma_um": _or_none(max(steps_of(taken, method).sigmas_um, default=np.nan)),
            "run": taken.run_id,
        }
        for taken in results.all_of(sweep.use)
        for method in METHODS
    ]


def sweep_section(results: Results, sweep: Sweep) -> tuple[Section, Table] | None:
    """Table and curves of a sweep; None where nothing was swept."""
    taken = results.all_of(sweep.use)
    if not taken:
        return None
    rows = tuple(
        (
            number(sweep.x(one)),
            *(micrometres(steps_of(one, method).largest_um) for method in METHODS),
            micrometres(max(steps_of(one, OURS).sigmas_um, default=np.nan)),
            one.run_id,
        )
        for one in taken
    )
    columns = (sweep.x_name, *METHODS, f"stated, {OURS}", "run")
    table = Table(columns, rows, f"{sweep.heading}: largest error of a step (µm), mirror step, the paper's recipe")
    figure = curves(
        [sweep.x(one) for one in taken],
        _series(taken),
        x_label=sweep.x_label,
        y_label="largest step error (µm)",
        log_y=True,
    )
    caption = f"{sweep.heading}. {sweep.told} A gap: not every step was found."
    name = sweep.use.replace("-", "_")
    return Section(sweep.heading, (Text(sweep.told), Picture(name, figure, caption, caption), table)), table


def _series(taken: Sequence[Taken]) -> list[Series]:
    shown = (DEPTH_EQUATION, "triangulation", OURS)
    found = [Series(method, [steps_of(one, method).largest_um for one in taken]) for method in shown]
    return [series for series in found if np.isfinite(series.values).any()]


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
