"""Control in the wrong CRS, swapped, in feet, of unstated heights; names of photos; traps."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS, Datum, HeightKind, MapFrame, Origin, parse_crs
from georef_gis.ingest.control_places import Placed, place_control, with_roles
from georef_gis.model.camera import Camera
from georef_gis.model.control import Control, ControlPoint, Mark
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain

LAT, LON = 39.10, -80.47
# m above the ellipsoid; the geoid lies some 32 m below it there
GROUND = 277.0
ORIGIN = Origin(lat=math.radians(LAT), lon=math.radians(LON), height_ellipsoidal=GROUND)
TERRAIN = FlatTerrain(origin=ORIGIN, height_ellipsoidal=GROUND, sigma=1.5)
FOOT = 1200 / 3937


def frame(gnss: str = "unknown") -> MapFrame:
    return MapFrame(ORIGIN, parse_crs("EPSG:32617"), gnss_datum=Datum.parse(gnss))


def photo(name: str, east: float = 0.0) -> OrientedPhoto:
    camera = Camera(id="c", width=600, height=400, fx=500.0, fy=500.0, cx=299.5, cy=199.5)
    pose = Pose(
        origin_enu=np.array([east, 0.0, 60.0]),
        R_enu_from_cam=np.diag([1.0, -1.0, -1.0]),
        covariance=np.eye(6) * 1e-2,
    )
    return OrientedPhoto(
        photo=Photo(id=name, path=Path(name), width=600, height=400), camera=camera, pose=pose
    )


PHOTOS = {name: photo(name, east) for name, east in (("A.JPG", 0.0), ("b.jpg", 20.0))}


def utm(zone: int = 17) -> np.ndarray:
    """Three points at the photos, by PROJ alone."""
    t = Transformer.from_crs("EPSG:4326", f"EPSG:{32600 + zone}", always_xy=True)
    return np.array([t.transform(LON + d, LAT) for d in (0.0, 1e-4, -1e-4)])


def control(
    xy: np.ndarray, crs: str = "EPSG:32617", height: float | None = 309.0, **more: object
) -> Control:
    points = tuple(
        ControlPoint(
            name=f"P{i}", easting=float(x), northing=float(y), height=height,
            source=f"gcp.txt, line {i + 2}",
        )
        for i, (x, y) in enumerate(xy)
    )  # fmt: skip
    values = {
        "datum": Datum(), "height_kind": HeightKind.ORTHOMETRIC, "geoid": "egm96", "points": points,
    }  # fmt: skip
    return Control(crs=CRS.from_user_input(crs), **(values | more))  # type: ignore[arg-type]


def placed(c: Control, **more: object) -> Placed:
    return place_control(c, frame(), TERRAIN, PHOTOS, **more)  # type: ignore[arg-type]


def line_about(found: Placed, word: str) -> str:
    (line,) = [line for line in found.doubts if f"{word}:" in line or f": {word}" in line]
    return line


def test_points_at_the_photos_are_where_proj_puts_them() -> None:
    found = placed(control(utm()))
    east = found.observations.p_enu[:, 0]
    # 1e-4 deg of longitude at 39.1 deg on the ellipsoid: 8.650 m
    assert np.allclose(east, [0.0, 8.650, -8.650], atol=2e-3)
    # orthometric 309 m less some 33 m of EGM96
    assert np.all(np.abs(found.observations.p_enu[:, 2]) < 3.0)
    assert found.observations.role == ("control",) * 3


@pytest.mark.parametrize(
    ("xy", "crs", "words"),
    [
        (utm()[:, ::-1], "EPSG:32617", "exchanged they lie at the photos"),
        (utm() / FOOT, "EPSG:32617", "in US survey feet they lie at the photos"),
        (utm(), "EPSG:32618", "in EPSG:32617 they lie at the photos: correct the CRS"),
        (utm(), "EPSG:32717", "in EPSG:32617 they lie at the photos: correct the CRS"),
        (np.array([[LON, LAT]] * 2), "EPSG:32617", "in EPSG:4326 they lie at the photos"),
        (np.array([[LAT, LON]] * 2), "EPSG:4326", "exchanged they lie at the photos"),
        (np.array([[-LON, LAT]] * 2), "EPSG:4326", "west is negative"),
        (utm(), "EPSG:4326", "the project's CRS"),
        (np.array([[12.0, 34.0]] * 2), "EPSG:32617", "check the numbers and the CRS"),
    ],
    ids=["swapped", "feet", "zone", "south", "degrees", "lat-lon", "west", "metres", "nonsense"],
)  # fmt: skip
def test_control_that_is_elsewhere_is_told_once_with_its_cure_and_not_used(
    xy: np.ndarray, crs: str, words: str
) -> None:
    found = placed(control(xy, crs))
    line = line_about(found, "easting, northing")
    assert words in line
    assert line.startswith("gcp.txt, line 2")
    assert all(point.role == "off" for point in found.points)
    assert found.observations.names == ()


def test_one_far_point_leaves_the_others() -> None:
    xy = utm()
    xy[1] = xy[1, ::-1]
    found = placed(control(xy))
    assert found.observations.names == ("P0", "P2")
    assert "1 points (P1)" in line_about(found, "easting, northing")


def test_a_table_without_a_header_may_have_either_order() -> None:
    found = placed(control(utm()[:, ::-1], order_open=True))
    assert np.allclose(found.observations.p_enu[:, 0], [0.0, 8.650, -8.650], atol=2e-3)


# -- heights -----------------------------------------------------------------------------------


def heights(**more: object) -> tuple[np.ndarray, list[str]]:
    value = more.pop("height", 309.0)
    found = placed(control(utm(), height=value, **more))  # type: ignore[arg-type]
    lines = [line for line in found.doubts if ": height:" in line]
    return np.where(found.observations.has_height, found.observations.p_enu[:, 2], np.nan), lines


def test_feet_where_metres_are_expected_are_taken_as_feet_and_told() -> None:
    z, (line,) = heights(height=309.0 / 0.3048, height_unit=None)
    assert np.all(np.abs(z) < 3.0)
    assert "taken as feet; state [control] height_unit" in line


def test_feet_that_are_stated_as_metres_are_not_used() -> None:
    z, (line,) = heights(height=309.0 / 0.3048, height_unit=1.0)
    assert np.all(np.isnan(z))
    assert "they fit in feet, but metres are stated" in line


@pytest.mark.parametrize(("height", "kind"), [(309.0, "orthometric"), (277.0, "ellipsoidal")])
def test_the_ground_tells_the_kind_of_heights(height: float, kind: str) -> None:
    z, (line,) = heights(height=height, height_kind=HeightKind.UNKNOWN)
    assert np.all(np.abs(z) < 3.0)
    assert f"taken as {kind}" in line


def test_a_kind_that_nothing_tells_is_not_guessed() -> None:
    vague = replace(TERRAIN, sigma=17.0)
    found = place_control(control(utm(), height_kind=HeightKind.UNKNOWN), frame(), vague, PHOTOS)
    assert not found.observations.has_height.any()
    assert any("state [control] height_kind" in line for line in found.doubts)


def test_a_point_without_height_is_used_horizontally() -> None:
    found = placed(control(utm(), height=None))
    assert np.all(np.isinf(found.observations.sigma[:, 2]))
    assert np.all(found.observations.sigma[:, :2] == 0.02)
    # at the height of the ground, for want of its own
    assert np.allclose(found.observations.p_enu[:, 2], 0.0, atol=0.01)


# -- datum -------------------------------------------------------------------------------------


def test_an_unstated_datum_is_two_metres_of_common_shift_and_told() -> None:
    found = placed(control(utm()))
    assert np.array_equal(found.observations.sigma_shared, [2.0, 2.0, 0.0])
    assert "[control] datum and [gnss] datum not stated" in line_about(found, "datum")


def test_unequal_realisations_are_transformed_with_their_epoch() -> None:
    c = control(utm(), datum=Datum.parse("NAD83(2011)@2010.0"))
    same = place_control(c, frame("NAD83(2011)@2010.0"), TERRAIN, PHOTOS)
    other = place_control(c, frame("ITRF2020@2026.4"), TERRAIN, PHOTOS)
    assert same.datum_known
    assert other.datum_known
    d = other.observations.p_enu - same.observations.p_enu
    # ITRF and NAD83(2011) differ by over a metre in the eastern United States.
    assert np.all((np.linalg.norm(d, axis=1) > 0.8) & (np.linalg.norm(d, axis=1) < 2.5))


def test_unequal_realisations_without_an_epoch_are_refused_with_the_cure() -> None:
    c = control(utm(), datum=Datum.parse("NAD83(2011)@2010.0"))
    with pytest.raises(InputError, match="state the epoch"):
        place_control(c, frame("ITRF2020"), TERRAIN, PHOTOS)


# -- marks and roles ---------------------------------------------------------------------------


def with_marks(*marks: tuple[str, str, float, float]) -> Placed:
    listed = tuple(
        Mark(name=n, photo=p, u=u, v=v, source=f"marks.csv, line {i + 2}")
        for i, (n, p, u, v) in enumerate(marks)
    )
    return placed(control(utm(), marks=listed))


def test_an_adjustment_is_not_surer_of_matched_marks_for_their_number() -> None:
    """It takes marks as independent: the click that two of them share counts in each twice."""
    matched = {"u": 5.0, "v": 5.0, "sigma_px": 0.3, "shared_px": 0.5}
    marks = (
        Mark(name="P0", photo="A.JPG", **matched),
        Mark(name="P0", photo="b.jpg", **matched),
        Mark(name="P1", photo="A.JPG", u=9.0, v=9.0),
    )  # fmt: skip
    found = placed(control(utm(), marks=marks)).observations
    both = math.hypot(0.3, 0.5 * math.sqrt(2.0))
    np.testing.assert_allclose(found.sigma_px, [both, both, 0.5])


@pytest.mark.parametrize("written", ["A.JPG", "a.jpg", "A", "a.tif", "flight 1/A.JPG", "x\\A.JPG"])
def test_a_photo_is_found_whatever_folder_case_and_ending(written: str) -> None:
    assert with_marks(("P0", written, 1.0, 2.0)).observations.photo_ids == ("A.JPG",)


def test_marks_of_unknown_photos_are_told_in_one_line() -> None:
    found = with_marks(("P0", "X.JPG", 1, 2), ("P1", "X.JPG", 1, 2), ("P0", "Y.JPG", 1, 2))
    line = line_about(found, "photo")
    assert "3 marks are in 2 photos that have no pose in the project (X.JPG, Y.JPG)" in line


@pytest.mark.parametrize(
    ("u", "v", "cure"),
    [
        (700.0, 10.0, "correct the pixel"),
        (10.0, 500.0, "write u (right) before v (down)"),
        (10.0, -20.0, "turn its sign"),
    ],
)
def test_a_mark_outside_of_the_image_is_told_with_its_cure(u: float, v: float, cure: str) -> None:
    found = with_marks(("P0", "A.JPG", u, v), ("P1", "A.JPG", 5.0, 5.0))
    (line,) = [line for line in found.doubts if line.startswith("marks.csv, line 2")]
    assert f"{u:g}, {v:g} px lies outside of A.JPG (600 x 400 px)" in line
    assert line.endswith(cure)
    assert found.observations.point.tolist() == [1]


def test_the_same_point_twice_in_a_photo_is_told_and_both_are_candidates() -> None:
    found = with_marks(("P0", "A.JPG", 5, 5), ("P0", "a.jpg", 90, 5), ("P0", "A.JPG", 5, 5))
    (line,) = [line for line in found.doubts if "twice" in line]
    assert "point P0 is marked in a.jpg twice, at 5, 5 px (line 2) and at 90, 5 px" in line
    assert len(found.observations.point) == 2


def test_roles_of_the_settings_win_and_strange_names_are_told() -> None:
    c = with_roles(control(utm()), control_names=(), check=("P1",), off=("P2", "Q9"))
    assert [q.role for q in c.points] == ["control", "check", "off"]
    assert "no point is called Q9" in c.doubts[0]
    with pytest.raises(InputError, match="stands in two of control, check and off"):
        with_roles(control(utm()), control_names=(), check=("P1",), off=("P1",))
