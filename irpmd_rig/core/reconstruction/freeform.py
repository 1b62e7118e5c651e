"""Surfaces over the camera's rays: planes, low polynomials, and splines that smooth themselves and go on smoothly.

A surface is its inverse range w = 1 / Z over the ideal image coordinates (X / Z, Y / Z) of the camera.  On a plane w
is linear in them; on any surface the plane that touches it there, q . P = 1, is linear in w and its derivatives
(`Rows.tangents`), and so in the surface's coefficients.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, PPoly

Array = NDArray[np.float64]

# Quintics over 2.5 mm on a facet of 30 mm: a bump of 5 mm rms width leaves below a nanometre, cubics 50 nm.
_SPANS = 12
_DEGREE = 5
# How far a surface may be continued beyond its facet, in spans: to the middle of a gap as wide as the facet.
_BEYOND = 6.0
# Cubics are not rough, so that a surface goes on as one where nothing was measured.
_ORDER = 4
FREE = _ORDER**2
"""Surfaces without roughness: the products of cubics."""
_NEAR = np.arange(_DEGREE + 1)
# The polynomials, highest power first, of the functions that count on a span, first to last: the pieces of one
# function from its last to its first, with the padding of its knots left out.
_PIECES = PPoly.from_spline(BSpline.basis_element(np.arange(_DEGREE + 2))).c[:, 2 * _DEGREE : _DEGREE - 1 : -1]


@dataclass(frozen=True, slots=True)
class Rows:
    """What the coefficients of a surface do at n places: their functions' values and derivatives there.

    Attributes
    ----------
    places : ndarray, (n, 2)
        Ideal image coordinates.
    columns : ndarray of int, (n, m)
        The coefficients that count at each place.
    value, by_x, by_y : ndarray, (n, m)
        Their functions and the derivatives by the two coordinates.
    count : int
        Number of all coefficients.
    """

    places: Array
    columns: NDArray[np.int64]
    value: Array
    by_x: Array
    by_y: Array
    count: int

    def inverse_range(self, coefficients: Array) -> Array:
        """w, (n,), 1/mm."""
        return np.asarray(np.einsum("nm,nm->n", self.value, coefficients[self.columns]))

    def tangents(self, coefficients: Array) -> Array:
        """Tangent planes q, (n, 3), 1/mm."""
        here = coefficients[self.columns]
        w, wx, wy = (np.einsum("nm,nm->n", part, here) for part in (self.value, self.by_x, self.by_y))
        return np.stack([wx, wy, w - self.places[:, 0] * wx - self.places[:, 1] * wy], axis=1)

    def matrix(self) -> Array:
        """Derivatives of w by the coefficients, (n, count)."""
        dense = np.zeros((len(self.columns), self.count))
        np.put_along_axis(dense, self.columns, self.value, axis=1)
        return dense

    def by_coefficients(self, gradient: Array) -> Array:
        """Derivatives by the coefficients of `columns`, (n, m), of what has the `gradient` (n, 3) by the tangents."""
        gx, gy, gz = (gradient[:, [axis]] for axis in range(3))
        x, y = self.places[:, :1], self.places[:, 1:]
        return gz * self.value + (gx - gz * x) * self.by_x + (gy - gz * y) * self.by_y

    def normal(self, entries: Array) -> Array:
        """J^T J, (count, count), of a matrix J with `entries` (n, m) in `columns`."""
        total = np.zeros((self.count, self.count))
        for cell, columns in self._cells():
            block = entries[cell]
            total[np.ix_(columns, columns)] += block.T @ block
        return total

    def slope(self, entries: Array, values: Array) -> Array:
        """J^T values, (count,), of the same matrix."""
        weights = (entries * values[:, None]).ravel()
        return np.bincount(self.columns.ravel(), weights, self.count).astype(np.float64)

    def variance(self, covariance: Array) -> Array:
        """Variance of w, (n,), from the coefficients' covariance."""
        variance = np.empty(len(self.value))
        for cell, columns in self._cells():
            value = self.value[cell]
            variance[cell] = ((value @ covariance[np.ix_(columns, columns)]) * value).sum(axis=1)
        return variance

    def _cells(self) -> Iterator[tuple[NDArray[np.intp], NDArray[np.int64]]]:
        """The places at which the same coefficients count, and these."""
        order = np.argsort(self.columns[:, 0], kind="stable")
        starts = np.flatnonzero(np.diff(self.columns[order, 0], prepend=-1))
        for cell in np.split(order, starts[1:]):
            yield cell, self.columns[cell[0]]


class Basis(Protocol):
    """Functions over the ideal image coordinates."""

    @property
    def count(self) -> int:
        """Number of coefficients."""

    def rows(self, places: Array) -> Rows:
        """Values and derivatives at places, (n, 2)."""

    def roughness(self) -> Array | None:
        """Quadratic form (count, count) that is zero for cubics; None where nothing needs smoothing."""


@dataclass(frozen=True, slots=True)
class Polynomial:
    """Polynomials of two variables up to a total degree; degree 1 are planes.

    Attributes
    ----------
    centre : tuple of float
        Origin of the variables.
    scale : float
        Their unit.
    degree : int
        The highest.
    """

    centre: tuple[float, float]
    scale: float
    degree: int

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return (self.degree + 1) * (self.degree + 2) // 2

    def rows(self, places: Array) -> Rows:
        """Values and derivatives at places, (n, 2)."""
        x, y = ((places - self.centre) / self.scale).T
        powers = [(i, total - i) for total in range(self.degree + 1) for i in range(total, -1, -1)]
        value = np.stack([x**i * y**j for i, j in powers], axis=1)
        by_x = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in powers], axis=1) / self.scale
        by_y = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in powers], axis=1) / self.scale
        columns = np.broadcast_to(np.arange(len(powers)), value.shape)
        return Rows(places, columns, value, by_x, by_y, len(powers))

    def roughness(self) -> None:
        """Nothing to smooth."""


@dataclass(frozen=True, slots=True)
class Spline:
    """Uniform quintic B-splines, a tensor product.

    Attributes
    ----------
    origin : tuple of float
        Corner of the first span.
    spacing : float
        Side of a span.
    spans : tuple of int
        Number of spans in the two directions.
    """

    origin: tuple[float, float]
    spacing: float
    spans: tuple[int, int]

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return (self.spans[0] + _DEGREE) * (self.spans[1] + _DEGREE)

    def holds(self, places: Array) -> NDArray[np.bool_]:
        """Whether places, (n, 2), lie on the facet or so near that the surface can be continued to them."""
        at = (places - self.origin) / self.spacing
        return np.asarray(((at >= -_BEYOND) & (at <= np.array(self.spans) + _BEYOND)).all(axis=-1))

    def rows(self, places: Array) -> Rows:
        """Values and derivatives at places, (n, 2); the outermost spans' polynomials go on beyond the edge."""
        at = (places - self.origin) / self.spacing
        first = np.clip(np.floor(at).astype(np.int64), 0, np.array(self.spans) - 1)
        (bx, dx), (by, dy) = (_functions(at[:, axis] - first[:, axis]) for axis in (0, 1))
        across = self.spans[1] + _DEGREE
        columns = (first[:, :1] + _NEAR)[:, :, None] * across + (first[:, 1:] + _NEAR)[:, None, :]

        def product(one: Array, other: Array) -> Array:
            return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(places), -1))

        return Rows(
            places,
            columns.reshape(len(places), -1),
            product(bx, by),
            product(dx, by) / self.spacing,
            product(bx, dy) / self.spacing,
            self.count,
        )

    def roughness(self) -> Array:
        """Sum of the squared fourth differences of the coefficients along both directions."""
        parts = []
        for axis in (0, 1):
            size = self.spans[axis] + _DEGREE
            differences = np.diff(np.eye(size), _ORDER, axis=0)
            square, other = differences.T @ differences, np.eye(self.spans[1 - axis] + _DEGREE)
            parts.append(np.kron(square, other) if axis == 0 else np.kron(other, square))
        return np.asarray(parts[0] + parts[1])


def spline_over(places: Array) -> Spline:
    """Spline that covers places, (n, 2)."""
    low, high = places.min(axis=0), places.max(axis=0)
    spacing = float((high - low).max()) / _SPANS
    spans = np.ceil((high - low) / spacing - 1e-9).astype(int)
    origin = (low + high) / 2 - spans * spacing / 2
    return Spline((float(origin[0]), float(origin[1])), spacing, (int(spans[0]), int(spans[1])))


def _functions(t: Array) -> tuple[Array, Array]:
    """The functions that count on a span and their derivatives, (n, degree + 1) each, at t = 0..1 within it."""
    powers = np.vander(t, _DEGREE + 1)
    slopes = powers[:, 1:] * np.arange(_DEGREE, 0, -1)
    return powers @ _PIECES, slopes @ _PIECES[:-1]
