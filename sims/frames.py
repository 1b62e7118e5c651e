"""Attitudes as 3 x 3 matrices whose rows are a body's axes.

Frame W is the world, frame M rides on stage1 (camera, mirror, objects) and equals W at stage1 = 0.
"""

import math

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


def turn(about_x_deg: float, about_y_deg: float) -> Matrix:
    """Rotation by `about_x_deg` about x, then by `about_y_deg` about the fixed y axis (right-handed)."""
    ax, ay = math.radians(about_x_deg), math.radians(about_y_deg)
    about_x = np.array([[1, 0, 0], [0, math.cos(ax), -math.sin(ax)], [0, math.sin(ax), math.cos(ax)]])
    about_y = np.array([[math.cos(ay), 0, math.sin(ay)], [0, 1, 0], [-math.sin(ay), 0, math.cos(ay)]])
    return np.asarray(about_y @ about_x, dtype=np.float64)


def attitude(axis: tuple[float, float, float], roll_deg: float) -> Matrix:
    """Axes (rows: x along columns, y along rows, z forward) of a camera or projector.

    At roll 0, x is the part of the world's x axis normal to z, and y = z cross x; a positive roll turns x
    toward y.
    """
    z = np.asarray(axis, dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    roll = math.radians(roll_deg)
    c, s = math.cos(roll), math.sin(roll)
    return np.stack([c * x + s * y, c * y - s * x, z])


def slopes(about_x_deg: float, about_y_deg: float) -> tuple[float, float]:
    """Slopes dz/dx and dz/dy of a plane z = 0 turned by two angles (as in `turn`)."""
    normal = turn(about_x_deg, about_y_deg)[:, 2]
    return float(-normal[0] / normal[2]), float(-normal[1] / normal[2])
