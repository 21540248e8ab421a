"""The search for the largest set of marks of control points that agree with each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.tie_points import Indices
from georef_gis.orient.control_model import Network

Flags = NDArray[np.bool_]

# chance that one good mark of a file is accused
_LEVEL = 0.01
# px, and multiples of a mark's own sigma: less is no blunder, whatever the statistics
_LEAST_PX, _LEAST_SIGMAS = 3.0, 6.0
# chi-square of two degrees of freedom: its median, and the 99 % that "fits" means
_MEDIAN, _FITS = 1.386, 9.21
# px^2; stands for a mark that is left out
_NO_WEIGHT = 1e12
# px; from here the robust search narrows down
_WIDEST = 300.0
# exchanges and wrong coordinates: how many may be found, and how many are tried for each
_MOST_HYPOTHESES, _MOST_TRIALS = 4, 8
# marks up to which pairs of them are looked at
_MOST_MARKS = 300
# m; a point whose coordinates are set free
_FREE = 300.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """A division of the marks into good and bad under a hypothesis, and its cost."""

    network: Network
    point: Indices
    good: Flags
    x: Array
    P: Array
    residual: Array
    covariance: Array
    chi2: Array
    noise: float
    cost: float
    # pairs of points whose marks were exchanged, and points whose coordinates were set free
    exchanged: tuple[tuple[int, int], ...] = ()
    free: tuple[int, ...] = ()


class Search:
    """Looks for the largest set of marks that agree."""

    def __init__(self, network: Network) -> None:
        self.network = network
        control = network.control
        self.limit = -2.0 * np.log(_LEVEL / max(len(control.photo_ids), 1))
        self.least = np.maximum(_LEAST_PX, _LEAST_SIGMAS * control.sigma_px)

    def best(self) -> State:
        """Division with points exchanged or coordinates set free where that clears many marks."""
        found = self.divide(self.network.control.point)
        for _ in range(_MOST_HYPOTHESES):
            others = [self._free(found, j) for j in self._wrong_points(found)]
            others += [self._exchange(found, *pair) for pair in self._pairs(found)]
            # One hypothesis must clear at least two marks.
            better = [o for o in others if o.cost < found.cost - 2.0 * self.limit]
            if not better:
                break
            found = min(better, key=lambda state: state.cost)
        return found

    def _wrong_points(self, state: State) -> list[int]:
        """Points with two bad marks or more in different photos, worst first."""
        photos = self.network.photo_of
        bad = {
            j: len(np.unique(photos[(state.point == j) & ~state.good]))
            for j in np.unique(state.point[~state.good]).tolist()
            if j not in state.free
        }
        some = [j for j, count in bad.items() if count >= 2]
        return sorted(some, key=lambda j: -bad[j])[:_MOST_TRIALS]

    def _pairs(self, state: State) -> list[tuple[int, int]]:
        """Points that bad marks of each other fit, most first; all where much is bad."""
        votes: dict[tuple[int, int], int] = {}
        for k, j in zip(*np.nonzero(table_of_fits(state)), strict=True):
            pair = tuple(sorted((int(state.point[k]), int(j))))
            votes[pair] = votes.get(pair, 0) + 1  # type: ignore[index, arg-type]
        if (~state.good).mean() > 0.25 and len(state.good) <= _MOST_MARKS:
            points = np.unique(state.point).tolist()
            bad = np.bincount(state.point[~state.good], minlength=max(points) + 1)
            for a, b in combinations(points, 2):
                if bad[a] + bad[b] > 1:
                    votes.setdefault((a, b), 0)
                    votes[a, b] += 1
        some = [pair for pair, count in votes.items() if count >= 2]
        return sorted(some, key=lambda pair: -votes[pair])[:_MOST_TRIALS]

    def _free(self, state: State, j: int) -> State:
        search = Search(state.network.freed(j, _FREE))
        search.limit = self.limit
        return replace(search.divide(state.point), exchanged=state.exchanged, free=(*state.free, j))

    def _exchange(self, state: State, a: int, b: int) -> State:
        point = state.point.copy()
        point[state.point == a], point[state.point == b] = b, a
        search = Search(state.network)
        return replace(search.divide(point), exchanged=(*state.exchanged, (a, b)), free=state.free)

    def divide(self, point: Indices) -> State:
        """Good and bad marks for given labels: a robust start, then tests in and out."""
        x, good = self._robust(point)
        state = self._test(point, good, x)
        for _ in range(2 * len(good) + 10):
            limit = self.limit * state.noise**2
            size = np.linalg.norm(state.residual, axis=1)
            beyond = (state.chi2 > limit) & (size > self.least)
            wrong = good & beyond
            right = ~good & ~beyond & np.isfinite(state.chi2)
            if wrong.any():
                good = good.copy()
                good[np.argmax(np.where(wrong, state.chi2, -1.0))] = False
            elif right.any():
                good = good.copy()
                good[np.argmin(np.where(right, state.chi2, np.inf))] = True
            else:
                break
            state = self._test(point, good, state.x)
        return state

    def _robust(self, point: Indices) -> tuple[Array, Flags]:
        """Unknowns by Geman-McClure weights whose width shrinks, and the marks that carry them."""
        network = self.network
        x = np.zeros(len(network.prior))
        variance = network.control.sigma_px**2
        weight = np.ones(len(point))
        _, J = network.look(x, network.photo_of, point)
        spread = np.einsum("kia,ab,kib->k", J, network.prior, J)
        # As wide as the poses are unsure: their errors must not look like blunders.
        width = max(_WIDEST, 2.0 * float(np.sqrt(np.nanmedian(spread))))
        while True:
            for _ in range(2):
                x, _ = _solve(network, point, variance / np.maximum(weight, 1e-9), x)
                uv, _ = network.look(x, network.photo_of, point)
                size = np.linalg.norm(network.control.uv - uv, axis=1)
                size = np.where(np.isfinite(size), size, np.inf)
                weight = 1.0 / (1.0 + (size / np.maximum(width, 3.0 * self.least)) ** 2) ** 2
            if width <= _LEAST_PX:
                return x, size <= 3.0 * self.least
            width /= 3.0

    def _test(self, point: Indices, good: Flags, x: Array) -> State:
        """Solution of the good marks, and every mark against the prediction of the others."""
        network = self.network
        variance = np.where(good, network.control.sigma_px**2, _NO_WEIGHT)
        for _ in range(3):
            x, P = _solve(network, point, variance, x)
        uv, J = network.look(x, network.photo_of, point)
        seen = np.all(np.isfinite(uv), axis=1) & np.all(np.isfinite(J), axis=(1, 2))
        r = np.where(seen[:, None], network.control.uv - uv, np.nan)
        J = np.where(seen[:, None, None], J, 0.0)
        own = np.eye(2) * network.control.sigma_px[:, None, None] ** 2
        spread = J @ P @ np.swapaxes(J, 1, 2)
        # Leaving a good mark out: e = (1 - H)^-1 r with H = J P J^T / sigma^2 (Belsley, Kuh and
        # Welsch, "Regression Diagnostics", 1980), covariance sigma^2 (1 - H)^-1.
        inverse = np.linalg.inv(own - np.where(good[:, None, None], spread, 0.0) + 1e-9 * own)
        C = np.where(good[:, None, None], own @ inverse @ own, own + spread)
        e = np.where(good[:, None], np.einsum("kij,kj->ki", own @ inverse, r), r)
        chi2 = np.einsum("ki,kij,kj->k", e, np.linalg.inv(C), e)
        chi2 = np.where(seen, chi2, np.nan)
        noise = _noise(chi2[good], r[good], J[good], network)
        bad = int((~good).sum())
        # The marks by what the solution leaves, its own departures from the poses, and the bad.
        left = float(np.sum((r[good] / network.control.sigma_px[good, None]) ** 2)) / noise**2
        cost = left + _departure(network.prior, x) + bad * self.limit
        return State(
            network=network, point=point, good=good, x=x, P=P, residual=e, covariance=C,
            chi2=chi2, noise=noise, cost=cost,
        )  # fmt: skip


def _noise(chi2: Array, r: Array, J: Array, network: Network) -> float:
    """Root of the factor by which marks scatter more than expected, at least 1; by the median."""
    free = 2 * len(chi2) - 6 * len(network.photos)
    if free < 6 or not np.any(np.isfinite(chi2)):
        return 1.0
    return float(np.sqrt(max(1.0, np.nanmedian(chi2) / _MEDIAN)))


def _departure(prior: Array, x: Array) -> float:
    """Chi-square of the unknowns against their covariance, those without sigma left out."""
    free = np.diag(prior) > 0
    return float(x[free] @ np.linalg.lstsq(prior[np.ix_(free, free)], x[free], rcond=1e-12)[0])


def _solve(network: Network, point: Indices, variance: Array, x: Array) -> tuple[Array, Array]:
    """One Gauss-Newton step to the most likely unknowns, and their covariance.

    Parameters
    ----------
    variance : shape (m,), px^2
        Of the marks.
    """
    uv, J = network.look(x, network.photo_of, point)
    J = J.reshape(2 * len(point), -1)
    r = (network.control.uv - uv).reshape(-1) + J @ x
    unseen = ~np.isfinite(r) | ~np.all(np.isfinite(J), axis=1)
    J, r = np.where(unseen[:, None], 0.0, J), np.where(unseen, 0.0, r)
    gain = network.prior @ J.T
    S = J @ gain + np.diag(np.repeat(variance, 2))
    K = np.linalg.solve(S, gain.T).T
    P = network.prior - K @ gain.T
    return K @ r, (P + P.T) / 2


def table_of_fits(state: State) -> Flags:
    """Which other points each bad mark fits; shape (m, n)."""
    network, control = state.network, state.network.control
    out = np.zeros((len(state.point), len(control.names)), dtype=bool)
    bad = np.flatnonzero(~state.good)
    others = np.arange(len(control.names))
    for k in bad.tolist():
        photo = np.full(len(others), network.photo_of[k])
        uv, J = network.look(state.x, photo, others)
        e = control.uv[k] - uv
        ok = np.all(np.isfinite(e), axis=1) & np.all(np.isfinite(J), axis=(1, 2))
        ok &= others != state.point[k]
        C = J[ok] @ state.P @ np.swapaxes(J[ok], 1, 2) + np.eye(2) * control.sigma_px[k] ** 2
        chi2 = np.einsum("ki,kij,kj->k", e[ok], np.linalg.inv(C), e[ok])
        # A prediction as wide as the image fits everything and tells nothing.
        sharp = np.linalg.eigvalsh(C)[:, -1] < (0.05 * network.photos[photo[0]].camera.width) ** 2
        out[k, np.flatnonzero(ok)] = (chi2 < _FITS * state.noise**2) & sharp
    return out
