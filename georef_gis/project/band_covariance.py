"""Joint covariance of a large block as the adjustment left it: the band of its normal matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.band_errors import BandErrors
from georef_gis.model.pose_errors import PoseErrors
from georef_gis.project.columns_file import columns_of, write_columns
from georef_gis.project.joint_covariance import Indices, rows_called

_KIND = "band of a joint covariance"
_ARRAYS = ("factor", "inverse", "position", "scale", "to_shared", "shared")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandCovariance:
    """What `KeptCovariance` is of smaller blocks.

    Parameters
    ----------
    photo_ids
        Of the n photos.
    shared_names
        As in `KeptCovariance`.
    errors
        Of all poses; where control gave the level, it is in their heights.
    """

    photo_ids: tuple[str, ...]
    shared_names: tuple[str, ...]
    errors: BandErrors

    def shared_rows(self, owner: str, names: Sequence[str]) -> Indices | None:
        """Numbers of the unknowns of a camera or a flight; None where it was not adjusted."""
        return rows_called(self.shared_names, owner, names)

    def pose_errors(self, photo_ids: Sequence[str]) -> PoseErrors:
        """Errors of photos, all of them adjusted, counted from 0 in this order."""
        return SomeErrors(errors=self.errors, places=self._places(photo_ids))

    def between(self, rows: Indices, others: Indices) -> Array:
        """Covariance of shared unknowns, by `shared_rows`; (r,) and (s,) -> (r, s)."""
        return np.asarray(self.errors.shared[np.ix_(rows, others)])

    def with_shared(self, photo_ids: Sequence[str], rows: Indices) -> Array:
        """Covariance of the poses of k photos with shared unknowns, (r,); (k, 6, r)."""
        return self.errors.with_shared(self._places(photo_ids), rows)

    def _places(self, photo_ids: Sequence[str]) -> Indices:
        number = {key: i for i, key in enumerate(self.photo_ids)}
        return np.array([number[key] for key in photo_ids], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SomeErrors:
    """Errors of some of the photos that others speak of: those at `places` (k,)."""

    errors: PoseErrors
    places: Indices

    def pairs(self, a: Indices, b: Indices) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        return self.errors.pairs(self.places[a], self.places[b])


def save_band_covariance(
    path: Path, *, photo_ids: Sequence[str], shared_names: Sequence[str], errors: BandErrors
) -> None:
    """Write the covariance of a large block, whole or not at all; see `BandCovariance`."""
    columns = {name: getattr(errors, name) for name in _ARRAYS}
    names = {"photo_ids": list(photo_ids), "shared_names": list(shared_names)}
    write_columns(path, _KIND, names | columns)


def load_band_covariance(path: Path) -> BandCovariance | None:
    """Covariance kept in `adjustment/covariance_band.npz`; None where there is none.

    Raises
    ------
    InputError
        If the file is cut off or none of ours.
    """
    if not path.exists():
        return None
    with columns_of(path, _KIND) as read:
        return BandCovariance(
            photo_ids=tuple(str(name) for name in read["photo_ids"]),
            shared_names=tuple(str(name) for name in read["shared_names"]),
            errors=BandErrors(**{name: read[name] for name in _ARRAYS}),
        )
