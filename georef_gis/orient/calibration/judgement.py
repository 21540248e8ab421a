"""A calibrated camera and how good it is: sigmas, coverage, weak geometry, moved targets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.orient.calibration.bundle import BundleFit, State, Targets, View, corner_sigma
from georef_gis.orient.calibration.usable import FEWEST_MARKS, planar
from georef_gis.orient.pixel_derivatives import projection_jacobian

# root of the ratio by which moved targets explain more than noise would
MOVED_TARGETS = 1.6
# cells across and down in which coverage is counted
CELLS = (8, 6)
# rad; boards that differ less in tilt leave focal length and distance one unknown
SAME_TILT = math.radians(12.0)
# share of the focal length; a worse one is named
WEAK_FOCAL = 0.003


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


def judged(
    fit: BundleFit,
    targets: Targets,
    views: Sequence[View],
    *,
    left_out: Mapping[str, str],
    marks_left_out: int,
    unit: float | None,
) -> Calibration:
    """Calibration of a bundle with its sigmas and doubts; see `Calibration`.

    Parameters
    ----------
    unit : px
        Sigma of a mark as the residuals show it; None where the sigmas were stated.
    """
    k = len(fit.parameters)
    sigma0 = math.sqrt(fit.chi2 / max(fit.redundancy, 1))
    scaled = unit is not None or (sigma0 > 1.0 and fit.redundancy > 30)
    scale = sigma0**2 if scaled else 1.0
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
        sigma0=sigma0 if unit is None else sigma0 * unit,
        redundancy=fit.redundancy,
        rms_px={
            v.id: math.sqrt(float(np.mean(np.sum(r**2, axis=1))) / 2.0)
            for v, r in zip(views, fit.residuals, strict=True)
        },
        left_out=dict(left_out),
        marks_left_out=marks_left_out,
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
    if planar(targets):
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
