"""Joint covariance of adjusted poses, as the adjustment left it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.frames import Array
from georef_gis.project.columns_file import read_columns, write_columns

_KIND = "joint covariance"


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


def load_pose_covariance(path: Path) -> PoseCovariance | None:
    """Joint covariance kept in `adjustment/covariance.npz`; None where there is none.

    Raises
    ------
    InputError
        If the file is cut off or none of ours.
    """
    if not path.exists():
        return None
    read = read_columns(path, _KIND)
    ids = tuple(str(name) for name in read["photo_ids"])
    n, full = 6 * len(ids), read["covariance"]
    matrix = full[:n, :n].copy()
    if int(read["with_level"]):
        # all heights rise with the level that control gave
        up = np.zeros(n)
        up[2::6] = 1.0
        cross = np.outer(full[:n, -1], up)
        matrix += cross + cross.T + full[-1, -1] * np.outer(up, up)
    return PoseCovariance(photo_ids=ids, matrix=matrix)
