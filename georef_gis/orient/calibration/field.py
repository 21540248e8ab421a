"""Camera from photos of targets.

A board is a field whose targets are regular; an indoor or outdoor field has surveyed ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from georef_gis.model.camera import Camera
from georef_gis.orient.calibration.bundle import (
    BROWN,
    FISHEYE,
    BundleFit,
    Targets,
    View,
    adjust,
    start,
)
from georef_gis.orient.calibration.judgement import Calibration, judged
from georef_gis.orient.calibration.usable import (
    check_views,
    cleaned,
    enough,
    without_bad_starts,
)

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
    views, left_out = enough(targets, views)
    check_views(targets, views, left_out)
    first = _first_camera(camera_id, size, settings)
    state = start(size, targets, views, first)
    state, views, left_out, dropped = without_bad_starts(state, targets, views, left_out)
    fit, views, more, lost = cleaned(state, targets, views, settings.parameters)
    fit, views, unit = _reweighted(fit, targets, views, settings)
    return judged(
        fit, targets, views,
        left_out={**left_out, **more}, marks_left_out=dropped + lost, unit=unit,
    )  # fmt: skip


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


def _reweighted(
    fit: BundleFit, targets: Targets, views: list[View], settings: CalibrationSettings
) -> tuple[BundleFit, list[View], float | None]:
    """Bundle whose marks have the sigma that their residuals show, and that sigma, px.

    The weak priors, and the targets' sigmas, then have their due weight. Where the sigmas are
    stated, the bundle as it is, and None.
    """
    if settings.sigma_px is not None:
        return fit, views, None
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
