"""The self-calibrated rig in the report of its geometry."""

from __future__ import annotations

import numpy as np

from irpmd_rig.report.content import Block, Facts, Picture, Section, Table, Text
from irpmd_rig.report.figures_maps import Panel, maps
from irpmd_rig.report.reading import Content, Run
from irpmd_rig.report.wording import number, signed, with_sigma
from irpmd_rig.store.errors import StoreError

_STRONG = 0.95  # correlation that is worth a word
_RESIDUAL = "residual_"
_FLEXIBLE = "yes: the residuals asked for it"


def rig_model_sections(run: Run, model: Content) -> tuple[Section, Section]:
    """How well the model describes the frames, and what it cannot tell; folded, its parameters."""
    regions = ", ".join(f"{name} {number(value)}" for name, value in model["chi2_by_region"].items())
    offsets = zip(model["positions_mm"], model["stage_offsets_mm"], strict=True)
    rows = (
        ("d at stage 1 = 0 (mm)", with_sigma(model["d_mm"], model["sigma_d_mm"])),
        ("χ² a degree of freedom", f"{number(model['chi2_per_dof'])} ({regions})"),
        ("bow of the glass and phase over it corrected", _FLEXIBLE if model["flexible"] else "no"),
        ("stage 1 beside its reading", ", ".join(f"{signed(1e3 * o, 2)} µm at {p:g} mm" for p, o in offsets)),
    )
    blocks: list[Block] = [Facts(rows), *(Text(f"Not determined: {text}.") for text in model["undetermined"])]
    numbers = (_parameters(model), *_correlations(model))
    return (
        Section("Rig model", (*blocks, *_residuals(run))),
        Section("Parameters of the rig model", numbers, folded=True),
    )


def _parameters(model: Content) -> Table:
    rows = tuple((p["name"], with_sigma(p["value"], p["sigma"]), p["unit"]) for p in model["parameters"])
    return Table(("parameter", "value ± one sigma", "unit"), rows, "Parameters of the rig, in frame M at stage 1 = 0")


def _correlations(model: Content) -> list[Block]:
    """Pairs of parameters that the frames hardly tell apart."""
    covariance = np.array(model["covariance"], dtype=np.float64)
    names = [parameter["name"] for parameter in model["parameters"]]
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.maximum(np.outer(sigma, sigma), 1e-300)
    strong = np.argwhere(np.triu(np.abs(correlation) > _STRONG, 1)).tolist()
    if not strong:
        return []
    pairs = sorted(strong, key=lambda pair: -abs(correlation[pair[0], pair[1]]))[:12]
    rows = tuple((names[i], names[j], signed(float(correlation[i, j]), 3)) for i, j in pairs)
    return [
        Table(
            ("parameter", "and", "correlation"), rows, f"Correlations beyond {_STRONG:g}: only together are they known"
        )
    ]


def _residuals(run: Run) -> list[Block]:
    try:
        with np.load(run.folder.results.path("arrays.npz"), allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files if name.startswith(_RESIDUAL)}
    except (StoreError, OSError, ValueError):
        return []
    panels = [Panel(name.removeprefix(_RESIDUAL).replace("_", " "), values) for name, values in found.items()]
    panels = [panel for panel in panels if panel.values.ndim == 2]
    if not panels:
        return []
    figure = maps(panels, unit="residual (sigmas)", colours="signed")
    caption = "What the model leaves of the phases at each stage position, in sigmas of the mean of a cell."
    return [Picture("rig_residuals", figure, "Maps of the residuals of the rig model.", caption)]
