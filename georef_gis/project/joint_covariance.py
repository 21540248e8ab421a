"""Joint covariance of adjusted poses, cameras, mounts and clocks, as the adjustment left it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.pose_errors import DenseErrors, PoseErrors
from georef_gis.project.columns_file import columns_of, write_columns

_KIND = "joint covariance"
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseCovariance:
    """Covariance of all adjusted poses of a project, m and rad.

    `matrix` (6 n, 6 n) is that of `(dp_enu, dtheta_enu)` of each of `photo_ids`.
    """

    photo_ids: tuple[str, ...]
    matrix: Array

    def of(self, photo_ids: Sequence[str]) -> Array | None:
        """Joint covariance of some photos, (6 k, 6 k); None if one was not adjusted."""
        number = {key: i for i, key in enumerate(self.photo_ids)}
        if any(key not in number for key in photo_ids):
            return None
        rows = (6 * np.array([number[k] for k in photo_ids])[:, None] + np.arange(6)).ravel()
        return np.asarray(self.matrix[np.ix_(rows, rows)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KeptCovariance:
    """Covariance of all that was adjusted but the points.

    Parameters
    ----------
    photo_ids
        Of the n photos.
    shared_names
        Of the s unknowns that photos share, such as "rebel f", "flight boresight_x", "level": a
        camera or flight and the name of its unknown.
    matrix : shape (6 n + s, 6 n + s), m, rad, px and s
        Poses first, `(dp_enu, dtheta_enu)` each; where control gave the level, it is in their
        heights.
    """

    photo_ids: tuple[str, ...]
    shared_names: tuple[str, ...]
    matrix: Array

    @property
    def poses(self) -> PoseCovariance:
        """That of the poses alone."""
        n = 6 * len(self.photo_ids)
        return PoseCovariance(photo_ids=self.photo_ids, matrix=self.matrix[:n, :n])

    def pose_rows(self, photo_ids: Sequence[str]) -> Indices:
        """Rows of the poses of photos, all of them adjusted; shape (6 k,)."""
        number = {key: i for i, key in enumerate(self.photo_ids)}
        first = 6 * np.array([number[key] for key in photo_ids], dtype=np.int64)
        return np.asarray((first[:, None] + np.arange(6)).ravel())

    def shared_rows(self, owner: str, names: Sequence[str]) -> Indices | None:
        """Rows of the unknowns of a camera or a flight; None where it was not adjusted."""
        found = rows_called(self.shared_names, owner, names)
        return None if found is None else np.asarray(6 * len(self.photo_ids) + found)

    def pose_errors(self, photo_ids: Sequence[str]) -> PoseErrors:
        """Errors of photos, all of them adjusted, counted from 0 in this order."""
        rows = self.pose_rows(photo_ids)
        return DenseErrors(matrix=np.ascontiguousarray(self.matrix[np.ix_(rows, rows)]))

    def between(self, rows: Indices, others: Indices) -> Array:
        """Covariance of shared unknowns, by `shared_rows`; (r,) and (s,) -> (r, s)."""
        return np.asarray(self.matrix[np.ix_(rows, others)])

    def with_shared(self, photo_ids: Sequence[str], rows: Indices) -> Array:
        """Covariance of the poses of k photos with shared unknowns, (r,); (k, 6, r)."""
        block = self.matrix[np.ix_(self.pose_rows(photo_ids), rows)]
        return np.asarray(block.reshape(len(photo_ids), 6, len(rows)))


def rows_called(shared_names: Sequence[str], owner: str, names: Sequence[str]) -> Indices | None:
    """Numbers of the unknowns of a camera or a flight among all; None where it was not adjusted."""
    number = {name: i for i, name in enumerate(shared_names)}
    wanted = [f"{owner} {name}" for name in names]
    if any(name not in number for name in wanted):
        return None
    return np.array([number[name] for name in wanted], dtype=np.int64)


def save_joint_covariance(
    path: Path,
    *,
    photo_ids: Sequence[str],
    shared_names: Sequence[str],
    covariance: Array,
    with_level: bool,
) -> None:
    """Write the covariance of all poses and shared unknowns, whole or not at all.

    Parameters
    ----------
    covariance : shape (6 n + s, 6 n + s), m, rad and the units of the shared unknowns
        Of `(dp_enu, dtheta_enu)` of each of `photo_ids`, then of `shared_names`.
    with_level
        Whether the last unknown is the level that control gave, m, by which all heights rise.
    """
    columns = {
        "photo_ids": list(photo_ids),
        "shared_names": list(shared_names),
        "covariance": covariance,
        "with_level": int(with_level),
    }
    write_columns(path, _KIND, columns)


def load_joint_covariance(path: Path) -> KeptCovariance | None:
    """Covariance kept in `adjustment/covariance.npz`; None where there is none.

    Raises
    ------
    InputError
        If the file is cut off or none of ours.
    """
    if not path.exists():
        return None
    with columns_of(path, _KIND) as read:
        ids = tuple(str(name) for name in read["photo_ids"])
        full = np.array(read["covariance"])
        n = 6 * len(ids)
        if int(read["with_level"]):
            # all heights rise with the level that control gave
            full[2:n:6] += full[-1]
            full[:, 2:n:6] += full[:, -1:]
        names = tuple(str(name) for name in read["shared_names"])
        return KeptCovariance(photo_ids=ids, shared_names=names, matrix=full)


def load_pose_covariance(path: Path) -> PoseCovariance | None:
    """That of the poses alone, kept in `adjustment/covariance.npz`; None where there is none.

    Raises
    ------
    InputError
        If the file is cut off or none of ours.
    """
    kept = load_joint_covariance(path)
    return None if kept is None else kept.poses
