"""What is told of a calibrated mount: a table, a section of project.toml, JSON with covariance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.pose import Mount
    from georef_gis.orient.two_step import MountEstimate


def table_lines(found: MountEstimate) -> list[str]:
    """Tables 4 and 5 of the paper as lines of text."""
    lines = ["axes right, forward, up   value   sd of one photo   sd of the value   photos"]
    for row in found.to_table():
        lines.append(
            f"{row.quantity:<6s} {row.unit:<4s} {row.value:12.4f} {row.sd:12.4f} "
            f"{row.sd_mean:12.4f} {row.photos:6d}"
        )
    return lines


def mount_section(mount: Mount, found: MountEstimate) -> str:
    """Section [mount] for project.toml."""
    import numpy as np

    def three(values: Array, digits: int) -> str:
        return "[" + ", ".join(f"{v:.{digits}f}" for v in values) + "]"

    lines = [
        f"# from {len(found.samples)} photos; body axes forward, right, down",
        "[mount]",
        f"lever_arm_camera_m = {three(mount.lever_arm_body_camera, 5)}",
    ]
    if np.any(mount.lever_arm_body_antenna):
        lines.append(f"lever_arm_antenna_m = {three(mount.lever_arm_body_antenna, 5)}")
    lines += [
        f"sigma_lever_arm_m = {max(mount.sigma_lever_arm, 1e-5):.5f}",
        f"boresight_deg = {three(np.degrees(mount.boresight_body), 5)}",
        f"sigma_boresight_deg = {max(math.degrees(mount.sigma_boresight), 1e-5):.5f}",
    ]
    return "\n".join(lines) + "\n"


def json_account(found: MountEstimate, doubts: list[str]) -> dict[str, Any]:
    """All of an estimate as JSON-able values."""
    from dataclasses import asdict

    def number(value: Any) -> Any:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    rows = [{key: number(v) for key, v in asdict(row).items()} for row in found.to_table()]
    return {
        "kind": "mount calibration",
        "axes": "body: forward, right, down; table: right, forward, up",
        "lever_arm_body_camera_m": found.lever_arm_body_camera.tolist(),
        "R_body_from_cam": found.R_body_from_cam.tolist(),
        "order": "lever arm (m), left rotation error in body axes (rad)",
        "covariance": found.covariance.tolist(),
        "covariance_if_independent": found.covariance_independent.tolist(),
        "sigma0": number(found.sigma0),
        "table": rows,
        "residuals": {
            sample.photo_id: residual.tolist()
            for sample, residual in zip(found.samples, found.residuals, strict=True)
        },
        "left_out": dict(found.left_out),
        "doubts": doubts,
    }
