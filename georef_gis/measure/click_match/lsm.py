"""Least squares matching of a template in a photo: affine place and light, with its covariance.

Gruen, Adaptive least squares correlation, S. Afr. J. Photogramm. 14 (1985); Foerstner and Wrobel,
Photogrammetric Computer Vision (2016), 13.2. Residuals of real photos hang together from pixel to
pixel, so the covariance is that of the normal equations under their measured autocorrelation: as
if each pixel were independent, it would be 2 to 3 times too small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from georef_gis.frames import Array
from georef_gis.measure.click_match.patch import (
    SOFT,
    Shades,
    Template,
    blurred,
    footprint_blur,
)

_STEPS = 25
# px; one sigma of the middle of a patch, which must show what the whole does
_INNER = 3.0
_INNER_STEPS = 3
# px; width of the seam between two halves of a patch
_SOFT_SIDE = 1.0
# px; the iteration stops here
_SETTLED = 0.002
# px of the template; the place is not sought farther from where the search found it
_FARTHEST = 3.0
# px; over which residuals of neighbouring pixels hang together
_LAGS = 3
# px; what no residual shows: the pixels' own shape, and how they are interpolated
_FLOOR = 0.03
# px of the template; blurs of template and photo, of which the pair that fits best is taken
_BLURS = ((0.0, 0.0), (0.6, 0.0), (1.0, 0.0), (1.5, 0.0), (0.0, 0.6), (0.0, 1.0), (0.0, 1.5))
# px, half the base over which the slope of the photo's shades is taken
_BASE = 0.25


@dataclass(frozen=True, slots=True)
class Strain:
    """Parts of a patch that ask for different places.

    How far apart, px, its chi^2 (2 dof), and its one sigma along the worst direction, px.
    """

    away: float
    chi2: float
    sigma: float

    @classmethod
    def of(cls, move: Array, covariance: Array) -> Strain:
        """Of a move, (2,) px; none where it is not known."""
        if not np.all(np.isfinite(covariance)):
            return cls(0.0, 0.0, math.inf)
        chi2 = float(move @ np.linalg.pinv(covariance) @ move)
        sigma = math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
        return cls(float(np.linalg.norm(move)), chi2, sigma)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refined:
    """A match.

    Parameters
    ----------
    uv : shape (2,), px
        Pixel that shows what the click shows.
    affine : shape (2, 2)
        Of pixels of the template to those of the photo.
    covariance : shape (2, 2), px^2
    quality
        Correlation of the two patches, -1 to 1.
    inner, apart
        What the middle of the patch asks for against all of it, and one half against the other.
    """

    uv: Array
    affine: Array
    covariance: Array
    quality: float
    inner: Strain
    apart: Strain


def refine(
    template: Template, shades: Shades, uv: Array, affine: Array, *, sigma_affine: float
) -> Refined | None:
    """Match to a fraction of a pixel; None where there is none near.

    First with both photos blurred, then as sharp as the less sharp of the two.

    Parameters
    ----------
    uv : shape (2,), px
        Where the search found it, in the photo.
    affine : shape (2, 2)
        As the geometry predicts it.
    sigma_affine
        One sigma of each of its elements: by the slope of what was clicked.
    """
    scale = math.sqrt(abs(float(np.linalg.det(affine))))
    own, other = footprint_blur(1.0 / max(scale, 1e-3)), footprint_blur(scale)
    x = np.concatenate([shades.at(uv), affine.ravel()])
    first = _Work(template, shades, math.hypot(own, SOFT), math.hypot(other, SOFT * scale))
    solved = _solved(first, x, affine, sigma_affine)
    if solved is None:
        return None
    works = [
        _Work(template, shades, math.hypot(own, a), math.hypot(other, b * scale)) for a, b in _BLURS
    ]
    x = solved[0]
    sharpest = max(works, key=lambda work: work.quality(x))
    x, normal = _solved(sharpest, x, affine, sigma_affine) or solved
    return sharpest.result(x, normal, np.array([shades.u, shades.v], dtype=np.float64))


def _solved(
    work: _Work, x: Array, affine: Array, sigma_affine: float
) -> tuple[Array, Array] | None:
    """Unknowns (6,) and the normal matrix (8, 8); None where the iteration goes astray."""
    prior = np.r_[0.0, 0.0, np.full(4, sigma_affine**-2), 0.0, 0.0]
    start, reach = x[:2].copy(), _FARTHEST * max(math.sqrt(abs(np.linalg.det(affine))), 0.5)
    for _ in range(_STEPS):
        looked = work.look(x)
        if looked is None:
            return None
        residual, J, variance = looked
        normal = np.einsum("ni,n,nj->ij", J, work.weight, J) / variance + np.diag(prior)
        pull = J.T @ (work.weight * residual) / variance
        pull[2:6] += prior[2:6] * (affine.ravel() - x[2:6])
        try:
            step = np.linalg.solve(normal, pull)
        except np.linalg.LinAlgError:
            return None
        x = x + step[:6]
        if not np.linalg.norm(x[:2] - start) < reach:
            return None
        if np.linalg.norm(step[:2]) < _SETTLED:
            return x, normal
    return None


class _Work:
    """Template and photo under blurs, px of each, that make them equally sharp."""

    def __init__(self, template: Template, shades: Shades, own: float, other: float) -> None:
        self.size = template.size
        self.values = template.blurred(own).ravel()
        self.weight = template.weight.ravel() / float(template.weight.mean())
        self.offsets = template.offsets.reshape(-1, 2)
        photo = blurred(shades.values, other).astype(np.float64)
        self.spline = spline_filter(photo, order=3, mode="mirror")
        self.least = template.noise**2

    def look(self, x: Array) -> tuple[Array, Array, float] | None:
        """Residuals (n,), their derivatives (n, 8) and variance, the light being fitted first."""
        at = x[:2] + self.offsets @ x[2:6].reshape(2, 2).T
        rows, cols = self.spline.shape
        if not (np.all(at >= 2.0) and np.all(at <= np.array([cols - 3.0, rows - 3.0]))):
            return None
        seen, by_u, by_v = self._sampled(at)
        gain, level = self._light(seen)
        residual = self.values - gain * seen - level
        dx, dy = self.offsets.T
        u, v = gain * by_u, gain * by_v
        J = np.stack([u, v, u * dx, u * dy, v * dx, v * dy, seen, np.ones_like(seen)], axis=1)
        free = max(len(residual) - 8, 1)
        variance = float(self.weight @ residual**2) / free
        return residual, J, max(variance, self.least)

    def _sampled(self, at: Array) -> tuple[Array, Array, Array]:
        """Shades at pixels (n, 2) and their slopes along u and v."""
        moves = np.array([[0, 0], [_BASE, 0], [-_BASE, 0], [0, _BASE], [0, -_BASE]])
        places = (at[None] + moves[:, None])[..., ::-1].reshape(-1, 2).T
        found = map_coordinates(self.spline, places, order=3, prefilter=False, mode="mirror")
        here, right, left, down, up = found.reshape(5, -1)
        return here, (right - left) / (2 * _BASE), (down - up) / (2 * _BASE)

    def _light(self, seen: Array) -> tuple[float, float]:
        """Gain and level that make the photo's shades those of the template."""
        w = self.weight / self.weight.sum()
        a, b = float(w @ seen), float(w @ self.values)
        spread = float(w @ (seen - a) ** 2)
        gain = float(w @ ((seen - a) * (self.values - b))) / max(spread, 1e-9)
        return gain, b - gain * a

    def quality(self, x: Array) -> float:
        """Correlation of the two patches; -1 where the photo ends."""
        looked = self.look(x)
        if looked is None:
            return -1.0
        residual, J, _ = looked
        w = self.weight / self.weight.sum()
        spread = float(w @ (self.values - w @ self.values) ** 2)
        # the gain is that of the regression, so this is the correlation's square
        explained = max(1.0 - float(w @ residual**2) / max(spread, 1e-12), 0.0)
        return math.copysign(math.sqrt(explained), self._light(J[:, 6])[0])

    def result(self, x: Array, normal: Array, corner: Array) -> Refined | None:
        """Match by its unknowns, with its covariance."""
        looked = self.look(x)
        if looked is None:
            return None
        residual, J, variance = looked
        return Refined(
            uv=x[:2] + corner,
            affine=x[2:6].reshape(2, 2),
            covariance=self._covariance(residual, J, normal, variance),
            quality=self.quality(x),
            inner=self._inner(x),
            apart=self._apart(x),
        )

    def _inner(self, x: Array) -> Strain:
        """What the middle of the patch asks for."""
        far = np.sum(self.offsets**2, axis=1)
        return Strain.of(*self._move(x, np.exp(-0.5 * far / _INNER**2)))

    def _apart(self, x: Array) -> Strain:
        """What opposite halves ask for; the worse of both pairs."""
        found = []
        for axis in (0, 1):
            side = self.offsets[:, axis] / _SOFT_SIDE
            (one, C), (other, D) = (
                self._move(x, self.weight / (1.0 + np.exp(-sign * side))) for sign in (1, -1)
            )
            found.append(Strain.of(one - other, C + D))
        return max(found, key=lambda strain: strain.chi2)

    def _move(self, x: Array, weight: Array) -> tuple[Array, Array]:
        """Move, px, that a part of the patch asks for, its shape kept, and its covariance."""
        moved, out = x.copy(), np.full((2, 2), np.inf)
        for _ in range(_INNER_STEPS):
            looked = self.look(moved)
            if looked is None:
                break
            J = looked[1][:, [0, 1, 6, 7]]
            residual = looked[0]
            normal = np.einsum("ni,n,nj->ij", J, weight, J)
            pull = J.T @ (weight * residual)
            try:
                step = np.linalg.solve(normal, pull)
                inverse = np.linalg.inv(normal)
            except np.linalg.LinAlgError:
                break
            free = max(float(weight.sum()) - 4.0, 1.0)
            variance = max(float(weight @ (residual - J @ step) ** 2) / free, self.least)
            out = variance * inverse[:2, :2]
            moved[:2] += step[:2]
        return moved[:2] - x[:2], out

    def _covariance(self, residual: Array, J: Array, normal: Array, variance: float) -> Array:
        """Of the place, (2, 2) px^2, under the residuals' own autocorrelation."""
        n = self.size
        noise = residual.reshape(n, n)
        pulls = (J * self.weight[:, None]).reshape(n, n, 8) / variance
        total = np.zeros((8, 8))
        # each pair of neighbours once: the other half of the lags is the transpose
        lags = [(dv, du) for dv in range(_LAGS + 1) for du in range(-_LAGS, _LAGS + 1)]
        for dv, du in lags[_LAGS:]:
            one, other = _shifted(n, dv, du)
            fade = (1 - dv / (_LAGS + 1)) * (1 - abs(du) / (_LAGS + 1))
            alike = fade * float(np.mean(noise[one] * noise[other]))
            if dv == du == 0:
                alike = max(alike, variance) / 2
            pair = pulls[one].reshape(-1, 8).T @ pulls[other].reshape(-1, 8)
            total += alike * (pair + pair.T)
        inverse = np.linalg.inv(normal)
        # where residuals alternate, the sum may fall below that of independent ones
        out = np.asarray((inverse @ total @ inverse)[:2, :2])
        plain = inverse[:2, :2]
        values, vectors = np.linalg.eigh(out)
        least = np.einsum("ik,ij,jk->k", vectors, plain, vectors)
        out = (vectors * np.maximum(values, least)) @ vectors.T
        return np.asarray(out + _FLOOR**2 * np.eye(2))


def _shifted(n: int, dv: int, du: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Two parts of an (n, n) array that lie (dv, du) apart."""
    one = (slice(max(-dv, 0), n - max(dv, 0)), slice(max(-du, 0), n - max(du, 0)))
    other = (slice(max(dv, 0), n - max(-dv, 0)), slice(max(du, 0), n - max(-du, 0)))
    return one, other
