"""What the measurements of a project share, from what its runs kept: poses, cameras, level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.joint_errors import CameraErrors, JointErrors, PoseSource
from georef_gis.model.photo_stack import Ints, PhotoStack
from georef_gis.model.pixel_derivatives import CAMERA_NAMES, CAMERA_UNKNOWNS
from georef_gis.model.pose_errors import (
    ALIKE_HEIGHTS,
    AlikeErrors,
    ChainErrors,
    TagErrors,
    TagFlights,
)
from georef_gis.model.trajectory import StateChain
from georef_gis.project.band_covariance import (
    BandCovariance,
    SomeErrors,
    load_band_covariance,
)
from georef_gis.project.columns_file import columns_of
from georef_gis.project.joint_covariance import KeptCovariance, load_joint_covariance
from georef_gis.project.project import Project
from georef_gis.project.records import camera_of

Kept = KeptCovariance | BandCovariance
# kinds of sources, in words for people
ADJUSTED, ALIKE = "adjustment", "adjustment, correlations by a stated law"
TRAJECTORY, TAGS = "trajectory", "tags, correlations by a stated law"


def load_errors(
    project: Project,
    stack: PhotoStack,
    kinds: Mapping[str, str],
    *,
    height: float,
    sigma_datum: float = 0.0,
) -> JointErrors:
    """Errors of poses and cameras of a project, and how they hang together.

    Parameters
    ----------
    kinds
        Photo id -> kind of its pose: tags, navigation or adjusted.
    height : m
        Usual height above ground.
    sigma_datum : m
        Of the positions, in poses by tags: the same for all.

    Raises
    ------
    InputError
        If a file that a run left is broken.
    """
    groups = _by_kind(stack, kinds)
    sources: list[PoseSource] = []
    adjusted, kept = _adjusted(project, stack, groups.get("adjusted", []), height)
    sources += adjusted
    flown, left = _flown(project, stack, groups.get("navigation", []))
    sources += flown
    tagged = sorted([*left, *groups.get("tags", [])])
    sources += _tagged(stack, tagged, kinds, sigma_datum)
    return JointErrors(stack, sources, _cameras(project, stack, kept))


def _by_kind(stack: PhotoStack, kinds: Mapping[str, str]) -> dict[str, list[int]]:
    out: dict[str, list[int]] = {}
    for k, photo in enumerate(stack.photos):
        out.setdefault(kinds[photo.id], []).append(k)
    return out


def _adjusted(
    project: Project, stack: PhotoStack, photos: Sequence[int], height: float
) -> tuple[list[PoseSource], Kept | None]:
    """Source of the adjusted photos; the covariance only where it speaks of all of them."""
    if not photos:
        return [], None
    at = np.array(photos, dtype=np.int64)
    ids = [stack.photos[k].id for k in photos]
    kept: Kept | None = load_joint_covariance(project.adjustment / "covariance.npz")
    kept = kept or load_band_covariance(project.adjustment / "covariance_band.npz")
    if kept is None or not set(ids) <= set(kept.photo_ids):
        alike = AlikeErrors.of(stack, at, length=ALIKE_HEIGHTS * height)
        return [PoseSource(photos=at, errors=alike, kind=ALIKE)], None
    return [PoseSource(photos=at, errors=kept.pose_errors(ids), kind=ADJUSTED)], kept


def _flown(
    project: Project, stack: PhotoStack, photos: Sequence[int]
) -> tuple[list[PoseSource], list[int]]:
    """Source of the photos whose poses come from a trajectory, and photos that it does not know."""
    path = project.navigation / "exposures.npz"
    if not photos or not path.exists():
        return [], list(photos)
    with columns_of(path, "exposures") as read:
        ids = [str(key) for key in read["ids"]]
        wanted = {stack.photos[k].id: k for k in photos}
        known = [(i, wanted[key]) for i, key in enumerate(ids) if key in wanted]
        if not known:
            return [], list(photos)
        errors = ChainErrors(
            StateChain(time=read["time"], covariance=read["covariance"], gain=read["gain"]),
            read["to_pose"], read["mount"], read["mount_covariance"], read["own"],
        )  # fmt: skip
    # the chain counts all its exposures, of which the stack may have lost some
    places, at = (np.array(part, dtype=np.int64) for part in zip(*known, strict=True))
    some = SomeErrors(errors=errors, places=places)
    source = PoseSource(photos=at, errors=some, kind=TRAJECTORY)
    return [source], [k for k in photos if k not in set(at.tolist())]


def _tagged(
    stack: PhotoStack, photos: Sequence[int], kinds: Mapping[str, str], sigma_datum: float
) -> list[PoseSource]:
    """Source of the photos by tags: flights of a camera have only the datum in common."""
    flights: dict[tuple[str, str, str], list[int]] = {}
    for k in photos:
        photo = stack.photos[k].photo
        flights.setdefault((photo.flight_id, photo.camera_id, kinds[photo.id]), []).append(k)
    parts = [np.array(mine, dtype=np.int64) for mine in flights.values()]
    errors = [TagErrors(stack, at, sigma_datum=sigma_datum) for at in parts]
    if sigma_datum > 0.0 and len(parts) > 1:
        return [PoseSource(photos=np.concatenate(parts), errors=TagFlights(errors), kind=TAGS)]
    return [
        PoseSource(photos=at, errors=one, kind=TAGS) for at, one in zip(parts, errors, strict=True)
    ]


# -- cameras ----------------------------------------------------------------------------------


def _cameras(project: Project, stack: PhotoStack, kept: Kept | None) -> CameraErrors:
    """Joint errors of the cameras, as the adjustment left them, else as they are stated."""
    rows = {row["camera_id"]: row for row in project.database.rows("camera")}
    sensors: dict[str, Camera] = {key: camera_of(row) for key, row in rows.items()}
    stated = CameraErrors.stated(stack, sensors)
    covariance = stated.covariance.copy()
    across = np.zeros((len(stack), 6, len(covariance)))
    at: dict[str, slice] = {}
    in_kept: dict[str, Ints] = {}
    for c, key in enumerate(stated.ids):
        at[key] = slice(CAMERA_UNKNOWNS * c, CAMERA_UNKNOWNS * (c + 1))
        row = rows.get(key, {})
        before = (row.get("extra") or {}).get("adjusted_of")
        found = None if kept is None or not before else kept.shared_rows(before, CAMERA_NAMES)
        if found is not None:
            in_kept[key] = found
        elif row.get("covariance"):
            covariance[at[key], at[key]] = _of_row(row)
    if kept is None or not in_kept:
        return CameraErrors(
            ids=stated.ids, covariance=covariance, sensor_of=stated.sensor_of, turns=stated.turns
        )
    number = {photo.id: k for k, photo in enumerate(stack.photos)}
    adjusted = [key for key in kept.photo_ids if key in number and _is_adjusted(stack, number[key])]
    where = np.array([number[key] for key in adjusted], dtype=np.int64)
    for key, found in in_kept.items():
        for other, its in in_kept.items():
            covariance[at[key], at[other]] = kept.between(found, its)
        across[where, :, at[key]] = kept.with_shared(adjusted, found)
    return CameraErrors(
        ids=stated.ids, covariance=covariance, sensor_of=stated.sensor_of, turns=stated.turns,
        with_poses=across,
    )  # fmt: skip


def _is_adjusted(stack: PhotoStack, k: int) -> bool:
    return stack.photos[k].pose.kind == "adjusted"


def _of_row(row: Mapping[str, Any]) -> Array:
    """Covariance of a camera's unknowns as its row has it; shape (11, 11)."""
    return np.asarray(row["covariance"], dtype=np.float64)
