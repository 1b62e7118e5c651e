"""True values of what the rig measures."""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sims.errors import SimulationError
from sims.surfaces import Patch, object_patches

if TYPE_CHECKING:
    from sims.world import World


def true_planes_mm(world: "World", name: str) -> NDArray[np.float64]:
    """Top planes of an object's facets, in rising order.

    Returns
    -------
    array (facets, 3): a, b, c of z = a + b x + c y in frame M, in mm.

    Raises
    ------
    SimulationError
        The world has no such object, or its facets are not flat.
    """
    patches = _facets(world, name)
    if not all(patch.is_flat for patch in patches):
        raise SimulationError(f"the facets of '{name}' are not flat")
    return np.array([[p.origin[2] - p.origin[:2] @ p.slope, *p.slope] for p in patches])


def true_steps_mm(world: "World", name: str) -> list[float]:
    """Step heights between neighbouring facets of an object, in rising order.

    Of two flat facets, the difference of their (extended) planes along z, halfway between the centroids of
    their outlines; where no facet is tilted this is the step of the world file. Of freeform mirrors, the difference
    along z of their surfaces at the origins of their frames, bumps left out.

    Raises
    ------
    SimulationError
        The world has no such object.
    """
    patches = _facets(world, name)
    if not all(patch.is_flat for patch in patches):
        return [float(upper.origin[2] - lower.origin[2]) for lower, upper in pairwise(patches)]
    planes = true_planes_mm(world, name)
    middles = [(lower.origin + upper.origin)[:2] / 2 for lower, upper in pairwise(patches)]
    return [float((planes[k + 1] - planes[k]) @ (1.0, *middle)) for k, middle in enumerate(middles)]


def true_d_mm(world: "World") -> float:
    """Distance d at stage1 = 0 along the reference's normal, from below the glass's centre to its plane.

    It begins at (x, y of the centre, 0) of frame M. The glass turns about its centre, so d is the z of the
    centre whatever the tilts; a bow leaves the centre where it is.
    """
    return world.glass.centre_mm[2]


def _facets(world: "World", name: str) -> list[Patch]:
    if name not in world.objects:
        known = ", ".join(world.objects) or "none"
        raise SimulationError(f"there is no object '{name}': this world has {known}")
    return object_patches(world, name)
