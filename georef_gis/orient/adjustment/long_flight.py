"""The joint prior of a long flight: each pose given the few before it, so that it is a band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError
from georef_gis.frames import Array
from georef_gis.orient.adjustment.flight_model import FLOOR, FlightModel

# poses before one that tell all that earlier ones know of it
MEMORY = 12


class LongFlightModel(FlightModel):
    """Like `FlightModel`, with an information matrix that is a band in time.

    Notes
    -----
    Vecchia (1988), "Estimation and model identification for continuous spatial processes": the
    density as a product of densities given the nearest predecessors. Exact for a Markov chain
    shorter than the memory; with slow and white errors the rest fades by a third per photo.
    """

    order: NDArray[np.intp]
    band: Array

    def adopt(self, known: FlightModel) -> None:
        """Take what an earlier model of the same flight found."""
        if not isinstance(known, LongFlightModel):
            raise ValueError("a long flight learns from a long flight")
        self.extra, self.band, self.order = known.extra, known.band, known.order

    def renew(self) -> None:
        """Make the information anew after `extra` changed."""
        prior = self.prior
        if prior.joint is None or prior.times is None:
            raise ValueError(f"flight {prior.id}: has no joint covariance by parts")
        order = np.argsort(prior.times, kind="stable")
        n = len(order)
        # block (k, o) lies in row k and column k - o of the flight in order of time
        band = np.zeros((n, MEMORY + 1, 6, 6))
        for k in range(n):
            first = max(0, k - MEMORY)
            here = order[first : k + 1]
            own = np.tile(FLOOR**2, len(here)) + self.extra[here].ravel()
            covariance = prior.joint(here) + np.diag(own)
            W, weight = _given_the_others(covariance, prior.id)
            share = (W.T @ weight @ W).reshape(len(here), 6, len(here), 6)
            for a in range(len(here)):
                band[first + a, : a + 1] += share[a].transpose(1, 0, 2)[a::-1]
        self.order = order
        self.band = band

    def times(self, x: Array) -> Array:
        """Information of the poses times columns; (n, 6, k) -> (n, 6, k)."""
        inside = x[self.order]
        n = len(inside)
        out = np.einsum("nij,njk->nik", self.band[:, 0], inside)
        for o in range(1, min(MEMORY, n - 1) + 1):
            part = self.band[o:, o]
            out[o:] += np.einsum("nij,njk->nik", part, inside[:-o])
            out[:-o] += np.einsum("nji,njk->nik", part, inside[o:])
        back: Array = np.empty_like(out)
        back[self.order] = out
        return back

    def own_blocks(self) -> Array:
        """Information of each pose when all others are known; (n, 6, 6)."""
        out = np.empty((len(self.order), 6, 6))
        out[self.order] = self.band[:, 0]
        return out

    def blocks(self, A: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """A^T information A as lower blocks in time: photos of row and column, (m, 6, 6)."""
        rows, columns, data = [], [], []
        n = len(self.order)
        for o in range(min(MEMORY, n - 1) + 1):
            row, column = self.order[o:], self.order[: n - o]
            part = np.einsum("aji,ajk,akl->ail", A[row], self.band[o:, o], A[column])
            rows.append(row)
            columns.append(column)
            data.append(part)
        photos = self.prior.photos
        at, across = photos[np.concatenate(rows)], photos[np.concatenate(columns)]
        return at, across, np.concatenate(data)


def _given_the_others(covariance: Array, name: str) -> tuple[Array, Array]:
    """What the last pose's error is beyond what the others foretell: its rows and information."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    unit = covariance * scale[:, None] * scale
    past, now = unit[:-6, :-6], unit[-6:, :-6]
    try:
        B = np.linalg.solve(past, now.T).T if len(past) else np.zeros((6, 0))
        weight = np.linalg.inv(unit[-6:, -6:] - B @ now.T)
    except np.linalg.LinAlgError as error:
        raise AdjustmentError(
            f"flight {name}: the covariance of its poses is not positive definite"
        ) from error
    W = np.hstack([-B, np.eye(6)]) * scale
    return W, (weight + weight.T) / 2.0
