"""Figures 6 to 13 of the paper: what each shows, drawn from runs of ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from irpmd_rig.report.content import Block, Picture, Section, Table, Text, Turnable
from irpmd_rig.report.figures_maps import Colours, Panel, maps
from irpmd_rig.report.figures_surface import surface
from irpmd_rig.report.mesh import mesh_of
from irpmd_rig.report.wording import micrometres
from irpmd_rig.reproduce.results import DEPTH_EQUATION, OURS, Results
from irpmd_rig.reproduce.scheme import FAN, FREEFORM, STEP
from irpmd_rig.reproduce.taken import Taken, Views

_TITLES = {STEP: "mirror step", FAN: "fan-shaped mirror step", FREEFORM: "two freeform mirrors"}


def figure_sections(results: Results) -> tuple[Section, ...]:
    """Figures 6 to 8 of the mirror step, 9 to 13 of the two freeform mirrors and the fan."""
    step = _seen(results, "paper", STEP)
    both = [("a", _seen(results, "paper", FREEFORM)), ("b", _seen(results, "paper", FAN))]
    objects = [(letter, taken) for letter, taken in both if taken is not None]
    sections = []
    if step is not None:
        blocks = (*_photo("6a", step), *_fringes("6b", step), *_phases("7", step), *_shape(results, "8", step))
        sections.append(Section("Figures 6 to 8: mirror step", blocks))
    if objects:
        drawn: list[Block] = []
        for figure in (_photo, _fringes, _wrapped, _absolute):
            number = {_photo: "9", _fringes: "10", _wrapped: "11", _absolute: "12"}[figure]
            drawn += [block for letter, taken in objects for block in figure(f"{number}{letter}", taken)]
        drawn += [block for letter, taken in objects for block in _shape(results, f"13{letter}", taken)]
        freeform = _freeform(results)
        drawn += [] if freeform is None else [freeform]
        sections.append(Section("Figures 9 to 13: separate mirrors", tuple(drawn)))
    return tuple(sections)


def _seen(results: Results, use: str, subject: str) -> Taken | None:
    taken = results.of(use, subject)
    return taken if taken is not None and taken.views is not None else None


def _views(taken: Taken) -> Views:
    assert taken.views is not None  # asked by `_seen`
    return taken.views


def _drawn(name: str, panels: Sequence[Panel], taken: Taken, caption: str, **colouring: str) -> tuple[Picture]:
    """One of the paper's figures, its source named."""
    unit, colours = colouring["unit"], colouring["colours"]
    kind: Colours = colours  # type: ignore[assignment]
    figure = maps(panels, unit=unit, colours=kind, window=_views(taken).window)
    told = f"Figure {name}. {caption} Run {taken.run_id}."
    return (Picture(f"figure_{name}", figure, told, told),)


def _photo(name: str, taken: Taken) -> tuple[Picture]:
    title = _TITLES[taken.task.subject]
    mean = _views(taken).frames[0].mean(axis=0)
    caption = f"The paper: a photo of the {title}. Here: the mean of the phase steps, as if the glass shone evenly."
    return _drawn(name, [Panel(title, mean)], taken, caption, unit="frame (DN)", colours="grey")


def _fringes(name: str, taken: Taken) -> tuple[Picture]:
    panels = [Panel(f"{count:g} fringes", steps[0]) for count, steps in _by_count(taken, _views(taken).frames)]
    title = _TITLES[taken.task.subject]
    caption = f"The paper: captured infrared fringes in the {title}. Here: the first frame of each set at 0 mm."
    return _drawn(name, panels, taken, caption, unit="frame (DN)", colours="grey")


def _wrapped(name: str, taken: Taken) -> tuple[Picture]:
    panels = [Panel(f"{count:g} fringes", phase) for count, phase in _by_count(taken, _views(taken).wrapped_rad)]
    caption = f"Wrapped phase of the {_TITLES[taken.task.subject]}, as in the paper: four steps, each set by itself."
    return _drawn(name, panels, taken, caption, unit="wrapped phase (rad)", colours="phase")


def _absolute(name: str, taken: Taken) -> tuple[Picture]:
    caption = (
        f"Absolute phase of the {_TITLES[taken.task.subject]}, as in the paper: by the optimum three fringe numbers."
    )
    panel = Panel("absolute phase of the finest set", _views(taken).absolute_rad)
    return _drawn(name, [panel], taken, caption, unit="absolute phase (rad)", colours="height")


def _phases(name: str, taken: Taken) -> tuple[Picture, ...]:
    return (*_wrapped(f"{name}abc", taken), *_absolute(f"{name}d", taken))


def _by_count(taken: Taken, values: np.ndarray) -> list[tuple[float, np.ndarray]]:
    return list(zip(taken.content["counts"], values, strict=True))


def _shape(results: Results, name: str, taken: Taken) -> tuple[Block, ...]:
    """Shape by the paper's method and by ours, and how far either is from the truth."""
    blocks: list[Block] = []
    errors: list[tuple[str, Taken]] = [("the paper's method", taken)]
    precise = _seen(results, "precise", taken.task.subject)
    errors += [("ours, precise recipe", precise)] if precise is not None else []
    for suffix, (way, one) in zip(("", "_ours"), errors, strict=False):
        shape = _views(one).shape
        mesh = None if shape is None else mesh_of(shape.points_mm, shape.labels, shape.residual_um)
        if shape is None or mesh is None:
            blocks.append(Text(f"Figure {name}: no shape was found by {way} (run {one.run_id})."))
            continue
        caption = (
            f"Figure {name}. The paper: 3-D shape of the {_TITLES[one.task.subject]}. Here by {way}. Run {one.run_id}."
        )
        still = Picture(f"figure_{name}{suffix}", surface(shape.points_mm, shape.labels), caption, caption)
        blocks.append(Turnable(mesh, still))
    for suffix, (way, one) in zip(("", "_ours"), errors, strict=False):
        shape, error_um = _views(one).shape, _views(one).error_um
        if shape is None or error_um is None or not np.isfinite(error_um).any():
            continue
        caption = f"Height of each pixel minus the true one, by {way}; the paper shows none. Run {one.run_id}."
        figure = maps([Panel(way, error_um)], unit="error (µm)", colours="signed", window=shape.window)
        blocks.append(Picture(f"figure_{name}_error{suffix}", figure, caption, caption))
    return tuple(blocks)


def _freeform(results: Results) -> Table | None:
    rows = []
    asked = (("paper", DEPTH_EQUATION), ("paper", OURS), ("precise", OURS))
    for use, method in asked:
        taken = results.of(use, FREEFORM)
        found = None if taken is None else taken.compared.get(method)
        if taken is not None and found is not None:
            figures = (found.shape_um, found.absolute_um, found.gap_um)
            recipe = "the paper's" if use == "paper" else "precise"
            rows.append((f"{method}, {recipe} recipe", *map(micrometres, figures), taken.run_id))
    columns = ("method", "shape, rms (µm)", "with piston, rms (µm)", "step across the gap (µm)", "run")
    caption = "Two freeform mirrors beside the truth; the paper gives no figures"
    return Table(columns, tuple(rows), caption) if rows else None
