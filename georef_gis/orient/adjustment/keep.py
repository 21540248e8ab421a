"""What an adjustment leaves on disk: points, residuals, and the factor for covariances."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.model.tie_points import GroundPoints, TiePoints
from georef_gis.project.band_covariance import save_band_covariance
from georef_gis.project.columns_file import columns_of, write_columns
from georef_gis.project.joint_covariance import save_joint_covariance

if TYPE_CHECKING:
    # who keeps or reads tie points alone need not load the solver's kernels
    from georef_gis.orient.adjustment.adjust import Adjusted

POINTS, RESIDUALS, COVARIANCE = "points.npz", "residuals.npz", "covariance.npz"
BAND = "covariance_band.npz"
POINTS_KIND, TIES_KIND = "ground points", "tie points"
# unknowns up to which the whole covariance is kept: 128 MB
MOST_KEPT = 4000
# numbers up to which the band of a larger block is kept, with that of its inverse: 400 MB
MOST_IN_BAND = 50_000_000


def save_ties(path: Path, ties: TiePoints) -> None:
    """Write tie points, whole or not at all."""
    write_columns(
        path,
        TIES_KIND,
        {
            "photo_ids": list(ties.photo_ids), "photo": ties.photo, "point": ties.point,
            "uv": ties.uv, "sigma": ties.sigma,
        },
    )  # fmt: skip


def load_ties(path: Path) -> TiePoints:
    """Read what `save_ties` wrote.

    Raises
    ------
    InputError
        If the file is missing, cut off or none of ours.
    """
    with columns_of(path, TIES_KIND, cure="run `georef match --force`") as read:
        return TiePoints(
            photo_ids=tuple(str(name) for name in read["photo_ids"]),
            photo=read["photo"].astype(np.int32),
            point=read["point"].astype(np.int32),
            uv=read["uv"],
            sigma=read["sigma"],
        )


def save_adjusted(folder: Path, adjusted: Adjusted) -> dict[str, Path]:
    """Write points, residuals and the covariance: whole, of a large block as its band."""
    points, ties = adjusted.points, adjusted.problem.ties
    files = {name: folder / name for name in (POINTS, RESIDUALS)}
    write_columns(
        files[POINTS],
        POINTS_KIND,
        {
            "p_enu": points.p_enu, "covariance": points.covariance.astype(np.float32),
            "rays": points.rays, "residual_px": points.residual_px.astype(np.float32),
        },
    )  # fmt: skip
    write_columns(
        files[RESIDUALS],
        "residuals",
        {
            "photo_ids": list(adjusted.block.photo_ids), "photo": ties.photo, "point": ties.point,
            "uv": ties.uv.astype(np.float32), "residual": adjusted.residuals.astype(np.float32),
            "sigma": adjusted.problem.sigma.astype(np.float32), "mark": adjusted.problem.mark_of,
        },
    )  # fmt: skip
    kept = folder / COVARIANCE
    if adjusted.covariances.size > MOST_KEPT:
        kept.unlink(missing_ok=True)
        kept = folder / BAND
        band = adjusted.covariances.band_errors()
        if band is None or band.factor.size + band.inverse.size > MOST_IN_BAND:
            kept.unlink(missing_ok=True)
            return files
        save_band_covariance(
            kept,
            photo_ids=adjusted.block.photo_ids,
            shared_names=adjusted.block.shared_names,
            errors=band,
        )
        return {**files, BAND: kept}
    (folder / BAND).unlink(missing_ok=True)
    save_joint_covariance(
        kept,
        photo_ids=adjusted.block.photo_ids,
        shared_names=adjusted.block.shared_names,
        covariance=adjusted.covariances.inverse(),
        with_level=adjusted.covariances.with_level,
    )
    return {**files, COVARIANCE: kept}


def load_points(path: Path) -> GroundPoints:
    """Read the ground points of an adjustment.

    Raises
    ------
    InputError
        If the file is missing, cut off or none of ours.
    """
    with columns_of(path, POINTS_KIND) as read:
        return GroundPoints(
            p_enu=read["p_enu"],
            covariance=read["covariance"].astype(np.float64),
            rays=read["rays"].astype(np.int32),
            residual_px=read["residual_px"].astype(np.float64),
        )
