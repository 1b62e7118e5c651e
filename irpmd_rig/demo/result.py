"""The demonstration's figures, each beside the truth of the world and the paper's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from irpmd_rig.core import Step
from irpmd_rig.demo.evaluate import Evaluation
from irpmd_rig.demo.paper import PaperTable, table_of
from irpmd_rig.demo.procedure import Calibration


@dataclass(frozen=True, slots=True)
class Truth:
    """What the world knows and the measurement was not told.

    Attributes
    ----------
    steps_mm : list of float
        Of the traced facets, taken where the measured steps are; of the world file where not all were measured.
    d_mm : float
        Along the reference's normal at the middle of the glass.
    focal_px : tuple of float
        fx, fy.
    depth_rms_um : float
        Of the depth map against the traced surface, pixel by pixel, inside the facets found.
    """

    steps_mm: list[float]
    d_mm: float
    focal_px: tuple[float, float]
    depth_rms_um: float


@dataclass(frozen=True, slots=True)
class Result:
    """Everything that is printed."""

    world: str
    subject: str
    seed: int
    out: Path
    seconds: float
    calibration: Calibration
    evaluation: Evaluation
    truth: Truth

    @property
    def compared(self) -> bool:
        """Whether measured steps and true ones can be set side by side."""
        return len(self.truth.steps_mm) == len(self.evaluation.steps) > 0

    def as_json(self) -> dict[str, Any]:
        """One object with true and measured steps in mm."""
        geometry, camera = self.calibration.geometry, self.calibration.camera
        return {
            "world": self.world,
            "object": self.subject,
            "seed": self.seed,
            "out": str(self.out),
            "seconds": round(self.seconds, 1),
            "true_steps_mm": self.truth.steps_mm,
            "measured_steps_mm": [step.height_mm for step in self.evaluation.steps],
            "step_definition": self.evaluation.definition,
            "steps": [self._step_json(k, step) for k, step in enumerate(self.evaluation.steps)],
            "largest_step_error_um": self._largest_error_um(),
            "facets": self.evaluation.facet_count,
            "all_facets_found": self.evaluation.facet_count == len(self.truth.steps_mm) + 1,
            "depth_rms_um": self.truth.depth_rms_um,
            "calibration": {
                "fx_px": camera.intrinsics.focal_px[0],
                "fx_true_px": self.truth.focal_px[0],
                "fx_sigma_px": camera.sigma_focal_px[0],
                "fy_px": camera.intrinsics.focal_px[1],
                "fy_true_px": self.truth.focal_px[1],
                "d_mm": geometry.d_mm,
                "d_true_mm": self.truth.d_mm,
                "d_sigma_mm": geometry.sigma_d_mm,
                "d_seen_mean_mm": geometry.d_seen_mean_mm,
                "gamma_deg": float(np.rad2deg(geometry.gamma_rad)),
                "plate_order": self.calibration.relation.order,
            },
        }

    def _step_json(self, index: int, step: Step) -> dict[str, Any]:
        content: dict[str, Any] = {
            "name": step.name,
            "measured_mm": step.height_mm,
            "mean_height_difference_mm": step.mean_height_difference_mm,
            "uncertainty_um": step.combined_um,
            "random_um": step.random_um,
            "calibration_um": step.calibration_um,
            "alignment_um": step.alignment_um,
        }
        if self.compared:
            true_mm = self.truth.steps_mm[index]
            content |= {"true_mm": true_mm, "error_um": 1e3 * (step.height_mm - true_mm)}
        return content

    def _largest_error_um(self) -> float | None:
        if not self.compared:
            return None
        pairs = zip(self.evaluation.steps, self.truth.steps_mm, strict=True)
        return max(1e3 * abs(step.height_mm - true_mm) for step, true_mm in pairs)

    def print(self, console: Console) -> None:
        """Print the tables for a person."""
        console.print(self._calibration_table())
        if self.evaluation.steps:
            console.print(self._step_table())
        if self.evaluation.steps and not self.compared:
            console.print(
                f"only {self.evaluation.facet_count} of the object's {len(self.truth.steps_mm) + 1} facets were found: "
                "the steps are not those of the world file",
                style="red",
            )
        console.print(
            f"depth map: {self.evaluation.facet_count} facets, {self.truth.depth_rms_um:.0f} um rms a pixel "
            f"against the traced surface; {self.seconds:.0f} s; results in {self.out}",
            highlight=False,
        )

    def _calibration_table(self) -> Table:
        table = Table("", "estimate", "one sigma", "truth", title=f"calibration in {self.world}")
        camera, geometry = self.calibration.camera, self.calibration.geometry
        for name, axis in (("fx (px)", 0), ("fy (px)", 1)):
            estimate, sigma = camera.intrinsics.focal_px[axis], camera.sigma_focal_px[axis]
            table.add_row(name, f"{estimate:.3f}", f"{sigma:.3f}", f"{self.truth.focal_px[axis]:.3f}")
        table.add_row("d (mm)", f"{geometry.d_mm:.4f}", f"{geometry.sigma_d_mm:.4f}", f"{self.truth.d_mm:.4f}")
        table.add_row("d, mean over the seen glass (mm)", f"{geometry.d_seen_mean_mm:.4f}", "", "")
        angles = (geometry.alpha_rad, geometry.beta_rad, geometry.gamma_rad)
        table.add_row("alpha, beta, gamma (deg)", ", ".join(f"{np.rad2deg(angle):.3f}" for angle in angles), "", "")
        return table

    def _step_table(self) -> Table:
        paper = table_of(self.truth.steps_mm)
        columns = ["step", "measured (mm)", "sigma (um)"]
        columns += ["truth (mm)", "error (um)"] if self.compared else []
        columns += ["paper (mm)", "its error (um)"] if self.compared and paper else []
        table = Table(*columns, title=f"{self.subject}, depth equation", caption=self.evaluation.definition)
        for index, step in enumerate(self.evaluation.steps):
            row = [step.name, f"{step.height_mm:.4f}", f"{step.combined_um:.1f}"]
            if self.compared:
                row += self._beside_truth(index, step, paper)
            table.add_row(*row)
        return table

    def _beside_truth(self, index: int, step: Step, paper: PaperTable | None) -> list[str]:
        true_mm = self.truth.steps_mm[index]
        cells = [f"{true_mm:.4f}", f"{1e3 * (step.height_mm - true_mm):+.1f}"]
        if paper:
            cells += [f"{paper.measured_mm[index]:.4f}", f"{paper.error_um(index):+.1f}"]
        return cells
