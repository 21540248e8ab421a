"""Tool `check`: is the flight good enough to go home?"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame
    from georef_gis.model.camera import Camera
    from georef_gis.model.layers import Footprint
    from georef_gis.model.photo import Photo
    from georef_gis.orient.heights import Heights

# px; more motion than this during the exposure is seen
MOTION_LIMIT = 1.5


class CheckParameters(p.Parameters):
    """Parameters of `check`."""

    folder: p.Folder = p.folder(title="Folder of the photos", positional=True)
    height: p.Length | None = p.length(
        None, title="Height above ground where the tags have none", unit="m", ge=1, le=20000
    )
    target: p.File = p.file(
        Path("fly_again.kml"), title="KML of what to fly again", suffixes=(".kml",), writes=True
    )


class Check(Algorithm[CheckParameters]):
    """Check a flight in the field: holes in the coverage, blur, doubtful tags.

    Reads the tags, lays the footprints on flat ground, looks for places that no photo shows, for
    photos that are less sharp than the others or moved during the exposure, and writes a KML of
    what to fly again.
    """

    id, name, group = "check", "Check a flight", "ingest"
    needs_project = False
    outputs = (Output(name="kml", title="What to fly again"),)

    def run(self, context: Context, parameters: CheckParameters, feedback: Feedback) -> Result:
        """Check it."""
        from georef_gis.ingest.photos import find_photos, read_photos
        from processing_algorithms.ingest.outliers import without_strays

        paths = find_photos(parameters.folder)
        result = read_photos(paths, workers=context.workers)
        photos, strays = without_strays(result.photos)
        doubts = [*(str(error) for _, error in result.refused), *strays]
        doubts += [*result.doubts, *(d for photo in photos for d in photo.doubts)]
        soft = _unsharp(photos, context.workers, feedback)
        doubts += list(soft.values())
        frame, prints, more = _footprints(result, photos, parameters.height)
        doubts += more
        rings: list[Array] = []
        summary: dict[str, Any] = {
            "photos": len(photos),
            "refused": len(result.refused) + len(result.photos) - len(photos),
        }
        if frame is not None and prints:
            rings, figures = _coverage(frame, prints)
            summary |= figures
            moved = _motion(photos, prints)
            doubts += moved
        for doubt in doubts:
            feedback.warn(doubt)
        _write_kml(parameters.target, frame, rings, [f for f in prints if f.photo_id in soft])
        summary |= {
            "holes": len(rings),
            "blurred": len(soft),
            "doubts": doubts,
            "verdict": _verdict(checked=bool(prints), again=bool(rings or soft)),
            "products": [str(parameters.target)],
        }
        return Result(outputs={"kml": parameters.target}, summary=summary)


def _verdict(*, checked: bool, again: bool) -> str:
    """What the crew is to do; a coverage that could not be checked is never good."""
    if again:
        return "fly again what the KML shows"
    return "nothing to fly again" if checked else "the coverage was not checked: see the doubts"


def _unsharp(photos: list[Photo], workers: int, feedback: Feedback) -> dict[str, str]:
    """Doubts of photos that are less sharp than the others of their camera, by photo."""
    import numpy as np

    from georef_gis.errors import InputError
    from georef_gis.ingest.sharpness import blurred, sharpness

    def one(photo: Photo) -> float:
        try:
            return sharpness(photo.path, photo.width)
        except InputError:
            return float("nan")

    values: dict[str, float] = {}
    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        for i, (photo, value) in enumerate(zip(photos, pool.map(one, photos), strict=True)):
            values[photo.id] = value
            feedback.progress(0.9 * i / len(photos), f"{i} of {len(photos)} photos")
            check_cancelled(feedback)
    out = {k: f"{k}: cannot be decoded: fly it again" for k, v in values.items() if np.isnan(v)}
    for camera in {photo.camera_id for photo in photos}:
        keys = [q.id for q in photos if q.camera_id == camera and q.id not in out]
        array = np.array([values[key] for key in keys])
        for i in blurred(array):
            ratio = array[i] / np.median(array)
            out[keys[i]] = f"{keys[i]}: blurred: {ratio:.0%} of the others' fine detail"
    return out


def _footprints(
    result: Any, photos: list[Photo], height: float | None
) -> tuple[MapFrame | None, list[Footprint], list[str]]:
    """Footprints on flat ground from the tags, and what is doubtful about the poses."""
    from georef_gis.errors import GeorefError
    from georef_gis.geodesy import MapFrame, Origin, utm_crs
    from georef_gis.orient.heights import GroundSetting, solve_heights
    from processing_algorithms.site import middle_of

    placed = [photo for photo in photos if photo.geotag is not None]
    tags = [photo.geotag for photo in placed if photo.geotag is not None]
    if not tags:
        return None, [], ["no photo has a GPS position: the coverage cannot be checked"]
    lat, lon = middle_of(tags)
    origin = Origin(lat=lat, lon=lon, height_ellipsoidal=0.0)
    frame = MapFrame(origin, utm_crs(origin.lat, origin.lon))
    try:
        heights = solve_heights(placed, origin, GroundSetting(height_above_ground=height))
    except GeorefError:
        why = "the tags state no height above ground: give --height to check the coverage"
        return frame, [], [why]
    prints, doubts = _prints(placed, result.cameras, frame, heights)
    return frame, prints, doubts


def _prints(
    photos: Sequence[Photo], cameras: Mapping[str, Camera], frame: MapFrame, heights: Heights
) -> tuple[list[Footprint], list[str]]:
    """Footprints of photos whose heights are known, and what is doubtful about their poses."""
    from georef_gis.errors import GeorefError
    from georef_gis.model.photo import OrientedPhoto
    from georef_gis.model.pose import Mount
    from georef_gis.orient.direct import DirectSettings, direct_poses
    from georef_gis.rectify.footprints import footprint

    doubts: list[str] = []
    prints: list[Footprint] = []
    poses = direct_poses(
        photos,
        frame.origin,
        heights,
        Mount(),
        DirectSettings(),
        convergence_at=frame.convergence_at,
    )
    for photo, pose in zip(photos, poses, strict=True):
        doubts += [f"{photo.id}: {doubt}" for doubt in pose.doubts]
        if pose.pose is None:
            doubts.append(str(pose.refused))
            continue
        oriented = OrientedPhoto(photo=photo, camera=cameras[photo.camera_id], pose=pose.pose)
        try:
            prints.append(footprint(oriented, heights.terrain, frame))
        except GeorefError as error:
            doubts.append(str(error))
    return prints, doubts


def _coverage(frame: MapFrame, prints: list[Footprint]) -> tuple[list[Array], dict[str, Any]]:
    import numpy as np

    from georef_gis.rectify.coverage import covered_area, footprint_side, holes, overlap_map

    grid, counts = overlap_map(prints, frame)
    seen = counts[counts > 0]
    figures = {
        "gsd_m": float(np.median([f.gsd for f in prints])),
        "covered_m2": covered_area(grid, counts, frame),
        "seen_in_two_or_more": f"{np.mean(seen >= 2):.0%}",
    }
    side = footprint_side(prints, grid, frame)
    return holes(grid, counts, footprint_cells=side), figures


def _motion(photos: list[Photo], prints: list[Footprint]) -> list[str]:
    """Photos that moved too far during their exposure, by speed and shutter of the tags."""
    from georef_gis.ingest.tags import number

    gsd = {f.photo_id: f.gsd for f in prints}
    out = []
    for photo in photos:
        exposure = number(photo.tags, "EXIF:ExposureTime")
        if photo.ground_speed is None or exposure is None or photo.id not in gsd:
            continue
        moved = photo.ground_speed * exposure / gsd[photo.id]
        if moved > MOTION_LIMIT:
            out.append(
                f"{photo.id}: moved {moved:.1f} px in {exposure * 1000:.1f} ms at "
                f"{photo.ground_speed:.0f} m/s: use a shorter exposure"
            )
    return out


def _write_kml(
    target: Path, frame: MapFrame | None, rings: list[Array], soft: list[Footprint]
) -> None:
    """Polygons of the holes and of the blurred photos; whole or not at all."""
    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    ElementTree.SubElement(document, "name").text = "Fly again"
    for i, ring in enumerate(rings, start=1):
        if frame is not None:
            _polygon(document, f"hole {i}", frame, ring)
    for one in soft:
        if frame is not None:
            _polygon(document, f"{one.photo_id} (blurred)", frame, one.ring_map)
    with export_errors(target, lambda: 0):
        target.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(resolve_target(target)) as stream:
            ElementTree.ElementTree(root).write(stream, encoding="utf-8", xml_declaration=True)


def _polygon(document: ElementTree.Element, name: str, frame: MapFrame, ring_map: Array) -> None:
    import numpy as np

    geo = frame.geo_from_map(np.c_[ring_map, np.zeros(len(ring_map))])
    place = ElementTree.SubElement(document, "Placemark")
    ElementTree.SubElement(place, "name").text = name
    polygon = ElementTree.SubElement(place, "Polygon")
    ElementTree.SubElement(polygon, "tessellate").text = "1"
    outer = ElementTree.SubElement(polygon, "outerBoundaryIs")
    line = ElementTree.SubElement(outer, "LinearRing")
    ElementTree.SubElement(line, "coordinates").text = " ".join(
        f"{np.degrees(lon):.9f},{np.degrees(lat):.9f},0" for lat, lon, _ in geo
    )
