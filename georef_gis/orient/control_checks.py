"""Blunders among the marks of control points: mislabelled, misplaced, exchanged, resized.

Each mark is tested against what the poses and all other good marks predict for it, with the
covariance of that prediction, so that poses which are metres off accuse nobody: their error is
shared by all marks of a photo, and only what differs from mark to mark counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.control import ControlObservations
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain
from georef_gis.model.tie_points import Indices
from georef_gis.orient.control_model import JointCovariance, Network
from georef_gis.orient.control_search import Flags, Search, State, table_of_fits

# marks up to which pairs of them are looked at
_MOST_MARKS = 300
# Marks measured in resized photos: less of a change of scale is that of the flying height
_RESIZED = 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlCheck:
    """What was found out about the m marks.

    Parameters
    ----------
    residual, covariance : shapes (m, 2) px, (m, 2, 2) px^2
        Mark minus the prediction of the poses and all other good marks, and its covariance, the
        click's own error included. NaN where the point cannot show in the photo.
    chi2 : shape (m,)
        Of two degrees of freedom, over the noise that the good marks show.
    suspect : shape (m,)
    keep : shape (m,)
        Marks to use. A suspect mark of a check point stays unless it was proven to be another's
        or stands beside a fitting one: leaving out what disagrees would flatter the statement.
    fits : shape (m,)
        Index of another point that a suspect mark fits, -1 for none.
    noise : float
        Root of the factor by which the good marks scatter more than they should, at least 1.
    doubts
        One line each.
    """

    residual: Array
    covariance: Array
    chi2: Array
    suspect: Flags
    keep: Flags
    fits: Indices
    noise: float
    doubts: tuple[str, ...]


def check_control(
    photos: Mapping[str, OrientedPhoto],
    control: ControlObservations,
    terrain: Terrain,
    *,
    joint: JointCovariance | None = None,
) -> ControlCheck:
    """Test every mark of points that are not off.

    Parameters
    ----------
    photos
        Oriented photos by id; they must hold those of the marks.
    control
        Marks, also several of one point in one photo: at most one of them is kept.
    joint
        Ids and joint covariance (6 n, 6 n) of poses; else the poses' errors count as independent,
        which accuses less.
    """
    m = len(control.photo_ids)
    asked = np.array([control.role[j] != "off" for j in control.point], dtype=bool)
    if not asked.any():
        return _nothing(m)
    part = control.with_marks(asked)
    network = Network.of(photos, part, terrain, joint)
    resized = _resized(network)
    if resized is not None:
        blank = _nothing(m)
        return replace(
            blank, suspect=asked, keep=np.zeros(m, bool), doubts=(_resized_line(part, resized),)
        )
    return _spread(_judge(Search(network).best()), asked)


def _nothing(m: int) -> ControlCheck:
    return ControlCheck(
        residual=np.full((m, 2), np.nan), covariance=np.full((m, 2, 2), np.nan),
        chi2=np.full(m, np.nan), suspect=np.zeros(m, bool), keep=np.ones(m, bool),
        fits=np.full(m, -1, dtype=np.int32), noise=1.0, doubts=(),
    )  # fmt: skip


def _spread(check: ControlCheck, asked: Flags) -> ControlCheck:
    """Results of some marks among those of all."""
    whole = _nothing(len(asked))
    for name in ("residual", "covariance", "chi2", "suspect", "keep", "fits"):
        getattr(whole, name)[asked] = getattr(check, name)
    return replace(whole, noise=check.noise, doubts=check.doubts)


# -- what it means -----------------------------------------------------------------------------


def _judge(state: State) -> ControlCheck:
    """Suspects, what they fit, and lines about them."""
    control = state.network.control
    labelled = control.point
    swapped = state.point != labelled
    table = table_of_fits(state)
    fits = np.where(table.sum(axis=1) == 1, np.argmax(table, axis=1), -1)
    fits = np.where(swapped & state.good, state.point, fits).astype(np.int32)
    bad = ~state.good
    suspect = bad | swapped | np.isin(labelled, state.free)
    proven = (fits >= 0) | (_twice(control) & suspect)
    is_check = np.array([control.role[j] == "check" for j in labelled], dtype=bool)
    keep = ~suspect | (is_check & ~proven)
    keep &= ~_second(control, keep)
    lines = [_exchanged_line(control, pair) for pair in state.exchanged]
    lines += [_moved_line(state, j) for j in state.free]
    lines += _lines(state, bad, fits)
    return ControlCheck(
        residual=state.residual, covariance=state.covariance, chi2=state.chi2, suspect=suspect,
        keep=keep, fits=fits, noise=state.noise, doubts=tuple(lines),
    )  # fmt: skip


def _twice(control: ControlObservations) -> Flags:
    """Whether a point is marked in the same photo more than once; shape (m,)."""
    pairs = list(zip(control.photo_ids, control.point.tolist(), strict=True))
    return np.array([pairs.count(pair) > 1 for pair in pairs], dtype=bool)


def _second(control: ControlObservations, keep: Flags) -> Flags:
    """Marks of a point in a photo that has several kept: none of them can be told right."""
    pairs = list(zip(control.photo_ids, control.point.tolist(), strict=True))
    kept = [pair for pair, k in zip(pairs, keep, strict=True) if k]
    return np.array([kept.count(pair) > 1 for pair in pairs], dtype=bool)


def _lines(state: State, suspect: Flags, fits: Indices) -> list[str]:
    control = state.network.control
    lines = []
    told = np.zeros(len(suspect), bool)
    for a, b in combinations(np.flatnonzero(suspect & ~told).tolist(), 2):
        same = control.photo_ids[a] == control.photo_ids[b]
        if same and fits[a] == control.point[b] and fits[b] == control.point[a]:
            lines.append(
                f"{control.source[a]}: the marks of {_name(control, a)} and {_name(control, b)} in "
                f"{control.photo_ids[a]} are exchanged: each fits the other; not used: exchange "
                "the names"
            )
            told[[a, b]] = True
    lines += [
        _mark_line(control, state, int(k), int(fits[k])) for k in np.flatnonzero(suspect & ~told)
    ]
    return lines


def _mark_line(control: ControlObservations, state: State, k: int, other: int) -> str:
    name, photo = _name(control, k), control.photo_ids[k]
    head = f"{control.source[k]}: mark of {name} in {photo} at " \
           f"{control.uv[k, 0]:.1f}, {control.uv[k, 1]:.1f} px"  # fmt: skip
    e = state.residual[k]
    if not np.all(np.isfinite(e)):
        return f"{head}: the point cannot show there; not used: correct the photo or the name"
    predicted = control.uv[k] - e
    sigma = float(np.sqrt(np.linalg.eigvalsh(state.covariance[k])[-1])) * state.noise
    words = (
        f"lies {np.linalg.norm(e):.0f} px from where the other marks put it "
        f"({predicted[0]:.0f}, {predicted[1]:.0f} px, sigma {sigma:.1f} px)"
    )
    if other >= 0:
        return f"{head} {words}, but fits {control.names[other]}; not used: correct the name"
    if control.role[control.point[k]] == "check" and not _twice(control)[k]:
        return f"{head} {words}; look at it"
    return f"{head} {words}; not used: correct the pixel or the name"


def _moved_line(state: State, j: int) -> str:
    """About a point whose marks agree with each other, but not with its coordinates."""
    control = state.network.control
    own = np.flatnonzero((state.point == j) & state.good)
    at = state.network.place_of(j)
    d, s = state.x[at], np.sqrt(np.maximum(np.diag(state.P)[at], 0.0))
    return (
        f"{control.source[own[0]]}: the {len(own)} marks of {control.names[j]} agree with each "
        f"other, but put it {d[0]:+.2f} m east, {d[1]:+.2f} m north, {d[2]:+.2f} m up of its "
        f"coordinates (sigma {s[0]:.2f}, {s[1]:.2f}, {s[2]:.2f} m); not used: check the point"
    )


def _exchanged_line(control: ControlObservations, pair: tuple[int, int]) -> str:
    own = np.flatnonzero(np.isin(control.point, pair))
    a, b = (control.names[j] for j in pair)
    return (
        f"{control.source[own[0]]}: points {a} and {b} are exchanged: their {len(own)} marks fit "
        "each other's coordinates; not used: exchange the names"
    )


def _name(control: ControlObservations, k: int) -> str:
    return str(control.names[control.point[k]])


# -- resized photos ----------------------------------------------------------------------------


def _resized(network: Network) -> float | None:
    """Factor by which marks must grow, if they were measured in photos of another size."""
    control = network.control
    uv, _ = network.look(np.zeros(len(network.prior)), network.photo_of, control.point)
    ratios = []
    for a, b in combinations(range(len(uv)), 2) if len(uv) <= _MOST_MARKS else ():
        if network.photo_of[a] != network.photo_of[b] or control.point[a] == control.point[b]:
            continue
        marked = float(np.linalg.norm(control.uv[a] - control.uv[b]))
        seen = float(np.linalg.norm(uv[a] - uv[b]))
        if marked > 50.0 and seen > 50.0:
            ratios.append(np.log(seen / marked))
    if len(ratios) < 6:
        return None
    middle = float(np.median(ratios))
    spread = float(np.median(np.abs(np.array(ratios) - middle)))
    # Height and focal length change the scale as well, but not beyond their sigmas.
    sigma = max(
        float(np.hypot(p.pose.covariance[2, 2] ** 0.5 / max(_depth(network, i), 1.0),
                       p.camera.sigma_f / p.camera.fx))
        for i, p in enumerate(network.photos)
    )  # fmt: skip
    if abs(middle) < max(_RESIZED, 4.0 * sigma) or spread > 0.1:
        return None
    scale = float(np.exp(middle))
    other = replace(control, uv=scale * (control.uv + 0.5) - 0.5, sigma_px=control.sigma_px * scale)
    as_is = Search(network).divide(control.point)
    scaled = Search(replace(network, control=other)).divide(control.point)
    better = scaled.good.sum() >= as_is.good.sum() and scaled.cost < as_is.cost - 20.0
    return scale if better else None


def _depth(network: Network, photo: int) -> float:
    rows = network.control.point[network.photo_of == photo]
    return float(
        np.median(network.photos[photo].pose.cam_from_enu(network.control.p_enu[rows])[:, 2])
    )


def _resized_line(control: ControlObservations, scale: float) -> str:
    return (
        f"{control.source[0]}: u, v: the marks fit photos {scale:.2f} times as large: they were "
        f"measured in photos resized to about {100 / scale:.0f} %; not used: multiply them"
    )
