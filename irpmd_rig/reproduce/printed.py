"""What the paper prints beside the steps of `irpmd_rig.demo.paper`: Table 1, the visible light of Table 3, errata."""

from __future__ import annotations

from dataclasses import dataclass

from irpmd_rig.demo.paper import TABLE_2, TABLE_3, PaperTable

TABLE_3_VISIBLE = PaperTable(
    "Table 3, fan-shaped mirror step, visible light",
    TABLE_3.actual_mm,
    (6.52437, 5.47372, 4.96414, 4.02947, 3.03436),
)

PRINTED_ERRORS_MM: dict[PaperTable, tuple[float, ...]] = {
    TABLE_2: (0.0213, 0.0035, 0.0079, 0.0194),
    TABLE_3: (0.00574, 0.00447, 0.01071, 0.00767, 0.01782),
    TABLE_3_VISIBLE: (0.02399, 0.02654, 0.03612, 0.02932, 0.03420),
}
"""Absolute errors as they stand in the tables."""


@dataclass(frozen=True, slots=True)
class PrintedLens:
    """A line of Table 1: a value and its printed uncertainty, in pixels or without a unit."""

    name: str
    value: float
    uncertainty: float


TABLE_1 = (
    PrintedLens("fx (px)", 2355.03482, 1.47732),
    PrintedLens("fy (px)", 2355.59838, 1.46593),
    PrintedLens("cx (px)", 1016.92767, 0.27911),
    PrintedLens("cy (px)", 1018.56904, 0.25847),
    PrintedLens("k1", -0.13744, 0.00044),
    PrintedLens("k2", 0.14780, 0.00308),
    PrintedLens("p1", -0.00004, 0.00002),
    PrintedLens("p2", -0.00016, 0.00002),
)
PIXEL_ERROR_PX = (0.03298, 0.02954)
"""Printed below Table 1, along columns and rows."""

_MISPRINT_MM = 2e-5  # more than the printed digits round

OTHER_ERRATA = (
    "Equation (3) lacks the pitch q.",
    "Equation (5) as printed has the opposite sign of what equations (1) to (4) give; the mended one is used.",
    "The board of 14 x 12 squares has 13 x 11 inner corners.",
    "Section 2.2 once lets the sprayed mirror on stage1 give depth and phase of every pixel; its step 2 and section "
    "3.2 use a white plate on stage2. The plate is followed.",
    "Section 3.3 filters the phase and removes the lens distortion while computing it. Here the filter stays inside "
    "facets, and undistortion concerns rays only.",
    "The lens is said to have 12 mm; Table 1 with pixels of 5.5 um says 12.95 mm, which is used.",
)


def misprints(table: PaperTable) -> tuple[int, ...]:
    """Rows of a table whose printed error is not measured minus actual, from 0."""
    printed = PRINTED_ERRORS_MM[table]
    return tuple(
        k for k, error_mm in enumerate(printed) if abs(abs(table.error_um(k)) - 1e3 * error_mm) > 1e3 * _MISPRINT_MM
    )


def errata() -> tuple[str, ...]:
    """All known errata of the paper in words, the wrong errors of its tables first."""
    found = [
        f"{table.name}, row {k + 1}-{k + 2}: the printed error is {PRINTED_ERRORS_MM[table][k]:.5f} mm; measured minus "
        f"actual is {abs(table.error_um(k)) / 1e3:.5f} mm, which is used."
        for table in PRINTED_ERRORS_MM
        for k in misprints(table)
    ]
    return (*found, *OTHER_ERRATA)
