"""Pictures on the projector's mirrors: what tells them apart, and the light that they become."""

import hashlib
from collections import OrderedDict
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sims.render import projected_light

if TYPE_CHECKING:
    from sims.instruments import Projector

# The patterns of a burst and some more; the light of one takes 13 MB.
_LIGHTS_KEPT = 16
_DIGESTS_KEPT = 64
BLACK = "black"


class Pictures:
    """Digests and light of pictures, remembered: a burst shows the same few again and again.

    Parameters
    ----------
    projector : Projector
    """

    def __init__(self, projector: "Projector") -> None:
        self._projector = projector
        # By identity; the picture is kept, too, so that no other one takes its place in memory.
        self._digests: OrderedDict[int, tuple[NDArray[np.uint8], str]] = OrderedDict()
        self._lights: OrderedDict[str, NDArray[np.float32]] = OrderedDict()

    def digest(self, image: NDArray[np.uint8] | None) -> str:
        """Return what is the same for equal pictures only; None is the black one."""
        if image is None:
            return BLACK
        known = self._digests.get(id(image))
        if known is None:
            text = hashlib.blake2b(np.ascontiguousarray(image).data, digest_size=16).hexdigest()
            if image.flags.writeable:
                return text
            while len(self._digests) >= _DIGESTS_KEPT:
                self._digests.popitem(last=False)
            known = self._digests[id(image)] = (image, text)
        return known[1]

    def light(self, image: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the light of a picture (`sims.render.projected_light`)."""
        digest = self.digest(image)
        light = self._lights.pop(digest, None)
        if light is None:
            while len(self._lights) >= _LIGHTS_KEPT:
                self._lights.popitem(last=False)
            light = projected_light(self._projector, image)
        self._lights[digest] = light
        return light
