"""Covariance of an adjustment taken apart by what went into it.

The adjusted unknowns are linear in the observations: x = C A^T W l with C = (A^T W A)^-1. Noise
of one group of observations, of covariance S, so gives K S K^T with K = C A^T W of that group,
and the contributions of all groups add to C exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.measure.budget.parts import by_blocks
from georef_gis.model.photo_stack import Ints

# What is left when all that was known before is taken off.
MATCHING = "matching"
# unknowns beyond which single precision must do: some 64 MB a source
_MOST_DOUBLE = 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """What was known of the unknowns before, as observations with noise by source.

    Parameters
    ----------
    gain : shape (m, N)
        W A C of the group: the transpose of K.
    by_source
        Source -> covariance (m, m) of the noise; together the inverse of W.
    """

    gain: Array
    by_source: Mapping[str, Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockSplit:
    """Joint covariance of an adjustment by source, for the unknowns of a scene.

    Parameters
    ----------
    by_source
        Source -> (N, N) of the adjustment's unknowns; heights of poses hold the level.
    rows : shape (U,)
        Row of each unknown of the scene (`JointErrors`) in them, -1 where it was not adjusted.
    """

    by_source: Mapping[str, Array]
    rows: Ints

    def parts(self, columns: Ints) -> dict[str, Array]:
        """Source -> joint covariance of some of the scene's unknowns, zero where not adjusted."""
        at = self.rows[columns]
        known = np.outer(at >= 0, at >= 0)
        return {s: np.where(known, m[np.ix_(at, at)], 0.0) for s, m in self.by_source.items()}


def split(
    covariance: Array, known: Iterable[Known], *, n_photos: int, with_level: bool
) -> dict[str, Array]:
    """Covariance of an adjustment (N, N) by source: what was known before, and the matches.

    Parameters
    ----------
    n_photos
        Whose poses are the first unknowns.
    with_level
        Whether all heights rise with the last unknown.
    """
    lifted = np.zeros(len(covariance))
    if with_level:
        lifted[2 : 6 * n_photos : 6] = 1.0
    single = len(covariance) > _MOST_DOUBLE
    parts: dict[str, Array] = {}
    for group in known:
        K = group.gain.T + np.outer(lifted, group.gain[:, -1])
        for source, noise in group.by_source.items():
            one = K @ noise @ K.T
            parts[source] = parts.get(source, 0.0) + one.astype(np.float32 if single else float)
    cross = np.outer(lifted, covariance[-1])
    total = covariance + cross + cross.T + np.outer(lifted, lifted) * covariance[-1, -1]
    rest = total - np.asarray(sum(parts.values()))
    return {**parts, MATCHING: (rest + rest.T) / 2}


def known_directly(
    covariance: Array, rows: NDArray[np.intp], prior: Array, sources: Sequence[str]
) -> Known:
    """Group of unknowns that were known themselves, with a prior covariance (r, r).

    Parameters
    ----------
    covariance : shape (N, N)
        Of all unknowns.
    rows : shape (r,)
    sources
        Of each of them.
    """
    scale = 1.0 / np.sqrt(np.diag(prior))
    weight = np.linalg.inv(prior * np.outer(scale, scale)) * np.outer(scale, scale)
    return Known(gain=weight @ covariance[rows], by_source=by_blocks(prior, sources))


def position_and_angles(joint: Array, *, datum_share: float = 0.0) -> dict[str, Array]:
    """Joint covariance of pose errors, (6 n, 6 n), by receiver, datum, angles and coupling.

    Parameters
    ----------
    datum_share
        Of the variance of east and north, what an unstated datum has.
    """
    axis = np.tile(np.arange(6), len(joint) // 6)
    level, place, angle = axis < 2, axis < 3, axis >= 3
    out = {
        "gnss": joint * np.outer(place, place),
        "attitude": joint * np.outer(angle, angle),
        "coupling": joint * (np.outer(place, angle) | np.outer(angle, place)),
    }
    if datum_share > 0.0:
        out["datum"] = datum_share * joint * np.outer(level, level)
        out["gnss"] = out["gnss"] - out["datum"]
    return {source: part for source, part in out.items() if np.any(part)}
