"""COLMAP's text model: pycolmap reads ours, we read pycolmap's."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from interchange_cases import CAMERAS, make_block_site, points_before, tie_points, with_blanks

from exports.poses.colmap import write_colmap
from georef_gis.errors import ExportError, InputError
from georef_gis.ingest.poses import read_poses
from georef_gis.ingest.poses_blocks import read_blocks
from georef_gis.model.camera import Camera
from georef_gis.model.interchange.colmap import (
    block_from_colmap,
    camera_from_colmap,
    camera_to_colmap,
)

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is the oracle; it is not installed")


def theirs(camera: Camera):
    model, parameters = camera_to_colmap(camera)
    return pycolmap.Camera(
        model=model, width=camera.width, height=camera.height, params=list(parameters)
    )


@pytest.mark.parametrize("name", CAMERAS)
def test_their_camera_gives_our_pixels_and_half_a_pixel(name: str) -> None:
    camera = CAMERAS[name]
    points = points_before(camera)
    uv = camera.project(points)
    found = np.array([theirs(camera).img_from_cam(p) for p in points])
    # px; rounding of the last place, and the half pixel of the corner
    assert found == pytest.approx(uv + 0.5, abs=1e-6)
    model, parameters = camera_to_colmap(camera)
    size = (camera.width, camera.height)
    back = camera_from_colmap("x", model, size, parameters, "test")
    assert back.project(points) == pytest.approx(uv, abs=1e-9)


def test_the_simplest_model_is_taken() -> None:
    models = {name: camera_to_colmap(camera)[0] for name, camera in CAMERAS.items()}
    assert models == {
        "ideal": "SIMPLE_PINHOLE", "two focal lengths": "PINHOLE", "b1": "PINHOLE",
        "one coefficient": "SIMPLE_RADIAL", "two coefficients": "RADIAL", "tangential": "OPENCV",
        "k3": "FULL_OPENCV", "tall": "FULL_OPENCV", "fisheye": "OPENCV_FISHEYE",
        "plain fisheye": "RADIAL_FISHEYE",
    }  # fmt: skip


def test_every_model_of_theirs_is_read_or_refused_by_name() -> None:
    rng = np.random.default_rng(2)
    read, refused = [], []
    for name in pycolmap.CameraModelId.__members__:
        if name == "INVALID":
            continue
        try:
            other = pycolmap.Camera.create_from_model_name(1, name, 500.0, 640, 480)
        except ValueError:
            continue
        params = np.array(other.params)
        extra = list(other.extra_params_idxs())
        params[extra] = rng.uniform(-0.02, 0.02, len(extra))
        if name == "FULL_OPENCV":
            params[-3:] = 0.0
        other.params = params
        try:
            ours = camera_from_colmap("1", name, (640, 480), params, "test")
        except InputError as error:
            refused.append((name, str(error)))
            continue
        read.append(name)
        points = points_before(CAMERAS["ideal"], 20) * [0.5, 0.5, 1.0]
        found = np.array([other.img_from_cam(p) for p in points])
        assert ours.project(points) == pytest.approx(found - 0.5, abs=1e-6), name
    assert {"SIMPLE_PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "RADIAL"} <= set(read)
    assert {"FOV", "THIN_PRISM_FISHEYE"} <= {name for name, _ in refused}
    assert all(f"'{name}' is not known" in words for name, words in refused)


def test_what_colmap_cannot_hold_is_refused_or_told(tmp_path: Path) -> None:
    skewed = replace(CAMERAS["k3"], b2=0.5)
    with pytest.raises(InputError, match=r"b2 = 0.5 px moves pixels by up to 0.17 px"):
        camera_to_colmap(skewed)
    hardly = replace(CAMERAS["k3"], b2=0.01, readout_s=0.02)
    camera_to_colmap(hardly)
    report = write_colmap(make_block_site(camera=hardly), tmp_path / "c")
    assert "b2 = 0.01 px is left out" in report.warnings[0]
    assert "readout of 20.0 ms is left out" in report.warnings[1]
    with pytest.raises(InputError, match="no model like 'brown_inverse'"):
        camera_to_colmap(replace(CAMERAS["k3"], model="brown_inverse"))
    with pytest.raises(InputError, match="denominator"):
        camera_from_colmap("1", "FULL_OPENCV", (9, 9), [1, 1, 1, 1, *[0] * 5, 0.1, 0, 0], "t")


@pytest.mark.parametrize("place", ["Ohio in feet", "Fiji across 180", "Chile"])
def test_pycolmap_projects_our_points_where_we_do(tmp_path: Path, place: str) -> None:
    site = make_block_site(place)
    ties, ground = tie_points(site)
    rng = np.random.default_rng(5)
    ties = replace(ties, uv=ties.uv + rng.normal(0.0, 0.6, ties.uv.shape))
    report = write_colmap(site, tmp_path, ties=ties, points=ground)
    assert (report.height_kind, report.features) == ("ellipsoidal", 6)
    found = pycolmap.Reconstruction()
    found.read_text(str(tmp_path))
    assert found.num_reg_images() == 6
    assert found.num_points3D() == ground.p_enu.shape[0]
    for one in site.photos:
        image = found.find_image_with_name(one.photo.path.name)
        # m; the quaternion is of 16 digits and the places are up to 2 km off
        assert image.projection_center() == pytest.approx(one.pose.origin_enu, abs=1e-9)
        R = image.cam_from_world().rotation.matrix()
        assert R.T == pytest.approx(one.pose.R_enu_from_cam, abs=1e-12)
    checked = 0
    for key, point in found.points3D.items():
        assert point.xyz == pytest.approx(ground.p_enu[key - 1], abs=1e-9)
        errors = []
        for element in point.track.elements:
            image = found.images[element.image_id]
            pixel = image.points2D[element.point2D_idx]
            assert pixel.point3D_id == key
            errors.append(np.linalg.norm(image.project_point(point.xyz) - pixel.xy))
            # px; the pixels were moved by exactly this
            assert 0.0 < errors[-1] < 4.0
            checked += 1
        # the file has six digits
        assert point.error == pytest.approx(np.mean(errors), rel=1e-5)
    assert checked == len(ties.photo)


def test_the_model_reads_back_with_frame_and_covariances(tmp_path: Path) -> None:
    site = make_block_site()
    ties, ground = tie_points(site)
    write_colmap(site, tmp_path, ties=ties, points=ground)
    (block,) = read_blocks(tmp_path / "images.txt", "colmap", points=True)
    assert block.origin is not None
    assert block.origin.lat == pytest.approx(site.frame.origin.lat, abs=1e-15)
    assert block.height_kind == "ellipsoidal"
    for shot, one in zip(block.shots, site.photos, strict=True):
        wanted = one.pose.covariance.copy()
        wanted[2, 2] += one.pose.sigma_height_shared**2
        assert shot.covariance == pytest.approx(wanted, rel=1e-12, abs=1e-15)
    assert block.points is not None
    assert block.points.ties is not None
    assert block.points.p == pytest.approx(ground.p_enu, abs=1e-12)
    assert block.points.ties.uv == pytest.approx(ties.uv, abs=1e-6)
    assert np.array_equal(block.points.ties.photo, ties.photo)


def test_we_read_what_pycolmap_writes(tmp_path: Path) -> None:
    site = make_block_site()
    ties, ground = tie_points(site)
    write_colmap(site, tmp_path / "ours", ties=ties, points=ground)
    model = pycolmap.Reconstruction()
    model.read_text(str(tmp_path / "ours"))
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    model.write_text(str(theirs))
    (block,) = read_blocks(theirs, "colmap", points=True)
    assert block.origin is None
    by_name = {shot.name: shot for shot in block.shots}
    for one in site.photos:
        shot = by_name[one.photo.path.name]
        assert shot.origin == pytest.approx(one.pose.origin_enu, abs=1e-9)
        assert shot.R_world_from_cam == pytest.approx(one.pose.R_enu_from_cam, abs=1e-12)
        camera = block.cameras[shot.camera_id]
        points = points_before(site.cameras[0])
        assert camera.project(points) == pytest.approx(site.cameras[0].project(points), abs=1e-9)
    with pytest.raises(InputError, match="has no place on the Earth; give photos"):
        read_poses(theirs, format="colmap")
    # With our frame beside it, it has its place.
    frame = json.loads((tmp_path / "ours" / "georef_frame.json").read_text())
    (theirs / "georef_frame.json").write_text(json.dumps(frame))
    assert len(read_poses(theirs / "images.txt")) == 6


def test_two_photos_of_one_name_keep_their_folders(tmp_path: Path) -> None:
    site = make_block_site(n=2)
    photos = tuple(
        replace(one, photo=replace(one.photo, path=Path(f"/survey/{i}/IMG1.JPG")))
        for i, one in enumerate(site.photos)
    )
    write_colmap(replace(site, photos=photos), tmp_path)
    (block,) = read_blocks(tmp_path, "colmap")
    assert [shot.name for shot in block.shots] == ["0/IMG1.JPG", "1/IMG1.JPG"]


def test_turned_pixels_get_a_camera_of_their_own(tmp_path: Path) -> None:
    site = make_block_site(n=2)
    photos = (site.photos[0], replace(site.photos[1], turned_deg=90))
    write_colmap(replace(site, photos=photos), tmp_path)
    (block,) = read_blocks(tmp_path, "colmap")
    sizes = [(c.width, c.height) for c in block.cameras.values()]
    assert sizes == [(640, 480), (480, 640)]


def test_a_site_without_pose_or_camera_is_refused(tmp_path: Path) -> None:
    site = make_block_site()
    with pytest.raises(ExportError, match="no photo has a pose"):
        write_colmap(replace(site, photos=tuple(replace(p, pose=None) for p in site.photos)),
                     tmp_path)  # fmt: skip
    with pytest.raises(ExportError, match="camera 'k3' is not known"):
        write_colmap(replace(site, cameras=()), tmp_path)


def test_names_with_blanks_are_refused_as_colmap_cuts_them(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"names with blanks such as .* \(1 photos\); rename"):
        write_colmap(with_blanks(make_block_site()), tmp_path)
    lines = ["1 1 0 0 0 0 0 0 1 a b.jpg", ""]
    block = block_from_colmap(["1 PINHOLE 9 9 1 1 1 1"], lines, None, "model")
    assert block.shots[0].name == "a b.jpg"


HEAD = "1 1 0 0 0 0 0 0 1 a.jpg"


@pytest.mark.parametrize(
    ("cameras", "images", "points", "words"),
    [
        ("1 PINHOLE 9 9 1 1 1", HEAD, None, "PINHOLE has 4 parameters, not 3"),
        ("1 FOV 9 9 1 1 1 1 1", HEAD, None, "'FOV' is not known"),
        ("1 PINHOLE 9 9 1 1 x 1", HEAD, None, r"cameras.txt, line 1: .*not a number"),
        ("1 PINHOLE 9 9 -1 1 1 1", HEAD, None, "is no camera"),
        ("2 PINHOLE 9 9 1 1 1 1", HEAD, None, "camera 1 is not in cameras.txt"),
        ("1 PINHOLE 9 9 1 1 1 1", "1 0 0 0 0 0 0 0 1 a.jpg", None, "quaternion is zero"),
        ("1 PINHOLE 9 9 1 1 1 1", f"{HEAD}\n{HEAD}", None, r"line 2: .*two lines"),
        ("1 PINHOLE 9 9 1 1 1 1", "1 1 0 0", None, "ten values are needed"),
        ("1 PINHOLE 9 9 1 1 1 1", "# none", None, "has no images"),
        ("1 PINHOLE 9 9 1 1 1 1", f"{HEAD}\n", "7 0 0 0 1 1 1 0 1 0", "pixel 0 of image 1"),
    ],
)
def test_bad_models_name_file_line_and_value(cameras, images, points, words) -> None:
    with pytest.raises(InputError, match=words):
        block_from_colmap(
            cameras.splitlines(), images.splitlines(),
            None if points is None else points.splitlines(), "model",
        )  # fmt: skip


def test_references_are_what_the_aligner_of_colmap_takes(tmp_path: Path) -> None:
    site = make_block_site()
    write_colmap(site, tmp_path)
    rows = [line.split() for line in (tmp_path / "ref_images.txt").read_text().splitlines()]
    geo = site.frame.origin.geo_from_enu(np.array([one.pose.origin_enu for one in site.photos]))
    for row, (lat, lon, h) in zip(rows, geo, strict=True):
        assert float(row[1]) == pytest.approx(math.degrees(lat), abs=1e-9)
        assert float(row[2]) == pytest.approx(math.degrees(lon), abs=1e-9)
        assert float(row[3]) == pytest.approx(h, abs=1e-4)
    found = pycolmap.Reconstruction()
    found.read_text(str(tmp_path))
    names = [row[0] for row in rows]
    enu = np.array([one.pose.origin_enu for one in site.photos])
    options = pycolmap.RANSACOptions(max_error=0.5)
    sim = pycolmap.align_reconstruction_to_locations(found, names, enu, 3, options)
    assert sim is not None
    assert sim.scale == pytest.approx(1.0, abs=1e-9)
