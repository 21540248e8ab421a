"""Surface, profile, volume and error budget of a project, from its poses alone and adjusted."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from tool_cases import SAMPLE, Done, Site, copy_site, georef

pytestmark = pytest.mark.slow
STEPS = "read_photos,orient_direct,footprints"


@pytest.fixture(scope="module")
def tagged(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Three photos with the poses of their tags, over the DEM."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("tagged") / "site", 3)
    site.use_dem()
    done = site.run("--only", STEPS)
    assert done.code == 0, done.text
    return site


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Five adjusted photos, with control, over a ground of their own points."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("adjusted") / "site", 5)
    done = site.run("--only", f"{STEPS},match,adjust")
    assert done.code == 0, done.text
    return site


def summary(*words: object) -> dict:  # type: ignore[type-arg]
    done = georef(*words, "--json")
    assert done.code == 0, done.text
    lines = [line for line in done.text.splitlines() if line.startswith('{"event": "result"')]
    return dict(json.loads(lines[-1])["summary"])


def middle_of(site: Site) -> tuple[float, float]:
    """Centre of the adjusted points, CRS units."""
    with rasterio.open(site.products / "surface.tif") as ds:
        known = np.argwhere(ds.read_masks(1))
        row, col = np.median(known, axis=0)
        x, y = ds.xy(int(row), int(col))
    return float(x), float(y)


def square(x: float, y: float, half: float) -> list[str]:
    places = ((-half, -half), (half, -half), (half, half), (-half, half))
    return [word for dx, dy in places for word in ("--corner", f"{x + dx},{y + dy}")]


# -- error budget --------------------------------------------------------------------------------


def rows_of(site: Site) -> list[dict[str, str]]:
    with (site.products / "error_budget.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize("kind", ["tagged", "adjusted"])
def test_squares_of_the_budget_add_up_in_the_table(
    kind: str, request: pytest.FixtureRequest
) -> None:
    site: Site = request.getfixturevalue(kind)
    found = summary("error-budget", "--project", site.folder)
    rows = rows_of(site)
    assert len(rows) == 1 + found["places"]
    for row in rows:
        for axis in "hneu":
            names = [n for n in row if n.endswith(f"_{axis}_m") and not n.startswith("sigma_")]
            values = np.array([float(row[n]) for n in names])
            total = np.sum(np.sign(values) * values**2)
            whole = float(row[f"sigma_{axis}_m"])
            # of the square; four figures each
            assert total == pytest.approx(whole**2, rel=2e-3, abs=1e-8), (row["name"], axis)
    content = json.loads((site.products / "error_budget.json").read_text())
    assert content["fix_first"][0]["reduced_to"] <= content["fix_first"][-1]["reduced_to"]
    assert (site.products / "error_budget.png").read_bytes()[:4] == b"\x89PNG"


def test_sources_are_those_of_the_poses(tagged: Site, adjusted: Site) -> None:
    by_tags = summary("error-budget", "--project", tagged.folder)
    by_pixels = summary("error-budget", "--project", adjusted.folder)
    assert by_tags["pose_kind"] == "tags"
    assert "matching" not in by_tags["sources_h_m"]
    # the tags' angles and positions, and a boresight that is known to a degree
    assert {"gnss", "attitude", "boresight"} <= set(by_tags["sources_h_m"])
    assert by_pixels["pose_kind"] == "adjusted"
    assert by_pixels["sources_h_m"]["matching"] > 0.0
    assert by_pixels["sigma_h_m"] < 0.2 * by_tags["sigma_h_m"]


def test_budget_of_a_point_is_that_of_its_place(adjusted: Site) -> None:
    pixel = "IMG_0003.JPG:600,400"
    found = summary("error-budget", "--project", adjusted.folder, "--pixel", pixel)
    assert found["places"] == 1
    placed = summary("locate", "--project", adjusted.folder, "--pixel", pixel)["points"][0]
    row = rows_of(adjusted)[1]
    # one in enu, one along the grid: 0.6 deg apart
    assert float(row["sigma_u_m"]) == pytest.approx(placed["sigma_u_m"], rel=1e-2, abs=1e-3)
    both = np.hypot(placed["sigma_e_m"], placed["sigma_n_m"]) / np.sqrt(2)
    assert float(row["sigma_h_m"]) == pytest.approx(both, rel=1e-2, abs=1e-3)


# -- surface, profile, volume --------------------------------------------------------------------


def test_dem_is_the_surface_of_a_project_with_one(tagged: Site) -> None:
    found = summary("surface", "--project", tagged.folder)
    assert found["of"] == "DEM of the project"
    assert "points" not in found
    with rasterio.open(tagged.products / "surface.tif") as ds, \
            rasterio.open(tagged.folder / "dem.asc") as dem:  # fmt: skip
        ours = ds.read(1, masked=True)
        own = dem.read(1, masked=True)
        assert own.min() - 0.5 < ours.min() < ours.max() < own.max() + 0.5
        sigma = ds.read(2, masked=True)
        # nobody matched: the cells are the points
        read = laspy.read(tagged.products / "surface.las")
        assert read.header.point_count == found["cells"] == ours.count()
        values = np.array(list(ds.sample(read.xyz[:, :2])))
    # m; LAS in steps of 1 mm
    assert read.z == pytest.approx(values[:, 0], abs=6e-4)
    assert read.sigma_u == pytest.approx(values[:, 1], abs=1e-6)
    assert read.sigma_local == pytest.approx(values[:, 2], abs=1e-6)
    assert float(sigma.max()) > float(read.sigma_local.max())
    assert "ftUS" in read.header.parse_crs().name


def test_adjusted_points_lie_on_the_true_ground(adjusted: Site) -> None:
    """LAS and the raster of the points against the DEM that the site was made from."""
    found = summary("surface", "--project", adjusted.folder, "--of", "points", "--cell", "0.5m")
    read = laspy.read(adjusted.products / "points.las")
    assert found["points"] == read.header.point_count > 300
    with rasterio.open(adjusted.folder / "dem.asc") as dem:
        to_dem = Transformer.from_crs("EPSG:6601", dem.crs, always_xy=True)
        places = np.column_stack(to_dem.transform(read.x, read.y))
        values = np.array([one[0] for one in dem.sample(places)])
    off = read.z - values
    # m; control of 2 cm, pixels of 6 cm, a DEM of cells of 2 m
    assert abs(float(np.median(off))) < 0.3
    assert np.median(np.abs(off - np.median(off))) < 0.2
    assert 0.0 < float(np.median(read.sigma_u)) < 1.0
    with rasterio.open(adjusted.products / "surface.tif") as ds:
        raster = np.array([one[0] for one in ds.sample(read.xyz[:, :2])])
    known = raster > -9000
    # m; between the points that stayed the surface is flat
    assert np.median(np.abs(raster[known] - read.z[known])) < 0.05


def test_profile_and_volume_of_the_points(adjusted: Site) -> None:
    summary("surface", "--project", adjusted.folder, "--of", "points", "--cell", "1m")
    x, y = middle_of(adjusted)
    line = ["--corner", f"{x - 40},{y}", "--corner", f"{x + 40},{y}"]
    found = summary("profile", "--project", adjusted.folder, "--of", "points", *line)
    (profile,) = found["profiles"]
    # 80 US survey feet
    assert profile["length_m"] == pytest.approx(80 * 1200 / 3937, abs=0.01)
    with (adjusted.products / "profile.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == profile["stations"]
    assert (adjusted.products / "profile.png").read_bytes()[:4] == b"\x89PNG"
    beyond = ["--corner", f"{x},{y}", "--corner", f"{x + 4000},{y}"]
    far = summary("profile", "--project", adjusted.folder, "--of", "points", *beyond)
    assert "stations have no height" in far["doubts"][0]
    # a shift of all heights is in no rise
    rises = [float(row["sigma_rise_m"]) for row in rows if row["height_m"]]
    assert rises[0] == 0.0 < min(rises[1:])
    volume = summary("volume", "--project", adjusted.folder, *square(x, y, 25))["volumes"][0]
    assert volume["area_m2"] == pytest.approx((50 * 1200 / 3937) ** 2, rel=1e-3)
    # bare ground: nothing stands there but what the sigma says
    assert abs(volume["net_m3"]) < 5.0 * volume["sigma_net_m3"]
    assert volume["level_cancels"]


def test_a_surface_is_its_own_height_above_itself(adjusted: Site) -> None:
    """The raster that was written, as the base of the points that it was made from."""
    summary("surface", "--project", adjusted.folder, "--of", "points", "--cell", "0.25m")
    x, y = middle_of(adjusted)
    words = (*square(x, y, 20), "--base", "surface", "--base-raster",
             adjusted.products / "surface.tif", "--of", "points")  # fmt: skip
    volume = summary("volume", "--project", adjusted.folder, *words)["volumes"][0]
    # m: cells of a quarter of a metre between triangles
    assert abs(volume["mean_height_m"]) < 0.01
    assert not volume["level_cancels"]


@pytest.mark.parametrize(
    ("tool", "words", "line"),
    [
        ("profile", (), "a line by a file or by its corners"),
        ("volume", ("--corner", "1,1", "--corner", "2,2"), "3 or more"),
        ("volume", ("--area", "nix.gpkg"), "no such file"),
        ("surface", ("--of", "points"), "were not adjusted"),
        ("surface", ("--cell", "5km"), "longer than the site"),
        ("profile", ("--corner", "1,1", "--corner", "2,2", "--target", "p.png"), ".csv or .json"),
        ("error-budget", ("--assets",), "no asset"),
        ("error-budget", ("--photos", "nix.jpg"), "nix.jpg"),
    ],
    ids=["no line", "two corners", "no file", "no points", "long cells", "table as a picture",
         "no assets", "no photo"],
)  # fmt: skip
def test_slip_is_one_line(tool: str, words: tuple[str, ...], line: str, tagged: Site) -> None:
    done: Done = georef(tool, "--project", tagged.folder, *words)
    assert done.code == 2, done.text
    assert line in done.stderr
    assert done.stderr.count("\n") == 1


def test_base_without_its_height_is_asked_for(adjusted: Site) -> None:
    summary("surface", "--project", adjusted.folder, "--of", "points", "--cell", "1m")
    words = square(*middle_of(adjusted), 20)
    done = georef("volume", "--project", adjusted.folder, *words, "--base", "height")
    assert done.code == 2
    assert "--height" in done.stderr


def test_polygons_of_a_file_are_measured_one_by_one(adjusted: Site, tmp_path: Path) -> None:
    summary("surface", "--project", adjusted.folder, "--of", "points", "--cell", "1m")
    x, y = middle_of(adjusted)
    shapes = []
    for name, dx in (("heap A", -15.0), ("heap B", 15.0)):
        ring = [[x + dx + i, y + j] for i, j in ((-9, -9), (9, -9), (9, 9), (-9, 9), (-9, -9))]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        shapes.append({"type": "Feature", "properties": {"name": name}, "geometry": geometry})
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::6601"}}
    file = tmp_path / "heaps.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": shapes}))
    target = tmp_path / "volumes.csv"
    found = summary(
        "volume", "--project", adjusted.folder, "--area", file, "--target", target
    )  # fmt: skip
    assert [one["name"] for one in found["volumes"]] == ["heap A", "heap B"]
    with target.open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 2


def test_budget_of_places_that_are_none_says_why(tagged: Site) -> None:
    name = tagged.photos[0].name
    for pixel, said in (
        ("IMG_9999.JPG:600,400", "no photo with a pose is called 'IMG_9999.JPG'"),
        (f"{name}:99999,400", "lies outside"),
    ):
        done = georef("error-budget", "--project", tagged.folder, "--pixel", pixel)
        assert done.code == 2
        assert len(done.text.splitlines()) == 1
        done.line("no point has a place: 1: ", said)
    done = georef("error-budget", "--project", tagged.folder, "--photo", name)
    assert done.code == 2
    done.line("photo: is that of --pixel", "no pixel is given")
    done = georef("error-budget", "--project", tagged.folder, "--assets")
    assert done.code == 2
    done.line("no asset of the project was clicked", "georef assets --clicks")


def test_files_that_the_docs_name_are_in_the_sample_project() -> None:
    text = (SAMPLE.parent / "docs/error_budget.md").read_text("utf-8")
    calls = [line.partition("#")[0].split() for line in text.splitlines() if "   georef " in line]
    assert len(calls) == 4
    photos = [words[3].partition(":")[0] for words in calls if "--pixel" in words]
    marks = [words[3] for words in calls if "--marks" in words]
    assert photos
    assert marks
    assert all((SAMPLE / "photos" / name).is_file() for name in photos)
    assert all((SAMPLE / name).is_file() for name in marks)
