"""What is written of a calibration: a section for project.toml, and JSON with the covariance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from georef_gis.orient.calibration.judgement import Calibration


def toml_snippet(c: Calibration, *, heading: str = "[camera]") -> str:
    """Section for project.toml: paste it in place of [camera]."""
    camera = c.camera
    lines = [
        f"# {camera.id}: photos of {camera.width} x {camera.height} px, {camera.source}",
        heading,
        f'model = "{camera.model}"',
    ]
    names = list(c.parameters)
    for name in names:
        digits = ".4f" if name in ("fx", "fy", "cx", "cy", "b2") else ".9g"
        sd = ".2g"
        lines.append(f"{name} = {getattr(camera, name):{digits}}  # +- {c.sd[name]:{sd}}")
    percent = max(100.0 * camera.sigma_f / camera.fx, 1e-4)
    lines.append(f"sigma_focal_percent = {percent:.4g}")
    lines.append(f"sigma_principal_point_px = {max(camera.sigma_c, 1e-3):.4g}")
    return "\n".join(lines) + "\n"


def json_account(c: Calibration) -> dict[str, Any]:
    """All of a calibration as JSON-able values; angles none, lengths px."""
    camera = c.camera
    return {
        "kind": "camera calibration",
        "camera": camera.id,
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "pixel_origin": "centre of the first pixel",
        "parameters": {n: getattr(camera, n) for n in c.parameters},
        "sd": c.sd,
        "order": list(c.parameters),
        "covariance": c.covariance.tolist(),
        "correlation": np.round(c.correlation, 4).tolist(),
        "sigma0_px": c.sigma0,
        "redundancy": c.redundancy,
        "rms_px": dict(c.rms_px),
        "left_out": dict(c.left_out),
        "marks_left_out": c.marks_left_out,
        "coverage": c.coverage,
        "corner_sigma_px": [v if math.isfinite(v) else None for v in c.corner_sigma_px],
        "doubts": list(c.doubts),
    }
