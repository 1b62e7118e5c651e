"""Infrared phase-measuring deflectometry: the shape of mirror-like, also discontinuous, objects."""

import os

# Before numpy is loaded: matrix products are small here, so OpenBLAS's threads gain nothing, and by spinning for work
# they take the cores from the camera and from the kernels' own threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
