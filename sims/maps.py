"""Light maps of a world, traced once and kept for the last few setups."""

from collections import OrderedDict
from typing import TYPE_CHECKING

from sims.optics import LightMap, light_map
from sims.setup import Setup

if TYPE_CHECKING:
    from sims.world import World

# A map of a 2048 x 2048 camera takes 67 MB; a measurement goes to and fro between few setups.
_KEPT = 3


class LightMaps:
    """Light maps by setup; not for several threads at once.

    Parameters
    ----------
    world : World
    """

    def __init__(self, world: "World") -> None:
        self._world = world
        self._maps: OrderedDict[Setup, LightMap] = OrderedDict()

    def of(self, setup: Setup) -> LightMap:
        """Return the light map of a setup.

        Raises
        ------
        SimulationError
            The world has no such subject or board pose.
        """
        found = self._maps.pop(setup, None)
        if found is None:
            while len(self._maps) >= _KEPT:
                self._maps.popitem(last=False)
            found = light_map(self._world, setup)
        self._maps[setup] = found
        return found
