"""Places of stored assets with their joint covariance, for lengths between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.measure.ellipses import grid_axes
from processing_algorithms.assets.asset_clicks import is_clicked, remeasured_points
from processing_algorithms.assets.asset_photos import lost_photos

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.measure.assets.asset import Asset
    from georef_gis.project import Project

# m; a stored place and the one measured now differ by rounding only, unless the poses changed
_SAME = 0.005
JOINT = "joint, from the clicks"
APART = (
    "without what they share for {n} of {all} assets that have no clicks in photos of the project: "
    "their distances come out less sure than they are"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPlaces:
    """Vertices of assets and their joint covariance.

    Parameters
    ----------
    names
        Of the n vertices, for people.
    p_enu : shape (n, 3), m
    covariance : shape (3 n, 3 n), m^2 in enu
    indices
        Of the vertices of each asset, by its id.
    basis
        What the covariance rests on, for people.
    doubts
        One line each.
    """

    names: tuple[str, ...]
    p_enu: Array
    covariance: Array
    indices: dict[str, tuple[int, ...]]
    basis: str
    doubts: tuple[str, ...] = ()


def joint_places(
    project: Project, frame: MapFrame, assets: Sequence[Asset], *, sigma_px: float
) -> JointPlaces:
    """Places of assets: those with clicks measured again, which tells what they share in error.

    Parameters
    ----------
    sigma_px
        One sigma of a click that states none, px.

    Raises
    ------
    InputError
        If an asset has neither clicks nor an accuracy.
    """
    _check(assets, str(project.folder))
    known = {str(row["photo_id"]) for row in project.database.rows("photo")}
    clicked = [a for a in assets if is_clicked(a) and not lost_photos(a, known)]
    joint_ids = {a.id for a in clicked}
    apart = [a for a in assets if a.id not in joint_ids]
    p_stored = {asset.id: _stored(frame, asset) for asset in assets}
    names, indices, count = [], {}, 0
    for asset in (*clicked, *apart):
        n = len(asset.vertices)
        label = asset.name or asset.id[:8]
        names += [label if n == 1 else f"{label}/{k + 1}" for k in range(n)]
        indices[asset.id] = tuple(range(count, count + n))
        count += n
    p_enu = np.vstack([p_stored[asset.id] for asset in (*clicked, *apart)])
    covariance = np.zeros((3 * count, 3 * count))
    doubts: list[str] = []
    if clicked:
        p_now, joint = remeasured_points(project, clicked, sigma_px=sigma_px)
        m = len(p_now)
        doubts += _moved(p_enu[:m], p_now)
        p_enu[:m] = p_now
        covariance[: 3 * m, : 3 * m] = joint
    for asset in apart:
        for i in indices[asset.id]:
            covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = _own(frame, asset, p_enu[i])
    told = APART.format(n=len(apart), all=len(assets)) if apart else JOINT
    return JointPlaces(
        names=tuple(names),
        p_enu=p_enu,
        covariance=covariance,
        indices=indices,
        basis=told,
        doubts=(*doubts, *([f"covariance {told}"] if apart else [])),
    )


def _check(assets: Sequence[Asset], source: str) -> None:
    unsure = []
    for asset in assets:
        q = asset.quality
        has_sigmas = q is not None and q.sigma_e is not None and q.sigma_n is not None
        if not asset.vertices or not (is_clicked(asset) or has_sigmas):
            unsure.append(f"{asset.kind} {asset.name or asset.id[:8]}")
    if unsure:
        few = ", ".join(unsure[:5]) + (" ..." if len(unsure) > 5 else "")
        raise InputError(
            f"{len(unsure)} assets have no accuracy ({few}): they were drawn or moved by hand; "
            "measure them in photos",
            source=source,
        )


def _stored(frame: MapFrame, asset: Asset) -> Array:
    """Vertices in enu; a height that is not known is taken as that of the origin."""
    p_map = np.array(asset.vertices, dtype=np.float64)
    h = p_map[:, 2]
    p_map[:, 2] = np.where(np.isfinite(h), h, frame.origin.height_ellipsoidal)
    return frame.enu_from_map(p_map)


def _own(frame: MapFrame, asset: Asset, p_enu: Array) -> Array:
    """Covariance in enu that the columns of an asset tell."""
    q = asset.quality
    assert q is not None
    e, n, u = q.sigma_e or 0.0, q.sigma_n or 0.0, q.sigma_u or 0.0
    off = (q.corr_en or 0.0) * e * n
    C = np.array([[e * e, off, 0.0], [off, n * n, 0.0], [0.0, 0.0, u * u]])
    R = grid_axes(frame, p_enu[None])[0]
    out: Array = R.T @ C @ R
    return out


def _moved(stored: Array, now: Array) -> list[str]:
    shift = np.linalg.norm((stored - now)[:, :2], axis=1)
    moved = shift > _SAME
    if not np.any(moved):
        return []
    return [
        f"{int(moved.sum())} places lie up to {float(shift.max()):.3f} m from where they were "
        "stored, as the poses changed since: `georef assets --remeasure` stores them anew"
    ]
