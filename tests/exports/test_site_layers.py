"""Attributes of the layers against numbers worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from site_cases import NASTY, ORIGIN, make_site

from exports.site.build import split_at_gaps
from exports.site.site import SiteLayers, SitePhoto
from georef_gis.errors import ExportError
from georef_gis.frames import R_map_from_photo, exp_so3
from georef_gis.geodesy import geoid_undulation
from georef_gis.model.photo import Geotag, Photo
from georef_gis.model.pose import Pose


def values(site: SiteLayers, layer: str, index: int = 0) -> dict:
    return dict(site.layers[layer].features[index].values)


def test_photo_above_the_origin_stands_there(site):
    v = values(site, "photos")
    assert v["lat_deg"] == pytest.approx(40.0, abs=1e-9)
    assert v["lon_deg"] == pytest.approx(-83.0, abs=1e-9)
    assert v["height_ellipsoidal_m"] == pytest.approx(300.0, abs=1e-6)
    n = float(geoid_undulation(ORIGIN.lat, ORIGIN.lon))
    assert -40 < n < -25  # m: EGM96 in Ohio
    assert v["height_orthometric_m"] == pytest.approx(300.0 - n, abs=1e-6)
    assert v["height_above_ground_m"] == 100.0


def test_time_is_utc_with_leap_seconds_taken_off(site):
    assert values(site, "photos", 1)["time_utc"] == "2026-05-01T12:00:02.000Z"


def test_time_keeps_the_microseconds_that_a_sync_board_counts(site):
    first = replace(site.photos[0].photo, time_gps=2.000_123)
    exact = replace(site, photos=(replace(site.photos[0], photo=first), *site.photos[1:]))
    assert values(exact, "photos")["time_utc"] == "2026-05-01T12:00:02.000123Z"
    assert values(exact, "track")["start_utc"] == "2026-05-01T12:00:02.000Z"


def test_nadir_photo_to_the_north_has_no_angles_but_convergence(site):
    v = values(site, "photos")
    assert [v["roll_deg"], v["pitch_deg"], v["tilt_deg"]] == pytest.approx([0, 0, 0], abs=1e-9)
    assert v["yaw_deg"] % 360.0 == pytest.approx(0.0, abs=1e-9)
    # UTM 17: (lon - 81 W) sin(lat), to the first order
    convergence = -2.0 * math.sin(math.radians(40.0))
    assert [v["omega_deg"], v["phi_deg"]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert v["kappa_deg"] == pytest.approx(convergence, abs=2e-3)


def test_yaw_turns_kappa_the_other_way(site):
    # 30 deg clockwise seen from above, and image top nosed up by 5 deg
    R = exp_so3([0.0, 0.0, math.radians(-30.0)]) @ exp_so3([math.radians(5.0), 0.0, 0.0])
    pose = site.photos[0].pose
    turned = replace(pose, R_enu_from_cam=R @ pose.R_enu_from_cam)
    other = replace(site, photos=(replace(site.photos[0], pose=turned),))
    v, before = values(other, "photos"), values(site, "photos")
    assert [v["yaw_deg"], v["pitch_deg"], v["roll_deg"]] == pytest.approx([30, 5, 0], abs=1e-6)
    assert v["kappa_deg"] - before["kappa_deg"] == pytest.approx(-30.0, abs=0.2)
    opk = np.radians([v["omega_deg"], v["phi_deg"], v["kappa_deg"]])
    view = -R_map_from_photo(*opk)[:, 2]
    assert math.degrees(math.acos(-view[2])) == pytest.approx(5.0, abs=1e-6)
    assert v["tilt_deg"] == pytest.approx(5.0, abs=1e-6)


def test_ellipse_of_a_correlated_position(site):
    v = values(site, "photos")
    assert [v["sigma_e_m"], v["sigma_n_m"], v["sigma_u_m"]] == pytest.approx([1, 2, 3])
    assert v["corr_en"] == pytest.approx(0.5)
    # eigenvalues of [[1, 1], [1, 4]]: (5 +- sqrt(13)) / 2; the axis leans from north to east
    assert v["sigma_major_m"] ** 2 == pytest.approx((5 + math.sqrt(13)) / 2)
    assert v["sigma_minor_m"] ** 2 == pytest.approx((5 - math.sqrt(13)) / 2)
    expected = math.degrees(math.atan2(1.0, (5 + math.sqrt(13)) / 2 - 1.0))
    assert v["sigma_azimuth_deg"] == pytest.approx(expected)


def test_sigmas_of_angles_at_nadir(site):
    v = values(site, "photos")
    # About east: pitch and omega; about north: roll and phi; about up: yaw and kappa.
    for name, sigma in (("pitch", 1), ("roll", 1), ("yaw", 2), ("omega", 1), ("kappa", 2)):
        assert v[f"sigma_{name}_deg"] == pytest.approx(sigma, abs=1e-6), name


def test_footprint_keeps_its_figures_and_runs_counter_clockwise(site):
    v = values(site, "footprints")
    assert (v["gsd_m"], v["area_m2"], v["clipped"]) == (0.05, 768.0, False)
    xy = site.layers["footprints"].features[0].xy_map
    x, y = xy.T
    area = 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])
    # scale of UTM 2 degrees off the central meridian: 0.9996 + 0.0003
    assert area == pytest.approx(768.0, rel=2e-3)


def test_track_is_as_long_as_the_flight(site):
    v = values(site, "track")
    assert (v["photos"], v["duration_s"], v["part"]) == (3, 4.0, 1)
    assert v["length_m"] == pytest.approx(40.0)
    assert (v["first_photo"], v["last_photo"]) == ("p1.jpg", "missing.jpg")


def test_track_is_split_at_a_gap():
    stamps = [(float(t), t) for t in (0, 2, 4, 6, 60, 62)]
    assert [[i for _, i in part] for part in split_at_gaps(stamps)] == [[0, 2, 4, 6], [60, 62]]
    slow = [(30.0 * t, t) for t in range(5)]
    assert len(split_at_gaps(slow)) == 1


def test_photo_without_pose_keeps_its_tagged_place(site, tmp_path):
    tag = Geotag(lat=ORIGIN.lat, lon=ORIGIN.lon)
    photos = (
        SitePhoto(photo=Photo(id="tagged", path=tmp_path / "t.jpg", width=4, height=3, geotag=tag)),
        SitePhoto(photo=Photo(id="lost", path=tmp_path / "l.jpg", width=4, height=3)),
    )
    other = replace(site, photos=photos, footprints=())
    features = other.layers["photos"].features
    assert [f.values["photo"] for f in features] == ["tagged"]
    assert features[0].values["yaw_deg"] is None
    assert features[0].values["height_ellipsoidal_m"] is None
    assert other.unplaced == ("lost",)


def test_gimbal_lock_leaves_sigmas_open(site):
    # Image top up: pitch 90 deg in the convention that is zero at nadir
    R = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    pose = Pose(origin_enu=np.zeros(3), R_enu_from_cam=R, covariance=np.eye(6))
    v = values(replace(site, photos=(replace(site.photos[0], pose=pose),)), "photos")
    assert v["pitch_deg"] == pytest.approx(90.0, abs=1e-5)
    assert v["sigma_yaw_deg"] is None


def test_unknown_layer_is_refused_by_name(site):
    with pytest.raises(ExportError, match=r"'mosaic'.*footprints"):
        site.layer("mosaic")


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:6549"])
def test_metadata_state_crs_and_unit(tmp_path, crs):
    facts = make_site(tmp_path, crs=crs).metadata()
    assert facts["crs"] == crs
    assert facts["crs_unit"] == {"EPSG:32617": "metre", "EPSG:6549": "US survey foot"}[crs]
    assert "EGM96" in facts["heights"]
    assert NASTY not in facts["photos_without_place"]


def test_height_has_its_kind_in_words_and_the_sigma_of_the_level_too(site):
    pose = replace(
        site.photos[0].pose, sigma_height_shared=4.0, height_kind="unknown, taken as orthometric"
    )
    first = replace(site.photos[0], pose=pose, sigma_above_ground=3.5)
    v = values(replace(site, photos=(first,)), "photos")
    assert v["height_kind"] == "unknown, taken as orthometric"
    # 3 m over the ground (conftest) and 4 m of a level that camera and ground share
    assert v["sigma_u_m"] == pytest.approx(5.0)
    assert v["sigma_above_ground_m"] == 3.5
    assert [v["sigma_e_m"], v["sigma_n_m"]] == pytest.approx([1.0, 2.0])
    assert "height_kind" in site.metadata()["heights"]
