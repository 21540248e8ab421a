"""What a project knows of its photos' errors, by source: from tags, trajectory or adjustment."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from georef_gis.measure.budget.adjusted import MATCHING, BlockSplit, split
from georef_gis.measure.budget.parts import ChainSplit, PairSplit, SourcedErrors, TagSplit
from georef_gis.project.columns_file import read_columns
from processing_algorithms.measure.budget_block import (
    FlightNoise,
    known_of_block,
    navigation_noise,
    tag_noise,
)
from processing_algorithms.site import Site, load_site

if TYPE_CHECKING:
    from georef_gis.model.joint_errors import JointErrors
    from georef_gis.model.photo_stack import Ints
    from georef_gis.orient.adjustment.block import Block
    from georef_gis.orient.adjustment.flight_model import FlightModel
    from georef_gis.project import Project

# of the variance: the matches can take none away
_AGREES = 0.02
# words of the report for the parts of a pose that were weighed down
_COMPONENTS = ("east", "north", "height", "angle about east", "angle about north", "heading")


def error_sources(
    project: Project, site: Site, errors: JointErrors, notes: list[str]
) -> SourcedErrors:
    """Errors of a project's photos by source.

    Parameters
    ----------
    errors
        Of the scene that is measured in.
    notes
        Takes lines on what could not be taken apart.
    """
    from processing_algorithms.orient.direct import project_mount

    photos = errors.stack.photos
    path = project.navigation / "exposures.npz"
    exposures = read_columns(path, "exposures") if path.exists() else None
    names = [site.pose_kinds[photo.id] for photo in photos]
    kinds = np.full(len(photos), -1, dtype=np.int64)
    splits: list[PairSplit] = []
    if "navigation" in names and exposures is not None:
        known = {str(key) for key in exposures["ids"]}
        mine = [n == "navigation" and p.id in known for n, p in zip(names, photos, strict=True)]
        kinds[np.array(mine)] = len(splits)
        splits.append(ChainSplit.of(exposures, errors))
    if "tags" in names:
        kinds[np.array([name == "tags" for name in names])] = len(splits)
        splits.append(
            TagSplit.of(
                errors, project_mount(project), sigma_datum=site.frame.datum_sigma,
                turned_deg=_turned(project, site),
            )
        )  # fmt: skip
    adjusted = None
    if "adjusted" in names:
        adjusted = _adjusted(project, errors, exposures, notes)
    return SourcedErrors(errors=errors, kinds=kinds, splits=tuple(splits), adjusted=adjusted)


def _turned(project: Project, site: Site) -> dict[str, int]:
    """Degrees clockwise by which the pixels of each photo were turned after the exposure."""
    out = dict.fromkeys(site.photos, 0)
    for row in project.database.rows("pose"):
        if site.pose_kinds.get(row["photo_id"]) == row["kind"]:
            out[row["photo_id"]] = int((row["extra"] or {}).get("turned_deg", 0))
    return out


# -- adjustment --------------------------------------------------------------------------------


def _adjusted(
    project: Project, errors: JointErrors, exposures: Mapping[str, Any] | None, notes: list[str]
) -> BlockSplit | None:
    """Groups of the kept adjustment; None, and why, where it was not kept whole."""
    from georef_gis.errors import GeorefError

    path = project.adjustment / "covariance.npz"
    if not path.exists():
        notes.append("the block is too large for its joint covariance: its poses are one source")
        return None
    kept = read_columns(path, "joint covariance")
    try:
        direct = load_site(project, direct=True)
        block, flights = _block_as_known(project, direct)
    except (GeorefError, OSError, ValueError) as error:
        notes.append(f"what the adjustment was made of cannot be read again ({error})")
        return None
    ids = tuple(str(key) for key in kept["photo_ids"])
    names = tuple(str(name) for name in kept["shared_names"])
    if ids != block.photo_ids or names != tuple(block.shared_names):
        notes.append(
            "photos, flights or the program changed after the adjustment: its poses are one source "
            "until `georef run --from adjust`"
        )
        return None
    covariance = kept["covariance"]
    noises = [_noise_of(flight, direct, exposures) for flight in flights]
    parts = split(
        covariance, known_of_block(block, flights, noises, covariance), n_photos=len(ids),
        with_level=bool(int(kept["with_level"])),
    )  # fmt: skip
    if np.any(np.diag(parts[MATCHING]) < -_AGREES * np.diag(covariance)):
        notes.append(
            "the adjustment trusted the camera or the headings less than is stated: its poses are "
            "one source"
        )
        return None
    return BlockSplit(by_source=parts, rows=_rows_of(project, errors, ids, names))


def _rows_of(
    project: Project, errors: JointErrors, ids: Sequence[str], names: Sequence[str]
) -> Ints:
    """Row of each unknown of the scene in the kept covariance, -1 where it has none."""
    from georef_gis.model.pixel_derivatives import CAMERA_NAMES

    number = {key: i for i, key in enumerate(ids)}
    shared = {name: 6 * len(ids) + i for i, name in enumerate(names)}
    before = {
        row["camera_id"]: (row["extra"] or {}).get("adjusted_of")
        for row in project.database.rows("camera")
    }
    out = []
    for photo in errors.stack.photos:
        adjusted = photo.pose.kind == "adjusted" and photo.id in number
        out += [6 * number[photo.id] + i if adjusted else -1 for i in range(6)]
    for camera in errors.cameras.ids:
        out += [shared.get(f"{before.get(camera)} {name}", -1) for name in CAMERA_NAMES]
    return np.array([*out, -1], dtype=np.int64)


def _block_as_known(project: Project, site: Site) -> tuple[Block, list[FlightModel]]:
    """The block and its flights' priors as the adjustment had them before any pixel."""
    from georef_gis.orient.adjustment.problem import Problem
    from georef_gis.toolbox import CollectingFeedback
    from processing_algorithms.orient.blocks import prepare
    from processing_algorithms.orient.control_input import project_control

    control = project_control(project, site, CollectingFeedback())
    prepared = prepare(project, site, calibrate=True, control=control)
    problem = Problem(prepared.block, prepared.first)
    report = json.loads((project.adjustment / "report.json").read_text(encoding="utf-8"))
    number = {key: i for i, key in enumerate(prepared.block.photo_ids)}
    for doubted in report["weighed_down"]:
        if doubted["photo"] in number:
            component = _COMPONENTS.index(doubted["what"])
            _weigh_down(problem.flights, number[doubted["photo"]], component, doubted["sigmas"])
    return prepared.block, list(problem.flights)


def _weigh_down(flights: Sequence[FlightModel], photo: int, component: int, sigmas: float) -> None:
    """Trust a part of a photo's navigation as little as the adjustment did."""
    for flight in flights:
        at = np.flatnonzero(flight.prior.photos == photo)
        if not len(at):
            continue
        own = np.linalg.inv(flight.own_blocks()[at[0]])
        flight.extra[at[0], component] += sigmas**2 * own[component, component]
        flight.renew()


def _noise_of(
    flight: FlightModel, direct: Site, exposures: Mapping[str, Any] | None
) -> FlightNoise:
    """Noise of a flight's navigation by source: of a trajectory, or of tags."""
    prior = flight.prior
    if (
        exposures is not None
        and prior.times is not None
        and np.array_equal(prior.times, exposures["time"])
    ):
        return navigation_noise(flight)
    ids = list(direct.photos)
    level = [direct.photos[ids[i]].pose.covariance[[0, 1], [0, 1]] for i in prior.photos]
    share = min(direct.frame.datum_sigma**2 / float(np.mean(level)), 1.0)
    return tag_noise(flight, datum_share=share)
