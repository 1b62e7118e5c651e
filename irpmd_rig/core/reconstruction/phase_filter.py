"""What smooth surfaces allow: phases without most of their noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpmd_rig.core.reconstruction.local_fit import local_fit
from irpmd_rig.core.reconstruction.smooth_regions import smooth_regions
from irpmd_rig.core.reconstruction.views import Map, Views

FILTER_RADIUS_PX = 3


def filter_phase(views: Views) -> Views:
    """Replace every phase by the middle of a quadratic surface fitted to its neighbours on the same facet.

    Parameters
    ----------
    views : Views
        Phases of an object.

    Returns
    -------
    Views
        With filtered phases and their sigmas; pixels next to a jump of the phase, and of regions too narrow for a fit,
        are as they were.

    Notes
    -----
    Least squares over 7 x 7 pixels, cut to the pixel's own smooth region (`smooth_regions`): nothing of another facet
    enters. Inside a facet the noise falls to 0.31 of what it was; pixels nearer than 7 to each other are then no
    longer independent. What the surface has beyond second order over 7 pixels is smoothed away.
    """
    regions = smooth_regions(views)
    rows, columns = views.shape
    x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))

    def filtered(phases: tuple[Map, ...]) -> tuple[tuple[Map, ...], tuple[Map, ...]]:
        results, sigmas = [], []
        for phase, sigma in zip(phases, views.sigmas_rad, strict=True):
            fit = local_fit(x, y, phase, regions, FILTER_RADIUS_PX)
            known = np.isfinite(fit.value)
            results.append(np.where(known, fit.value, phase).astype(phase.dtype, copy=False))
            sigmas.append(np.where(known, sigma * np.sqrt(fit.gain), sigma).astype(sigma.dtype, copy=False))
        return tuple(results), tuple(sigmas)

    phases, sigmas = filtered(views.phases_rad)
    along_y = None if views.phases_y_rad is None else filtered(views.phases_y_rad)[0]
    return replace(views, phases_rad=phases, sigmas_rad=sigmas, phases_y_rad=along_y)
