"""Lines to fly: by hand, over areas of any shape, and what they cannot tell."""

from __future__ import annotations

import math
from importlib import resources

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree

from georef_gis.ellipsoid import Origin
from georef_gis.errors import GeometryError, InputError
from georef_gis.measure.preflight.kml import KML, flight_kml
from georef_gis.measure.preflight.layout import (
    Layout,
    Plan,
    PlannedLine,
    at_height,
    crossing,
    headings_of,
    layout_of,
    plan_area,
    plan_corridor,
)
from georef_gis.measure.preflight.observable import Leg, observable
from georef_gis.model.camera import Camera

# The 2012 paper's camera and its overlaps
CAMERA = Camera(
    id="5D", width=5616, height=3744, fx=20.6478 / 36 * 5616, fy=20.6478 / 36 * 5616, cx=2807.5,
    cy=1871.5,
)  # fmt: skip
ORIGIN = Origin(lat=math.radians(39.1), lon=math.radians(-80.47), height_ellipsoidal=0.0)
BOX = np.array([[0.0, 0.0], [800.0, 0.0], [800.0, 500.0], [0.0, 500.0]])


def layout(**changes: float) -> Layout:
    values = {"height": 120.0, "speed": 15.0, "overlap": 0.8, "sidelap": 0.4} | changes
    return layout_of(
        CAMERA, values["height"], values["speed"], overlap=values["overlap"],
        sidelap=values["sidelap"],
    )  # fmt: skip


def footprints(lines: tuple[PlannedLine, ...], of: Layout) -> list[shapely.Polygon]:
    out = []
    for line in lines:
        for place, heading in zip(line.photos, line.headings, strict=True):
            ahead = np.array([math.sin(heading), math.cos(heading)])
            right = np.array([ahead[1], -ahead[0]])
            corners = [
                place + 0.5 * (i * of.along * ahead + j * of.across * right)
                for i, j in ((1, 1), (1, -1), (-1, -1), (-1, 1))
            ]
            out.append(shapely.Polygon(corners))
    return out


# -- by hand -------------------------------------------------------------------------------------


def test_layout_of_the_2012_paper() -> None:
    """300 m, 36 x 24 mm, 20.65 mm, 80/40 %, 120 km/h."""
    found = layout(height=300.0, speed=120 / 3.6)
    assert found.across == pytest.approx(300 * 36 / 20.6478)
    assert found.along == pytest.approx(300 * 24 / 20.6478)
    assert found.gsd == pytest.approx(found.across / 5616)
    assert found.base == pytest.approx(0.2 * found.along)
    assert found.spacing == pytest.approx(0.6 * found.across)
    assert found.interval == pytest.approx(found.base / (120 / 3.6))
    # 33.3 m/s for 1 ms is 3.3 cm; 30 deg/s for 1 ms is 0.5 mrad
    assert found.blur(0.001) == pytest.approx(0.0333333 / found.gsd, rel=1e-5)
    turned = found.blur(0.001, rate=math.radians(30), focal=CAMERA.fx) - found.blur(0.001)
    assert turned == pytest.approx(math.radians(0.03) * CAMERA.fx)


def test_high_ground_eats_the_overlap() -> None:
    """At half the height a footprint is half as long: 80 % become 60 %, 40 % become -20 %."""
    over, side = layout().overlaps_over(60.0)
    assert (over, side) == (pytest.approx(0.6), pytest.approx(-0.2))
    with pytest.raises(GeometryError, match="reaches the flying height"):
        layout().overlaps_over(120.0)


def test_portrait_camera_turns_the_footprint() -> None:
    lying = layout_of(CAMERA, 120.0, 15.0, overlap=0.8, sidelap=0.4, across="height")
    assert (lying.across, lying.along) == (layout().along, layout().across)


def test_number_of_lines_and_photos_over_a_box() -> None:
    """Across 500 m with lines 125.5 m apart that see 209.2 m: 1 + ceil((500+41.8-209.2)/125.5)."""
    found = plan_area(BOX, layout())
    assert len(found) == 4
    # 800 m and a base of 27.9 m before and after, no further apart than a base
    assert len(found[0].photos) == math.ceil((800 + 2 * 27.897) / 27.897) + 1
    # along the longer side, there and back
    assert np.degrees(headings_of(found)) == pytest.approx([90.0, 270.0, 90.0, 270.0])
    steps = np.hypot(*np.diff(found[0].photos, axis=0).T)
    assert steps.max() <= layout().base + 1e-9
    assert Plan(lines=found, layouts=(layout(),)).photos == sum(len(line.photos) for line in found)


def test_narrow_area_takes_one_line() -> None:
    (line,) = plan_area([[0, 0], [300, 0], [300, 60], [0, 60]], layout())
    assert line.photos[:, 1] == pytest.approx(np.full(len(line.photos), 30.0))
    assert line.photos[0, 0] < 0.0
    assert line.photos[-1, 0] > 300.0


def test_corridor_follows_its_line() -> None:
    road = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 500.0]])
    (middle,) = plan_corridor(road, 60.0, layout())
    # but for one photo before and one after
    assert (
        shapely.distance(shapely.LineString(road), shapely.points(middle.photos[1:-1])).max() < 1e-6
    )
    assert np.degrees(middle.headings[0]) == pytest.approx(90.0)
    assert np.degrees(middle.headings[-1]) == pytest.approx(0.0, abs=1e-6)
    assert middle.photos[0] == pytest.approx([-27.4, 0.0], abs=1.0)
    wide = plan_corridor(road, 300.0, layout())
    assert len(wide) == 3
    off = [
        shapely.distance(shapely.LineString(road), shapely.points(line.photos[1:-1]))
        for line in wide
    ]
    assert [float(np.median(d)) for d in off] == pytest.approx([125.5, 0.0, 125.5], abs=0.1)


def test_line_across_lies_at_a_right_angle() -> None:
    high = at_height(layout(), 160.0)
    line = crossing(BOX, high, math.radians(90.0), first=5)
    assert line.height == 160.0
    assert np.degrees(line.headings[0]) == pytest.approx(180.0)
    assert line.photos[:, 0] == pytest.approx(np.full(len(line.photos), 400.0))


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"height": 0.0}, "height"), ({"speed": -3.0}, "speed"), ({"overlap": 1.0}, "overlap"),
     ({"sidelap": -0.1}, "sidelap")],
)  # fmt: skip
def test_impossible_layout_is_refused(changes: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        layout(**changes)


def test_impossible_areas_are_refused() -> None:
    with pytest.raises(InputError, match="three corners"):
        plan_area([[0, 0], [1, 1]], layout())
    with pytest.raises(InputError, match="crosses itself"):
        plan_area([[0, 0], [100, 100], [100, 0], [0, 100]], layout())
    with pytest.raises(InputError, match="photos; check the units"):
        plan_area(BOX * 1000.0, layout())
    with pytest.raises(InputError, match="some length"):
        plan_corridor([[5, 5], [5, 5]], 60.0, layout())


# -- of any shape --------------------------------------------------------------------------------

corner = st.tuples(st.integers(-300, 300), st.integers(-300, 300))


@given(
    corners=st.lists(corner, min_size=4, max_size=8),
    heading=st.none() | st.floats(0.0, 6.28),
    height=st.floats(80.0, 150.0),
)
@settings(max_examples=25)
def test_every_place_of_an_area_is_in_three_photos_and_more(
    corners: list[tuple[int, int]], heading: float | None, height: float
) -> None:
    hull = shapely.convex_hull(shapely.MultiPoint(corners))
    if hull.geom_type != "Polygon" or hull.area < 3000.0:
        return
    of = layout(height=height)
    ring = shapely.get_coordinates(hull.exterior)[:-1]
    prints = np.array(footprints(plan_area(ring, of, heading=heading), of))
    middle = shapely.get_coordinates(hull.centroid)
    for place in np.vstack([ring * 0.999 + 0.001 * middle, middle]):
        assert np.count_nonzero(shapely.covers(prints, shapely.Point(place))) >= 3


# -- what cannot be told -------------------------------------------------------------------------


def leg(course: float, height: float, speed: float) -> Leg:
    return Leg.still(math.radians(course), height, speed)


@pytest.mark.parametrize(
    ("legs", "rank"),
    [
        ([leg(0, 70, 15)], 4),
        ([leg(0, 70, 15), leg(180, 70, 15)], 6),
        ([leg(0, 70, 15), leg(90, 70, 15)], 6),
        ([leg(0, 70, 12), leg(180, 70, 18)], 6),
        ([leg(0, 70, 12), leg(180, 70, 18), leg(90, 70, 15)], 7),
        ([leg(0, 70, 15), leg(180, 70, 15), leg(90, 110, 15), leg(270, 110, 15)], 8),
        ([leg(0, 70, 12), leg(180, 70, 18), leg(90, 110, 15), leg(270, 110, 15)], 9),
    ],
    ids=["one line", "opposite", "crossed", "opposite, two speeds", "crossed, two speeds",
         "crossed, two heights", "crossed, two heights, two speeds"],
)  # fmt: skip
def test_what_flights_tell_of_nine_unknowns(legs: list[Leg], rank: int) -> None:
    assert observable(legs).rank == rank


def test_what_stays_mixed_is_named() -> None:
    one_height = observable([leg(0, 70, 15), leg(90, 70, 15)])
    assert one_height.mixed == (
        ("lever arm forward", "boresight pitch", "time offset"),
        ("lever arm right", "boresight roll"),
    )
    across = [leg(90, 110, 15), leg(270, 110, 15)]
    two_heights = observable([leg(0, 70, 15), leg(180, 70, 15), *across])
    assert two_heights.told() == ["lever arm forward and time offset cannot be told apart"]
    assert observable([leg(0, 70, 12), leg(180, 70, 18), *across]).told() == []


def test_a_steady_wind_tells_no_time_offset() -> None:
    """The ground speed is the air's along the heading, and the wind, which is like a bias."""

    def blown(course: float, height: float) -> Leg:
        a = math.radians(course)
        velocity = (15 * math.sin(a) + 2.0, 15 * math.cos(a) - 3.0)
        return Leg(heading=a, height=height, velocity_en=velocity)

    found = observable([blown(0, 70), blown(180, 70), blown(90, 110), blown(270, 110)])
    assert found.rank == 8
    assert "time offset" in found.mixed[0]


# -- KML -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def schema() -> etree.XMLSchema:
    folder = resources.files("fastkml") / "schema"
    return etree.XMLSchema(etree.parse(str(folder / "kml22gx.xsd")))


@pytest.mark.parametrize("ring", [BOX, None], ids=["area", "road"])
def test_kml_is_valid_and_puts_photos_where_they_are_planned(
    ring: np.ndarray | None, schema: etree.XMLSchema
) -> None:
    lines = plan_area(BOX, layout())
    data = flight_kml(lines, ORIGIN, name="a <plan> & more", description="120 m\a", area=ring)
    root = etree.fromstring(data)
    assert schema.validate(root), schema.error_log
    texts = root.findall(f".//{{{KML}}}LineString/{{{KML}}}coordinates")
    assert len(texts) == len(lines)
    for line, text in zip(lines, texts, strict=True):
        read = np.array([[float(v) for v in one.split(",")] for one in text.text.split()])
        geo = np.column_stack([np.radians(read[:, 1]), np.radians(read[:, 0]), np.zeros(len(read))])
        # m; nine decimals of a degree are 0.1 mm
        assert ORIGIN.enu_from_geo(geo)[:, :2] == pytest.approx(line.photos, abs=2e-3)
        assert read[:, 2] == pytest.approx(np.full(len(read), 120.0))
    photos = root.findall(f".//{{{KML}}}Point")
    assert len(photos) == sum(len(line.photos) for line in lines)
    assert len(root.findall(f".//{{{KML}}}Polygon")) == int(ring is not None)
