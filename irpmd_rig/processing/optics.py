"""What a measurement needs of its calibrations and its reference, read once and kept from run to run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Intrinsics, RigGeometry
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.reconstruction.glass_map import GlassMap, tabulate
from irpmd_rig.core.reconstruction.triangulation import RigTables, rig_tables
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.archive import CameraResult, Content, read_geometry
from irpmd_rig.processing.archive_rig import VARIATIONS, read_model, read_variations
from irpmd_rig.processing.chain import Chain
from irpmd_rig.processing.errors import Refused
from irpmd_rig.processing.regions import Mask, Window, bounding_box, common, within

_ANOTHER = "choose another calibration or reference, or make it again"


@dataclass(frozen=True, slots=True, eq=False)
class KnownRig:
    """The self-calibrated rig, and what of the picture is not the object.

    Attributes
    ----------
    model
        Its model.
    variations
        Models displaced by one sigma.
    outline_mm
        Of the glass, as `irpmd_rig.processing.glass.glass_outline` found it.
    along_y
        Whether the model holds for fringes along y, too.
    sprayed
        Where the sprayed part of the reference mirror was, (H, W).
    chi2_per_dof
        Of the calibration.
    tables
        What triangulating needs again and again.
    """

    model: RigModel
    variations: tuple[RigModel, ...]
    outline_mm: NDArray[np.float64]
    along_y: bool
    sprayed: Mask
    chi2_per_dof: float
    tables: RigTables
    _varied: list[tuple[GlassMap, GlassMap]] = field(default_factory=list)

    def varied_maps(self) -> Sequence[tuple[GlassMap, GlassMap]]:
        """Maps of the glass along x and y of each variation: seconds at the first call, then kept."""
        if not self._varied:
            # All or none: what one failure left would pass for the whole at the next call.
            self._varied.extend([(tabulate(model, 0), tabulate(model, 1)) for model in self.variations])
        return self._varied


@dataclass(frozen=True, slots=True, eq=False)
class References:
    """Phases of the reference mirror.

    Attributes
    ----------
    window
        Rows and columns in which it is seen at every position.
    phases_rad
        In this window, in the order of the reference's positions.
    positions_mm
        Of stage 1.
    sigma_rad
        Of each phase: what smoothing leaves.
    true_mm
        The positions as the glass seen in the same frames tells them; `positions_mm` where it does not.
    """

    window: Window
    phases_rad: tuple[NDArray[np.float64], ...]
    positions_mm: tuple[float, ...]
    sigma_rad: tuple[float, ...]
    true_mm: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Optics:
    """What a measurement needs of its calibrations and its reference.

    Attributes
    ----------
    intrinsics
        The camera.
    geometry
        Planes, d and frame M.
    geometry_at_mm
        Stage 1 at which d holds.
    rig
        None where the geometry was calibrated at one position.
    references
        None where there is no reference.
    """

    intrinsics: Intrinsics
    geometry: RigGeometry
    geometry_at_mm: float
    rig: KnownRig | None
    references: References | None


def load_optics(chain: Chain) -> Optics:
    """Read the calibrations and the reference of a measurement; raises Refused if one is damaged."""
    try:
        geometry = chain.content("calibrate-geometry")
        return Optics(
            intrinsics=CameraResult.read(chain.content("calibrate-camera")).camera.intrinsics,
            geometry=read_geometry(geometry),
            geometry_at_mm=float(geometry["stage1_mm"]),
            rig=_rig(chain, geometry["rig_model"]) if chain.has_model else None,
            references=_references(chain) if "reference" in chain.uses else None,
        )
    except (KeyError, TypeError, ValueError, CalibrationError) as error:
        used = ", ".join(f"{kind} {run}" for kind, run in chain.uses.items())
        raise Refused(f"a calibration or reference is damaged ({error!r}): {used}", _ANOTHER) from None


def known_glass(chain: Chain) -> tuple[RigModel, NDArray[np.float64]] | None:
    """Rig model and outline of the glass by the calibration of the geometry; None if it has no model.

    Raises
    ------
    Refused
        If it is damaged.
    """
    content = chain.content("calibrate-geometry").get("rig_model")
    if content is None:
        return None
    try:
        return read_model(content["model"]), np.array(content["glass_outline_mm"], np.float64).reshape(-1, 2)
    except (KeyError, TypeError, ValueError, CalibrationError) as error:
        run = chain.uses["calibrate-geometry"]
        raise Refused(f"calibrate-geometry {run} is damaged ({error!r})", _ANOTHER) from None


def _rig(chain: Chain, content: Content) -> KnownRig:
    model = read_model(content["model"])
    return KnownRig(
        model=model,
        variations=read_variations(chain.document("calibrate-geometry", VARIATIONS)),
        outline_mm=np.array(content["glass_outline_mm"], np.float64).reshape(-1, 2),
        along_y=bool(content.get("along_y", False)),
        sprayed=np.asarray(chain.array("calibrate-geometry", "sprayed"), np.bool_),
        chi2_per_dof=float(content["chi2_per_dof"]),
        tables=rig_tables(model, np.float32),
    )


def _references(chain: Chain) -> References:
    """Phases of the reference mirror, cut to what is seen of it: the picture holds much else."""
    positions = [float(position) for position in chain.content("reference")["positions_mm"]]
    cut = []
    for place in range(len(positions)):
        whole = chain.array("reference", f"position_{place + 1}_rad")
        box = bounding_box(np.isfinite(whole))
        if box is None:
            raise ValueError(f"the reference mirror is not seen at position {place + 1}")
        # A copy, so that the whole is let go.
        cut.append((box, whole[box].astype(np.float64)))
    window = common([box for box, _ in cut])
    phases = tuple(np.ascontiguousarray(phase[within(window, box)]) for box, phase in cut)
    content = chain.content("reference")
    # Of a reference without these figures the smoothing is taken to leave nothing, and the stage to be right.
    left = [float(station.get("coherent_rad") or 0.0) for station in content.get("stations", [{}] * len(positions))]
    true_mm = content.get("positions_true_mm", positions)
    return References(window, phases, tuple(positions), tuple(left), tuple(float(value) for value in true_mm))
