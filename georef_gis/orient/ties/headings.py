"""Headings that the pictures tell: turned pixels, courses that are no headings, none at all.

Seen from above each photo is a patch of ground around its camera's position `C`. Laid out by its
pose a patch may be turned, scaled and shifted: with `m` a place of the patch from `C`, as a complex
number of east + i north, the true place is `C + t + z m`, `|z|` and `arg z` being its scale and
counter-clockwise turn, `t` what position and tilt are off. A verified pair says `z_a s = z_b` of
its similarity `s`, and `C_a + t_a + z_a m_a = C_b + t_b + z_b m_b` of the middle of its matches: so
the positions, where they differ, carry the headings of all photos that hang together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from georef_gis.frames import Array, exp_so3
from georef_gis.model.photo import OrientedPhoto
from georef_gis.orient.ties.pairs import View, groups
from georef_gis.orient.ties.results import Turn
from georef_gis.orient.ties.verify import Verified

Complex = NDArray[np.complex128]

# rad; beyond this sigma the tags have no heading to speak of
NO_HEADING = math.radians(45.0)
# rad; a heading known no better is replaced by one of the pictures that is twice as good
POOR_HEADING = math.radians(5.0)
# rad; the positions carry the headings where they do so to this sigma
ABSOLUTE = math.radians(10.0)
# rad; a quarter turn is one within this, or within three sigmas
NEAR_QUARTER = math.radians(20.0)
# log of how much likelier a quarter turn must make the tags: few photos are turned
QUARTER_ODDS = 6.0
# share of photos whose tags may be wrong altogether, and how many of the others count: their
# errors have common causes
WRONG_TAGS, INDEPENDENT_TAGS = 0.3, 5.0
# sigmas beyond which the tags are contradicted
CONTRADICTED = 3.0
# one sigma of what else a patch of ground is off: rad (and log of scale), m, share of the height
PATCH_TURN, PATCH_SHIFT, PATCH_SHARE = 0.01, 0.3, 0.02
HUBER = 2.0
ITERATIONS = 12


def solve_headings(
    photos: Sequence[OrientedPhoto],
    views: Sequence[View],
    verified: Mapping[tuple[int, int], Verified],
) -> dict[int, Turn]:
    """What the verified pairs say of every photo's heading, by index of the photo."""
    group = groups(len(photos), list(verified))
    out: dict[int, Turn] = {}
    for g in np.unique(group):
        members = np.flatnonzero(group == g)
        if len(members) > 1:
            graph = _graph(photos, views, verified, members)
            out |= _solve(graph, members.tolist())
    return out


def with_turn(photo: OrientedPhoto, turn: Turn) -> OrientedPhoto:
    """The photo with its heading as the pictures have it.

    A half turn of the pixels turns the camera too. After a quarter turn the camera, read with the
    photo's own size, is that of the stored pixels already.
    """
    pose, camera = photo.pose, photo.camera
    if turn.quarter_deg == 180:
        camera = camera.turned(180)
    R = pose.R_enu_from_cam @ exp_so3([0.0, 0.0, -math.radians(turn.quarter_deg)])
    covariance = pose.covariance
    if turn.correct:
        R = exp_so3([0.0, 0.0, -turn.yaw]) @ R
        covariance = covariance.copy()
        covariance[5, :] = covariance[:, 5] = 0.0
        covariance[5, 5] = turn.sigma**2
    u, _, vt = np.linalg.svd(R)
    new = replace(pose, R_enu_from_cam=np.asarray(u @ vt), covariance=covariance)
    return replace(photo, camera=camera, pose=new)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Graph:
    """Photos that hang together, counted from 0, and their m pairs.

    `a`, `b` (m,) photos of each pair; `s` (m,) similarity of b's ground to a's; `m_a`, `m_b` (m,)
    middle of the matches from either camera; `sigma_turn`, `sigma_shift` (m,); of each photo its
    position `C`, `sigma_t`, m, `sigma_scale`, and the `sigma_yaw` of its tags, rad.
    """

    a: NDArray[np.intp]
    b: NDArray[np.intp]
    s: Complex
    m_a: Complex
    m_b: Complex
    sigma_turn: Array
    sigma_shift: Array
    C: Complex
    sigma_t: Array
    sigma_scale: Array
    sigma_yaw: Array


def _graph(
    photos: Sequence[OrientedPhoto],
    views: Sequence[View],
    verified: Mapping[tuple[int, int], Verified],
    members: NDArray[np.intp],
) -> _Graph:
    number = {int(i): k for k, i in enumerate(members)}
    keys = [key for key in sorted(verified) if key[0] in number]
    a, b = (np.array([number[key[side]] for key in keys]) for side in (0, 1))
    found = [verified[key] for key in keys]
    C = np.array([_complex(photos[i].pose.origin_enu) for i in members])
    sigma = np.sqrt([np.diag(photos[i].pose.covariance) for i in members])
    height = np.array([views[i].height for i in members])
    tilt = np.maximum(sigma[:, 3], sigma[:, 4])
    place = np.maximum(sigma[:, 0], sigma[:, 1])
    return _Graph(
        a=a,
        b=b,
        s=np.array([v.similarity for v in found]),
        m_a=np.array([_complex(v.middle[0]) for v in found]) - C[a],
        m_b=np.array([_complex(v.middle[1]) for v in found]) - C[b],
        # Seen aslant, a tilt turns and scales a patch by half its own size.
        sigma_turn=np.hypot(PATCH_TURN, 0.5 * np.hypot(tilt[a], tilt[b])),
        sigma_shift=np.hypot(PATCH_SHIFT, PATCH_SHARE * np.maximum(height[a], height[b])),
        C=C,
        sigma_t=np.hypot(place, height * tilt),
        sigma_scale=np.hypot(0.05, sigma[:, 2] / height),
        sigma_yaw=sigma[:, 5],
    )


def _complex(p: Array) -> complex:
    return complex(p[0], p[1])


def _solve(graph: _Graph, members: Sequence[int]) -> dict[int, Turn]:
    relative = _relative_turns(graph)
    common, sigma_common = _common_turn(graph, relative)
    absolute = sigma_common < ABSOLUTE
    psi, sigma = _adjusted(graph, _wrapped(relative + common), absolute=absolute)
    pairs = np.bincount(np.concatenate([graph.a, graph.b]), minlength=len(members))
    return {
        i: _turn(float(psi[k]), float(sigma[k]), float(graph.sigma_yaw[k]), absolute, int(pairs[k]))
        for k, i in enumerate(members)
    }


def _relative_turns(graph: _Graph) -> Array:
    """Turn of each photo against the first, rad: unit numbers that best obey all pairs; (n,).

    Notes
    -----
    The eigenvector of the largest eigenvalue of the Hermitian matrix of the pairs' turns (Singer
    2011, "Angular synchronization"), found by power iteration from a tree of pairs.
    """
    n = len(graph.C)
    unit = graph.s / np.abs(graph.s)
    weight = 1.0 / graph.sigma_turn**2
    rows = np.concatenate([graph.b, graph.a])
    columns = np.concatenate([graph.a, graph.b])
    values = np.concatenate([unit * weight, np.conj(unit) * weight])
    A = coo_array((values, (rows, columns)), shape=(n, n)).tocsr()
    degree = np.asarray(abs(A).sum(axis=1)).ravel()
    z = _along_tree(graph, unit)
    for _ in range(200):
        y = A @ z + degree * z
        y = y / np.maximum(np.abs(y), 1e-300)
        if np.abs(y - z).max() < 1e-9:
            break
        z = y
    return np.asarray(np.angle(z / z[0]))


def _along_tree(graph: _Graph, unit: Complex) -> Complex:
    """Turns as unit numbers by going from pair to pair from the first photo; shape (n,)."""
    z = np.zeros(len(graph.C), dtype=complex)
    z[0] = 1.0
    for _ in range(len(z)):
        known_a, known_b = z[graph.a] != 0, z[graph.b] != 0
        if np.all(known_a & known_b):
            break
        on, back = known_a & ~known_b, known_b & ~known_a
        z[graph.b[on]] = z[graph.a[on]] * unit[on]
        z[graph.a[back]] = z[graph.b[back]] * np.conj(unit[back])
    return z


def _common_turn(graph: _Graph, relative: Array) -> tuple[float, float]:
    """Turn of all photos together and its sigma by the positions alone, rad.

    Where the positions leave it open the tags of most photos decide.
    """
    z = np.exp(1j * relative)
    flown = graph.C[graph.b] - graph.C[graph.a]
    drawn = z[graph.a] * graph.m_a - z[graph.b] * graph.m_b
    variance = graph.sigma_shift**2 + graph.sigma_t[graph.a] ** 2 + graph.sigma_t[graph.b] ** 2
    weight = 1.0 / variance
    turn = 0.0
    for _ in range(ITERATIONS):
        turn = float(np.angle(np.sum(weight * np.conj(drawn) * flown)))
        off = np.abs(flown - np.exp(1j * turn) * drawn) / np.sqrt(variance)
        weight = np.minimum(1.0, HUBER / np.maximum(off, 1e-9)) / variance
    # Pairs share photos: no more of them count than there are photos.
    share = min(1.0, (len(graph.C) - 1) / len(flown))
    information = share * float(np.sum(weight * np.abs(drawn) * np.abs(flown)))
    sigma = min(1.0 / math.sqrt(max(information, 1e-9)), math.pi)
    grid = np.radians(np.arange(-180.0, 180.0, 0.5))
    score = -0.5 * (_wrapped(grid - turn) / sigma) ** 2
    off_tags = _wrapped(grid[:, None] + relative[None, :])
    width = np.hypot(graph.sigma_yaw, math.radians(1.0))
    density = np.exp(-0.5 * (off_tags / width) ** 2) / (math.sqrt(2 * math.pi) * width)
    tags = np.log((1.0 - WRONG_TAGS) * density + WRONG_TAGS / (2 * math.pi)).sum(axis=1)
    score += tags * min(1.0, INDEPENDENT_TAGS / len(relative))
    return float(grid[np.argmax(score)]), sigma


def _adjusted(graph: _Graph, start: Array, *, absolute: bool) -> tuple[Array, Array]:
    """Counter-clockwise turns of all photos and their sigmas, rad; shapes (n,).

    Gauss-Newton over turn, log of scale and shift of each photo, outlying pairs weighed down.
    """
    n = len(start)
    psi, scale, t = start.copy(), np.zeros(n), np.zeros(n, dtype=complex)
    trusted = np.abs(_wrapped(psi)) < CONTRADICTED * graph.sigma_yaw
    prior = np.where(trusted & (not absolute), 1.0 / graph.sigma_yaw, 0.0)
    # A whisper, so that what nothing tells stays where it is.
    prior = np.hypot(prior, 1e-2)
    goal = np.where(trusted, 0.0, psi)
    chi = 1.0
    for _ in range(ITERATIONS):
        J, r, weights = _equations(graph, psi, scale, t)
        pull = np.concatenate([prior, 1.0 / graph.sigma_scale, np.tile(1.0 / graph.sigma_t, 2)])
        off = np.concatenate([_wrapped(goal - psi), -scale, -t.real, -t.imag])
        N = csc_array(J.T @ diags_array(weights) @ J + diags_array(pull**2))
        factor = splu(N)
        step = factor.solve(J.T @ (weights * r) + pull**2 * off)
        psi = psi + np.clip(step[:n], -0.5, 0.5)
        scale = np.clip(scale + step[n : 2 * n], -1.0, 1.0)
        t = t + step[2 * n : 3 * n] + 1j * step[3 * n :]
        chi = float(np.sum(weights * r**2) / max(len(r) - 2 * n, 1))
        if np.abs(step[:n]).max() < 1e-5:
            break
    variance = np.empty(n)
    for k in range(n):
        one = np.zeros(4 * n)
        one[k] = 1.0
        variance[k] = factor.solve(one)[k]
    return _wrapped(psi), np.sqrt(np.maximum(variance, 0.0) * max(chi, 1.0))


def _equations(
    graph: _Graph, psi: Array, scale: Array, t: Complex
) -> tuple[csc_array, Array, Array]:
    """Jacobian (4 m, 4 n), misfit and robust weights (4 m,) of the pairs' equations."""
    n, m = len(psi), len(graph.a)
    z = np.exp(scale + 1j * psi)
    za, zb = z[graph.a], z[graph.b]
    # z_a s = z_b in logarithms
    turn = np.log(za * graph.s / zb)
    moved_a, moved_b = za * graph.m_a, zb * graph.m_b
    shift = (graph.C + t)[graph.a] + moved_a - (graph.C + t)[graph.b] - moved_b
    k, one = np.arange(m), np.ones(m)
    parts = []
    for row, photo, sign, moved in (
        (0, graph.a, 1.0, moved_a), (0, graph.b, -1.0, moved_b)
    ):  # fmt: skip
        parts += [
            (row + k, photo, sign * one), (m + k, n + photo, sign * one),
            (2 * m + k, photo, -sign * moved.imag), (3 * m + k, photo, sign * moved.real),
            (2 * m + k, n + photo, sign * moved.real), (3 * m + k, n + photo, sign * moved.imag),
            (2 * m + k, 2 * n + photo, sign * one), (3 * m + k, 3 * n + photo, sign * one),
        ]  # fmt: skip
    rows, columns, values = (np.concatenate([p[i] for p in parts]) for i in range(3))
    J = csc_array(coo_array((values, (rows, columns)), shape=(4 * m, 4 * n)))
    r = -np.concatenate([turn.imag, turn.real, shift.real, shift.imag])
    sigma = np.concatenate([graph.sigma_turn] * 2 + [graph.sigma_shift] * 2)
    worst = np.maximum.reduce(np.abs(r / sigma).reshape(4, m))
    robust = np.minimum(1.0, HUBER / np.maximum(worst, 1e-9))
    return J, r, np.tile(robust, 4) / sigma**2


def _turn(psi: float, sigma: float, sigma_tag: float, absolute: bool, pairs: int) -> Turn:
    """What a counter-clockwise turn of a photo's ground means for its heading."""
    either = math.hypot(sigma, sigma_tag)
    quarter = round(psi / (math.pi / 2)) % 4
    rest = float(_wrapped(np.array(psi - quarter * math.pi / 2)))
    near = abs(rest) < max(NEAR_QUARTER, CONTRADICTED * either)
    likelier = 0.5 * (psi**2 - rest**2) / either**2 > QUARTER_ODDS
    if sigma_tag > NO_HEADING or not (near and likelier):
        quarter, rest = 0, psi
    contradicted = abs(rest) > CONTRADICTED * either
    better = sigma_tag > POOR_HEADING and sigma < 0.5 * sigma_tag
    basis = "directions between the positions" if absolute else "headings of most photos"
    return Turn(
        quarter_deg=90 * quarter,
        yaw=-rest,
        sigma=sigma,
        correct=contradicted or better,
        absolute=absolute,
        pairs=pairs,
        evidence=(
            f"{math.degrees(-psi):+.0f} deg to {math.degrees(sigma):.1f} deg from {pairs} matched "
            f"pairs and the {basis}"
        ),
    )


def _wrapped(angle: Array) -> Array:
    """Angles between -pi and pi."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
