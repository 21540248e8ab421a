"""Priors of a project's flights: the trajectory's where there is one, else the tags'."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from georef_gis.model.photo import OrientedPhoto
from georef_gis.orient.adjustment.block import FlightPrior
from georef_gis.orient.adjustment.build import SensorViews
from georef_gis.orient.adjustment.priors import (
    SIGMA_EVENT_CLOCK,
    MountPrior,
    navigation_prior,
    tag_prior,
    times_of,
)
from georef_gis.project import Project
from georef_gis.project.columns_file import read_columns
from processing_algorithms.site import Site

# s; photos further apart are of two flights
PAUSE = 1800.0


def flight_priors(project: Project, site: Site, views: SensorViews) -> tuple[FlightPrior, ...]:
    """Priors by flight: the trajectory's joint covariance where there is one, else the tags'."""
    joint = _exposures(project)
    mount = project.settings.mount
    stated = mount.model_fields_set
    known = MountPrior(
        sigma_lever=mount.sigma_lever_arm_m if "sigma_lever_arm_m" in stated else 0.1,
        sigma_boresight=math.radians(mount.sigma_boresight_deg)
        if "sigma_boresight_deg" in stated
        else None,
    )
    names = [view.photo.flight_id for view in views.photos]
    kinds = list(site.pose_kinds.values())
    ids = list(site.photos)
    out: list[FlightPrior] = []
    left = set(range(len(ids)))
    if joint is not None:
        inside = [ids.index(str(key)) for key in joint["ids"] if str(key) in site.photos]
        inside = [i for i in inside if kinds[i] == "navigation"]
        if len(inside) == len(joint["ids"]):
            photos = [views.photos[i] for i in inside]
            clock = _sigma_clock(photos)
            out.append(
                navigation_prior("flight", photos, np.array(inside), joint, sigma_clock=clock)
            )
            left -= set(inside)
    for kind in ("navigation", "tags"):
        for name in dict.fromkeys(names):
            mine = [i for i in sorted(left) if names[i] == name and kinds[i] == kind]
            label = name if kind == "tags" else f"{name} navigation"
            for number, part in enumerate(_flown_together(mine, views), start=1):
                photos = [views.photos[i] for i in part]
                title = label if number == 1 else f"{label} {number}"
                out.append(tag_prior(title, photos, np.array(part), known))
    return tuple(out)


def _flown_together(indices: Sequence[int], views: SensorViews) -> list[list[int]]:
    """Photos by flight: another camera, or a long pause, has errors of its own."""
    groups: list[list[int]] = []
    for camera in dict.fromkeys(int(views.camera_of[i]) for i in indices):
        mine = [i for i in indices if views.camera_of[i] == camera]
        times = times_of([views.photos[i].photo for i in mine])
        order = np.argsort(times, kind="stable")
        cuts = np.flatnonzero(np.diff(times[order]) > PAUSE) + 1
        groups += [[mine[k] for k in part] for part in np.split(order, cuts)]
    return [sorted(group) for group in groups if group]


def _sigma_clock(photos: Sequence[OrientedPhoto]) -> float:
    """One sigma, s, of the part of the exposure times that all photos of a flight share.

    Times by events are a lag of the shutter apart from them; those by the camera's clock share the
    error of its offset, which is nearly all of their sigma.
    """
    by_clock = [p.photo.time_sigma for p in photos if p.photo.time_source == "clock"]
    known = [sigma for sigma in by_clock if sigma is not None]
    if 2 * len(by_clock) <= len(photos) or not known:
        return SIGMA_EVENT_CLOCK
    return max(SIGMA_EVENT_CLOCK, float(np.median(known)))


def _exposures(project: Project) -> dict[str, Any] | None:
    path = project.navigation / "exposures.npz"
    return read_columns(path, "exposures") if path.exists() else None
