"""Whether an adjustment may be believed, and what it could not tell apart.

That all photos are placed and the residuals are small proves nothing: a block can bend, shrink or
tilt as a whole. So focal length, height above ground, angles and scale are held against what was
known before.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.terrain import Terrain
from georef_gis.orient.adjustment.adjust import Adjusted
from georef_gis.orient.adjustment.block import CAMERA_NAMES, FLIGHT_NAMES, Block

# sigmas beyond which a result is not used
REFUSED = 5.0
# of its prior sigma; an unknown that stays above was not told by the flight
HELD = 0.7
# share by which focal length and scale may be off in a block whose size is believed
SIZED = 0.08
CORRELATED = 0.9
# of all observations; more wrong matches than this and the rest is not believed either
MOST_WRONG = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One comparison: `value` against `expected` with one `sigma`, in `unit`.

    `remark` tells why one that is off has passed all the same.
    """

    name: str
    value: float
    expected: float
    sigma: float
    unit: str
    passed: bool
    remark: str = ""

    def told(self) -> str:
        """One line."""
        verdict = "agrees" if self.passed and not self.remark else "DOES NOT AGREE"
        end = f": {self.remark}" if self.remark else ""
        return (
            f"{self.name} {self.value:.4g} {self.unit} {verdict} with {self.expected:.4g} "
            f"+- {self.sigma:.2g} {self.unit}{end}"
        )


def plausibility(adjusted: Adjusted, terrain: Terrain | None) -> list[Check]:
    """Checks of focal length, height above ground, angles, scale and share of wrong matches."""
    out = [*_focal_lengths(adjusted), *_angles(adjusted)]
    scale = _scale(adjusted)
    out += scale
    if terrain is not None:
        heights = _heights(adjusted, terrain)
        out += [_blamed_on_ground(c, scale) for c in heights] if _is_sized(out) else heights
    kept = len(adjusted.problem.ties.photo)
    wrong = int(adjusted.removed.sum())
    share = wrong / max(kept + wrong, 1)
    passed = share <= MOST_WRONG
    out.append(_check("share of wrong matches", share, 0.0, MOST_WRONG / 3.0, "", passed=passed))
    return out


def _is_sized(checks: list[Check]) -> bool:
    """Whether focal lengths and scale say that the block has its size, and so its height."""
    focal = [c for c in checks if c.name.startswith("focal length")]
    scale = [c for c in checks if c.name == "scale"]
    sure = all(abs(c.value / c.expected - 1.0) <= SIZED for c in [*focal, *scale])
    return bool(scale) and sure and all(c.passed for c in [*focal, *scale])


def _blamed_on_ground(check: Check, scale: list[Check]) -> Check:
    """A height above ground that fails though the block has the right size."""
    sized = abs(check.value) > 2.0 * scale[0].sigma * abs(check.value)
    if check.passed or check.value <= 0.0 or not sized:
        return check
    remark = (
        "focal length and scale agree, so the photos are kept and the ground's height is off by "
        f"{check.value - check.expected:+.1f} m; check [ground] dem, dem_height_kind, height_m and "
        "[gnss] height_kind: heights above the ellipsoid taken for heights above sea level?"
    )
    return replace(check, passed=True, remark=remark)


def _check(
    name: str, value: float, expected: float, sigma: float, unit: str, *, passed: bool
) -> Check:
    return Check(
        name=name, value=float(value), expected=float(expected), sigma=float(sigma), unit=unit,
        passed=bool(passed),
    )  # fmt: skip


def _focal_lengths(adjusted: Adjusted) -> list[Check]:
    out = []
    for prior, camera in zip(adjusted.block.cameras, adjusted.cameras, strict=True):
        if prior.sigma[0] > 0:
            off = abs(camera.fx - prior.camera.fx) / prior.sigma[0]
            out.append(
                _check(
                    f"focal length of {camera.id}", camera.fx, prior.camera.fx, prior.sigma[0],
                    "px", passed=bool(off <= REFUSED),
                )
            )  # fmt: skip
    return out


def _connected(adjusted: Adjusted) -> NDArray[np.intp]:
    n = len(adjusted.block.photo_ids)
    return np.flatnonzero(np.bincount(adjusted.problem.ties.photo, minlength=n))


def _angles(adjusted: Adjusted) -> list[Check]:
    """Turns of the poses against all that was known of them, the mount included."""
    out = []
    state = adjusted.solution.state
    for index, flight in enumerate(adjusted.problem.flights):
        prior, shared = flight.prior, state.flights[index].copy()
        shared[3:6] = 0.0
        d = flight.residual(state.origin, state.rotation, shared)
        R = prior.R_enu_from_body
        mount = np.einsum("nij,jk,nik->ni", R, prior.shared_covariance[3:6, 3:6], R)
        sigma = np.sqrt(prior.sigmas()[:, 3:] ** 2 + mount)
        seen = np.isin(prior.photos, _connected(adjusted))
        if not np.any(seen):
            continue
        # axis by axis: a block that tilts turns about one of them
        ratio = np.max(np.median(np.abs(d[seen, 3:]) / np.maximum(sigma[seen], 1e-6), axis=0))
        degrees = np.degrees(np.median(np.linalg.norm(d[seen, 3:], axis=1)))
        typical = np.degrees(np.median(np.linalg.norm(sigma[seen], axis=1)))
        name = f"turn of the photos of {prior.id}"
        out.append(_check(name, degrees, 0.0, typical, "deg", passed=bool(ratio <= REFUSED)))
    return out


def _scale(adjusted: Adjusted) -> list[Check]:
    """Size of the block by the distances between the photos' positions."""
    # places that were weighed down say nothing of the size
    doubted = {d.photo for d in adjusted.doubted if d.component < 2}
    seen = [i for i in _connected(adjusted) if i not in doubted]
    if len(seen) < 3:
        return []
    block = adjusted.block
    before = np.array([block.poses[i].origin_enu for i in seen])
    after = np.array([adjusted.poses[i].origin_enu for i in seen])
    a, b = before - np.median(before, axis=0), after - np.median(after, axis=0)
    # heights of a receiver in the air wander by tens of metres: the plane alone
    size = float(np.sum(b[:, :2] ** 2))
    if size < 1.0:
        return []
    scale = float(np.sum(a[:, :2] * b[:, :2]) / size)
    sigma = np.median([np.sqrt(np.trace(block.poses[i].covariance[:2, :2]) / 2) for i in seen])
    # slow errors are alike over neighbours: as if only a few positions counted
    spread = float(sigma) / np.sqrt(size / len(seen)) / np.sqrt(min(len(seen), 6))
    value = 1.0 / scale if scale > 0.05 else float("inf")
    return [_check("scale", value, 1.0, spread, "", passed=abs(scale - 1.0) <= REFUSED * spread)]


def _heights(adjusted: Adjusted, terrain: Terrain) -> list[Check]:
    """Height of the cameras above the points below them."""
    seen = _connected(adjusted)
    block, points = adjusted.block, adjusted.points
    if len(seen) == 0 or len(points) < 5:
        return []
    ties = adjusted.block.ties
    found, expected, sigma = [], [], []
    for i in seen:
        z = points.p_enu[ties.point[ties.photo == i], 2]
        before = block.poses[i]
        ground = float(terrain.z_at(before.origin_enu[:2]))
        if not np.isfinite(ground) or len(z) < 3:
            continue
        found.append(adjusted.poses[i].origin_enu[2] - float(np.median(z)))
        expected.append(before.origin_enu[2] - ground)
        sigma.append(np.sqrt(before.covariance[2, 2] + terrain.sigma**2))
    if not found:
        return []
    value, known, spread = np.median(found), np.median(expected), float(np.median(sigma))
    # relief under the photos is not known to a flat ground
    spread = float(np.hypot(spread, 0.05 * known))
    passed = abs(value - known) <= REFUSED * spread and value > 0
    return [_check("height above ground", value, known, spread, "m", passed=passed)]


# -- what the flight could tell ----------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """A shared unknown after the adjustment, as a step from its prior."""

    name: str
    value: float
    sigma: float
    prior_sigma: float
    unit: str

    @property
    def held(self) -> bool:
        """Whether it stays where its prior put it, for the flight cannot tell it."""
        return self.sigma > HELD * self.prior_sigma


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observability:
    """What the flight told of the shared unknowns.

    Parameters
    ----------
    unknowns
        All that were free.
    correlation : shape (k, k)
        Of their errors.
    pairs
        Names of two that cannot be told apart, and their correlation.
    condition
        Of the normal matrix with unit diagonal: its logarithm to 10 is the digits lost.
    """

    unknowns: tuple[Unknown, ...]
    correlation: Array
    pairs: tuple[tuple[str, str, float], ...]
    condition: float

    def told(self) -> list[str]:
        """Lines for people."""
        held = [u.name for u in self.unknowns if u.held]
        lines = []
        if held:
            lines.append(f"the flight could not tell, so the prior holds: {', '.join(held)}")
        lines += [f"{a} and {b} are told apart badly (correlation {r:+.2f})"
                  for a, b, r in self.pairs]  # fmt: skip
        return lines

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "unknowns": [asdict(u) | {"held_by_prior": u.held} for u in self.unknowns],
            "correlation": np.round(self.correlation, 4).tolist(),
            "badly_separated": [list(pair) for pair in self.pairs],
            "condition": self.condition if np.isfinite(self.condition) else None,
        }


def observability(adjusted: Adjusted) -> Observability:
    """Correlations and condition of the shared unknowns.

    Of one height and one speed, a clock's offset, the forward lever arm and the pitch of the
    boresight are the same signal: `docs/adjustment.md` has the table of what separates what.
    """
    block, covariances = adjusted.block, adjusted.covariances
    spread = covariances.shared()
    prior = prior_sigmas(block)
    free = np.flatnonzero((prior > 0) & adjusted.problem.free)
    sigma = np.sqrt(np.maximum(np.diag(spread)[free], 1e-300))
    correlation = spread[np.ix_(free, free)] / np.outer(sigma, sigma)
    names, values = block.shared_names, adjusted.shared
    unknowns = tuple(
        Unknown(
            name=names[i], value=float(values[i]), sigma=float(s), prior_sigma=float(prior[i]),
            unit=_unit(names[i]),
        )
        for i, s in zip(free, sigma, strict=True)
    )  # fmt: skip
    pairs = []
    for a in range(len(free)):
        for b in range(a + 1, len(free)):
            r = float(correlation[a, b])
            both_told = not (unknowns[a].held and unknowns[b].held)
            if abs(r) > CORRELATED and both_told:
                pairs.append((unknowns[a].name, unknowns[b].name, r))
    return Observability(
        unknowns=unknowns, correlation=correlation, pairs=tuple(pairs),
        condition=covariances.condition(),
    )  # fmt: skip


def prior_sigmas(block: Block) -> Array:
    """One sigma of each shared unknown beforehand, 0 where it is held; shape (G,)."""
    parts = [p.sigma for p in block.cameras]
    parts += [np.sqrt(np.diag(flight.shared_covariance)) for flight in block.flights]
    return np.concatenate([*parts, block.sigma_shifts])


def _unit(name: str) -> str:
    last = name.split(" ")[-1]
    if last in FLIGHT_NAMES:
        return "rad" if last.startswith("boresight") else "s" if last == "clock" else "m"
    if last in CAMERA_NAMES:
        return {"readout_s": "s"}.get(last, "px" if last[0] in "fcb" else "")
    return "m"
