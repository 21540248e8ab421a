"""Camera from photos of targets: blunders, coverage, weak geometry.

A board is a field whose targets are regular; an indoor or outdoor field has surveyed ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.orient.calibration.bundle import (
    BROWN,
    FISHEYE,
    BundleFit,
    State,
    Targets,
    View,
    adjust,
    corner_sigma,
    start,
)
from georef_gis.orient.resection import projection_jacobian

# marks that a photo must show
FEWEST_MARKS = 6
# a residual this many robust sigmas long is a blunder
BLUNDER = 6.0
# px; residuals below this are no blunders
GOOD_ENOUGH = 0.3
# root of the ratio by which moved targets explain more than noise would
MOVED_TARGETS = 1.6
# cells across and down in which coverage is counted
CELLS = (8, 6)
# rad; boards that differ less in tilt leave focal length and distance one unknown
SAME_TILT = math.radians(12.0)
# share of the focal length; a worse one is named
WEAK_FOCAL = 0.003
_ROUNDS = 12
# px; marks are never taken to be better
_LEAST_SIGMA = 0.01

Lens = Literal["brown", "fisheye"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """How to calibrate.

    Parameters
    ----------
    lens
        "brown" or "fisheye".
    skew
        Whether to estimate b2 too (Brown).
    sigma_px
        px, one sigma of a mark where it states none; None: from the residuals.
    focal_px
        px, a guess; the search starts from it too.
    """

    lens: Lens = "brown"
    skew: bool = False
    sigma_px: float | None = None
    focal_px: float | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        if self.lens == "fisheye":
            return FISHEYE
        return (*BROWN, "b2") if self.skew else BROWN


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A calibrated camera and how good it is.

    Parameters
    ----------
    covariance : shape (k, k)
        Of `parameters`, px and 1, scaled by sigma0.
    sigma0
        px, of a mark, from the residuals; where sigmas were stated, of unit weight.
    rms_px
        Per photo, one axis, px.
    left_out
        Reason by photo.
    marks_left_out
        Number of single marks that were blunders.
    coverage
        Share of the cells of the image that marks fall into.
    corner_sigma_px
        One sigma of the pixel of a ray through each corner of the image, px.
    targets : shape (t, 3), m
        Adjusted where they have sigmas.
    """

    camera: Camera
    parameters: tuple[str, ...]
    covariance: Array
    sigma0: float
    redundancy: int
    rms_px: Mapping[str, float]
    left_out: Mapping[str, str]
    marks_left_out: int
    coverage: float
    corner_sigma_px: tuple[float, ...]
    targets: Array
    state: State
    doubts: tuple[str, ...] = field(default=())

    @property
    def sd(self) -> dict[str, float]:
        """One sigma by parameter."""
        sd = np.sqrt(np.diag(self.covariance))
        return {n: float(v) for n, v in zip(self.parameters, sd, strict=True)}

    @property
    def correlation(self) -> Array:
        """Correlations of the parameters; shape (k, k)."""
        sd = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(sd, sd))


def calibrate_field(
    camera_id: str,
    size: tuple[int, int],
    targets: Targets,
    views: Sequence[View],
    settings: CalibrationSettings | None = None,
) -> Calibration:
    """Camera from photos of known targets by a self-calibrating bundle.

    Parameters
    ----------
    camera_id
        Name of the camera.
    size
        Width and height of the photos, px.
    targets
        Their coordinates; those with sigmas are adjusted too.
    views
        Marks per photo, px, (0, 0) = centre of the first pixel.
    settings
        Lens and sigmas.

    Raises
    ------
    AdjustmentError
        If photos or marks are too few, or nothing fits.
    """
    settings = settings or CalibrationSettings()
    views, left_out = _enough(targets, views)
    _check_views(targets, views, left_out)
    first = _first_camera(camera_id, size, settings)
    state = start(size, targets, views, first)
    state, views, left_out, dropped = _without_bad_starts(state, targets, views, left_out)
    fit, views, more, lost = _cleaned(state, targets, views, settings)
    fit, views, unit = _reweighted(fit, targets, views, settings)
    return _judged(fit, targets, views, settings, {**left_out, **more}, (dropped + lost, unit))


def _first_camera(camera_id: str, size: tuple[int, int], settings: CalibrationSettings) -> Camera:
    width, height = size
    focal = settings.focal_px or 1.0 * max(size)
    return Camera(
        id=camera_id,
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=(width - 1) / 2.0,
        cy=(height - 1) / 2.0,
        model=settings.lens,
        source="calibration",
    )


def _enough(targets: Targets, views: Sequence[View]) -> tuple[list[View], dict[str, str]]:
    kept, left_out = [], {}
    for view in views:
        if len(view.index) != len(np.unique(view.index)):
            raise InputError("a target is marked twice; remove one", source=f"photo {view.id}")
        if len(view.index) < FEWEST_MARKS:
            left_out[view.id] = f"{len(view.index)} marks, {FEWEST_MARKS} are needed"
            continue
        xyz = targets.xyz[view.index]
        size = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
        if size[1] < 0.02 * size[0]:
            left_out[view.id] = "its marks lie in a line"
            continue
        kept.append(view)
    return kept, left_out


def _planar(targets: Targets) -> bool:
    size = np.linalg.svd(targets.xyz - targets.xyz.mean(axis=0), compute_uv=False)
    return bool(size[2] < 0.02 * size[1])


def _check_views(targets: Targets, views: Sequence[View], left_out: Mapping[str, str]) -> None:
    needed = 3 if _planar(targets) else 1
    if len(views) < needed:
        reason = "; ".join(f"{k}: {v}" for k, v in list(left_out.items())[:3])
        raise AdjustmentError(
            f"{len(views)} photos show enough targets, {needed} are needed, better 12"
            + (f" ({reason})" if reason else "")
        )


def _without_bad_starts(
    state: State, targets: Targets, views: Sequence[View], left_out: dict[str, str]
) -> tuple[State, list[View], dict[str, str], int]:
    """Leave out marks that are far off already with the first camera."""
    kept, origins, turns, dropped = [], [], [], 0
    left_out = dict(left_out)
    offs = [_off(state, i, view) for i, view in enumerate(views)]
    typical = float(np.median(np.concatenate([np.hypot(*off.T) for off in offs])))
    for i, view in enumerate(views):
        off = np.hypot(*offs[i].T)
        # The lens is not known yet: its distortion is up to tens of pixels.
        good = off < max(20.0 * typical, 20.0)
        if np.count_nonzero(good) < FEWEST_MARKS:
            left_out[view.id] = f"its marks are off by {np.median(off):.0f} px: mislabelled?"
            continue
        dropped += int(np.count_nonzero(~good))
        kept.append(view.only(good))
        origins.append(state.origins[i])
        turns.append(state.R[i])
    return replace(state, origins=origins, R=turns), kept, left_out, dropped


def _off(state: State, i: int, view: View) -> Array:
    p_cam = (state.xyz[view.index] - state.origins[i]) @ state.R[i]
    return np.nan_to_num(view.uv - state.camera.project(p_cam), nan=1e6)


def _cleaned(
    state: State, targets: Targets, views: list[View], settings: CalibrationSettings
) -> tuple[BundleFit, list[View], dict[str, str], int]:
    """Bundle without outlying marks, and without photos of which more than a few marks are."""
    left_out: dict[str, str] = {}
    lost = {view.id: 0 for view in views}
    fit = adjust(state, targets, views, settings.parameters)
    for _ in range(_ROUNDS):
        lengths = [np.hypot(*r.T) for r in fit.residuals]
        rms = [math.sqrt(float(np.mean(n**2)) / 2.0) for n in lengths]
        # Rayleigh's median is 1.1774 sigma of an axis.
        sigma = float(np.median(np.concatenate(lengths))) / 1.1774
        limit = max(BLUNDER * sigma, GOOD_ENOUGH)
        kept: list[View] = []
        places: list[int] = []
        for i, view in enumerate(views):
            # A blunder pulls its neighbours along: the worst go first.
            bad = lengths[i] > max(limit, 0.5 * float(lengths[i].max()))
            allowed = max(2, round(0.1 * (len(view.index) + lost[view.id])))
            others = float(np.median(rms[:i] + rms[i + 1 :])) if len(views) > 1 else rms[i]
            if np.count_nonzero(bad) + lost[view.id] > allowed and len(views) > 3:
                left_out[view.id] = (
                    f"rms {rms[i]:.2f} px against {others:.2f} px of the others: blurred, "
                    "mislabelled, or the board was moved or bent"
                )
                continue
            if len(view.index) - np.count_nonzero(bad) < FEWEST_MARKS:
                left_out[view.id] = "too few marks are left without blunders"
                continue
            lost[view.id] += int(np.count_nonzero(bad))
            kept.append(view.only(~bad))
            places.append(i)
        if sum(len(v.index) for v in kept) == sum(len(v.index) for v in views):
            break
        _check_views(targets, kept, left_out)
        state, views = _only(fit.state, places), kept
        fit = adjust(state, targets, views, settings.parameters)
    return fit, views, left_out, sum(lost[view.id] for view in views)


def _only(state: State, places: Sequence[int]) -> State:
    return replace(
        state, origins=[state.origins[i] for i in places], R=[state.R[i] for i in places]
    )


def _reweighted(
    fit: BundleFit, targets: Targets, views: list[View], settings: CalibrationSettings
) -> tuple[BundleFit, list[View], float]:
    """Bundle whose marks have the sigma that their residuals show, and that sigma, px.

    The weak priors, and the targets' sigmas, then have their due weight.
    """
    if settings.sigma_px is not None:
        return fit, views, 1.0
    unit = 1.0
    for _ in range(3):
        squares = sum(float(np.sum(r**2)) for r in fit.residuals)
        count = sum(r.size for r in fit.residuals)
        # Adjusted targets take up part of the redundancy of the marks.
        share = min(max(fit.redundancy / max(count, 1), 0.05), 1.0)
        now = max(math.sqrt(squares / (count * share)), _LEAST_SIGMA)
        views = [replace(view, sigma=view.sigma * now / unit) for view in views]
        fit = adjust(fit.state, targets, views, settings.parameters)
        if abs(now / unit - 1.0) < 0.02:
            unit = now
            break
        unit = now
    return fit, views, unit


# -- judgement ----------------------------------------------------------------------------------


def _judged(
    fit: BundleFit,
    targets: Targets,
    views: Sequence[View],
    settings: CalibrationSettings,
    left_out: Mapping[str, str],
    lost_and_unit: tuple[int, float],
) -> Calibration:
    k = len(fit.parameters)
    dropped, unit = lost_and_unit
    sigma0 = math.sqrt(fit.chi2 / max(fit.redundancy, 1))
    stated = settings.sigma_px is not None
    scale = sigma0**2 if not stated or (sigma0 > 1.0 and fit.redundancy > 30) else 1.0
    covariance = scale * fit.covariance[:k, :k]
    camera = fit.state.camera
    sd = dict(zip(fit.parameters, np.sqrt(np.diag(covariance)), strict=True))
    camera = replace(
        camera,
        sigma_f=float(max(sd["fx"], sd["fy"])),
        sigma_c=float(max(sd["cx"], sd["cy"])),
        source=f"calibration, {len(views)} photos",
    )
    at_corners = corner_sigma(camera, covariance, fit.parameters)
    out = Calibration(
        camera=camera,
        parameters=fit.parameters,
        covariance=covariance,
        sigma0=sigma0 * unit,
        redundancy=fit.redundancy,
        rms_px={
            v.id: math.sqrt(float(np.mean(np.sum(r**2, axis=1))) / 2.0)
            for v, r in zip(views, fit.residuals, strict=True)
        },
        left_out=dict(left_out),
        marks_left_out=dropped,
        coverage=_coverage(camera, views),
        corner_sigma_px=tuple(float(v) for v in at_corners),
        targets=fit.state.xyz,
        state=fit.state,
    )
    return replace(out, doubts=tuple(_doubts(out, fit, targets, views)))


def _coverage(camera: Camera, views: Sequence[View]) -> float:
    uv = np.concatenate([view.uv for view in views])
    size = np.array([camera.width, camera.height])
    cells = np.clip(((uv + 0.5) / size * CELLS).astype(int), 0, np.array(CELLS) - 1)
    return len(np.unique(cells, axis=0)) / (CELLS[0] * CELLS[1])


def _doubts(c: Calibration, fit: BundleFit, targets: Targets, views: Sequence[View]) -> list[str]:
    doubts = [f"photo {photo} is left out: {reason}" for photo, reason in c.left_out.items()]
    focal = c.sd["fx"] / c.camera.fx
    if _planar(targets):
        spread = _tilt_spread(fit.state)
        if spread < SAME_TILT:
            doubts.append(
                f"all photos see the board under nearly one tilt (to {math.degrees(spread):.1f} "
                "deg): focal length and distance cannot be told apart; tilt the board by 30 to 45 "
                "deg to each side"
            )
    if focal > WEAK_FOCAL:
        doubts.append(
            f"the focal length is weak: {c.camera.fx:.1f} +- {c.sd['fx']:.1f} px ({focal:.1%}); "
            "take tilted photos that fill the image"
        )
    if c.coverage < 0.7:
        doubts.append(
            f"marks cover {c.coverage:.0%} of the image only: the lens is extrapolated at its edge "
            f"(one sigma of up to {np.nanmax(c.corner_sigma_px):.1f} px in the corners)"
        )
    if len(views) < 8:
        doubts.append(f"{len(views)} photos only; 12 or more make sure of the lens")
    return doubts + _shape_doubts(c, fit, targets, views)


def _tilt_spread(state: State) -> float:
    """Largest angle between the view axes in the targets' frame, rad."""
    axes = np.array([R[:, 2] for R in state.R])
    cosine = np.clip(axes @ axes.T, -1.0, 1.0)
    return float(np.arccos(cosine.min()))


def _shape_doubts(
    c: Calibration, fit: BundleFit, targets: Targets, views: Sequence[View]
) -> list[str]:
    """Whether moving single targets would explain their residuals.

    A target in n photos has b^T N^-1 b / sigma^2 of its squares explained by a move in space: 3 on
    the average where it is right, as long as 2 n is large.
    """
    t = len(targets.xyz)
    N, b, seen = np.zeros((t, 3, 3)), np.zeros((t, 3)), np.zeros(t, dtype=int)
    squares, count = 0.0, 0
    for i, (view, r) in enumerate(zip(views, fit.residuals, strict=True)):
        R = fit.state.R[i]
        p_cam = (fit.state.xyz[view.index] - fit.state.origins[i]) @ R
        J = projection_jacobian(fit.state.camera, p_cam) @ R.T
        np.add.at(N, view.index, np.swapaxes(J, 1, 2) @ J)
        np.add.at(b, view.index, np.einsum("nij,ni->nj", J, r))
        np.add.at(seen, view.index, 1)
        squares, count = squares + float(np.sum(r**2)), count + r.size
    often = (seen >= 5) & (np.linalg.cond(N) < 1e8)
    if np.count_nonzero(often) < FEWEST_MARKS:
        return []
    moves = np.linalg.solve(N[often], b[often][..., None])[..., 0]
    explained = np.einsum("ni,ni->n", moves, b[often])
    rest = max(squares - float(explained.sum()), 1e-12) / max(count - 3 * len(moves), 1)
    ratio = math.sqrt(float(np.mean(explained)) / (3.0 * rest))
    if ratio < MOVED_TARGETS:
        return []
    worst = int(np.argmax(explained))
    return [
        f"targets are not where they are said to be (moves explain {ratio:.1f} times more than "
        f"noise would; worst: {targets.names[np.flatnonzero(often)[worst]]}, "
        f"{1e3 * np.linalg.norm(moves[worst]):.2f} mm): a bent board, or wrong coordinates; give "
        "them a sigma"
    ]
