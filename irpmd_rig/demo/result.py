"""The demonstration's figures, each beside the truth of the world and the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from irpmd_rig.demo.paper import PaperTable, table_of
from irpmd_rig.demo.truth import Truth

Content = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Measured:
    """What the daemon computed: the JSON documents of its runs.

    Attributes
    ----------
    camera, plate, geometry
        Of the calibrations.
    measurement
        Of the measurement.
    """

    camera: Content
    plate: Content
    geometry: Content
    measurement: Content

    @property
    def steps(self) -> list[Content]:
        """Steps between neighbouring facets."""
        return list(self.measurement["steps"])


@dataclass(frozen=True, slots=True)
class Result:
    """Everything that is printed."""

    world: str
    subject: str
    out: Path
    seconds: float
    measured: Measured
    truth: Truth

    @property
    def compared(self) -> bool:
        """Whether measured steps and true ones can be set side by side."""
        return len(self.truth.steps_mm) == len(self.measured.steps) > 0

    @property
    def facets(self) -> int:
        """Facets that were found."""
        return len(self.measured.measurement["facets"])

    def as_json(self) -> dict[str, Any]:
        """One object with true and measured steps in mm."""
        lens, geometry = self.measured.camera["intrinsics"], self.measured.geometry
        return {
            "world": self.world,
            "object": self.subject,
            "seed": self.truth.seed,
            "out": str(self.out),
            "seconds": round(self.seconds, 1),
            "true_steps_mm": self.truth.steps_mm,
            "measured_steps_mm": [step["measured_mm"] for step in self.measured.steps],
            "method": self.measured.measurement["method"],
            "step_definition": self.measured.measurement["step_definition"],
            "steps": [self._step_json(k, step) for k, step in enumerate(self.measured.steps)],
            "largest_step_error_um": self._largest_error_um(self.measured.steps),
            "largest_step_error_by_method_um": self._errors_by_method_um(),
            "facets": self.facets,
            "all_facets_found": self.facets == len(self.truth.steps_mm) + 1,
            "depth_rms_um": self.truth.depth_rms_um,
            "calibration": {
                "fx_px": lens["focal_px"][0],
                "fx_true_px": self.truth.focal_px[0],
                "fx_sigma_px": lens["sigma_focal_px"][0],
                "fy_px": lens["focal_px"][1],
                "fy_true_px": self.truth.focal_px[1],
                "d_mm": geometry["d_mm"],
                "d_true_mm": self.truth.d_mm,
                "d_sigma_mm": geometry["sigma_d_mm"],
                "d_seen_mean_mm": geometry["d_seen_mean_mm"],
                "gamma_deg": geometry["gamma_deg"],
                "plate_order": self.measured.plate["order"],
            },
        }

    def _step_json(self, index: int, step: Content) -> dict[str, Any]:
        told = (
            "name", "measured_mm", "mean_height_difference_mm",
            "uncertainty_um", "random_um", "calibration_um", "alignment_um",
        )  # fmt: skip
        content = {key: step[key] for key in told}
        if self.compared:
            true_mm = self.truth.steps_mm[index]
            content |= {"true_mm": true_mm, "error_um": 1e3 * (step["measured_mm"] - true_mm)}
        return content

    def _largest_error_um(self, steps: Sequence[Content]) -> float | None:
        if not len(self.truth.steps_mm) == len(steps) > 0:
            return None
        pairs = zip(steps, self.truth.steps_mm, strict=True)
        return max(1e3 * abs(float(step["measured_mm"]) - true_mm) for step, true_mm in pairs)

    def _errors_by_method_um(self) -> dict[str, float | None]:
        methods = self.measured.measurement["methods"]
        return {name: self._largest_error_um(method["steps"]) for name, method in methods.items()}

    def print(self, console: Console) -> None:
        """Print the tables for a person."""
        console.print(self._calibration_table())
        if self.measured.steps:
            console.print(self._step_table())
        for method, error_um in self._errors_by_method_um().items():
            if error_um is not None:
                console.print(f"{method}: largest step error {error_um:.1f} um", highlight=False)
        if self.measured.steps and not self.compared:
            console.print(
                f"only {self.facets} of the object's {len(self.truth.steps_mm) + 1} facets were found: "
                "the steps are not those of the world file",
                style="red",
            )
        console.print(
            f"depth map: {self.facets} facets, {self.truth.depth_rms_um:.0f} um rms a pixel "
            f"against the traced surface; {self.seconds:.0f} s; results in {self.out}",
            highlight=False,
        )

    def _calibration_table(self) -> Table:
        table = Table("", "estimate", "one sigma", "truth", title=f"calibration in {self.world}")
        lens, geometry = self.measured.camera["intrinsics"], self.measured.geometry
        for name, axis in (("fx (px)", 0), ("fy (px)", 1)):
            estimate, sigma = lens["focal_px"][axis], lens["sigma_focal_px"][axis]
            table.add_row(name, f"{estimate:.3f}", f"{sigma:.3f}", f"{self.truth.focal_px[axis]:.3f}")
        table.add_row("d (mm)", f"{geometry['d_mm']:.4f}", f"{geometry['sigma_d_mm']:.4f}", f"{self.truth.d_mm:.4f}")
        table.add_row("d, mean over the seen glass (mm)", f"{geometry['d_seen_mean_mm']:.4f}", "", "")
        angles = (f"{geometry[name]:.3f}" for name in ("alpha_deg", "beta_deg", "gamma_deg"))
        table.add_row("alpha, beta, gamma (deg)", ", ".join(angles), "", "")
        return table

    def _step_table(self) -> Table:
        paper = table_of(self.truth.steps_mm)
        columns = ["step", "measured (mm)", "sigma (um)"]
        columns += ["truth (mm)", "error (um)"] if self.compared else []
        columns += ["paper (mm)", "its error (um)"] if self.compared and paper else []
        caption = self.measured.measurement["step_definition"]
        table = Table(*columns, title=f"{self.subject}, {self.measured.measurement['method']}", caption=caption)
        for index, step in enumerate(self.measured.steps):
            row = [step["name"], f"{step['measured_mm']:.4f}", f"{step['uncertainty_um']:.1f}"]
            if self.compared:
                row += self._beside_truth(index, step, paper)
            table.add_row(*row)
        return table

    def _beside_truth(self, index: int, step: Content, paper: PaperTable | None) -> list[str]:
        true_mm = self.truth.steps_mm[index]
        cells = [f"{true_mm:.4f}", f"{1e3 * (step['measured_mm'] - true_mm):+.1f}"]
        if paper:
            cells += [f"{paper.measured_mm[index]:.4f}", f"{paper.error_um(index):+.1f}"]
        return cells
