"""The flight in time: UTC, angles, sigmas, gaps; and no times where none are known."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyogrio
import pytest
from kml_checks import GX, K, documents, faults_of
from lxml import etree
from site_cases import ORIGIN, make_site

from exports.kml.kml import write_kml, write_kmz
from exports.kml.options import KmzOptions
from exports.kml.track import Flown, flight_placemarks, read_trajectory
from georef_gis.errors import ExportError
from georef_gis.geodesy import geoid_undulation
from georef_gis.toolbox import CollectingFeedback

HEAD = (
    "gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m,v_north,v_east,v_down,roll_deg,pitch_deg,"
    "yaw_deg,sigma_north_m,sigma_east_m,sigma_down_m,sigma_roll_deg,sigma_pitch_deg,sigma_yaw_deg"
)
# GPS week 2416 began on Sunday 2026-04-26 00:00 of the GPS scale, 18 s before UTC's midnight.
WEEK, TOW = 2416, 36_018.0
START = datetime(2026, 4, 26, 10, 0, 0, tzinfo=UTC)


def write_table(folder: Path, times: np.ndarray, *, blank: bool = False) -> SimpleNamespace:
    """A trajectory as the project keeps it, 10 m/s to the east; gives its project."""
    (folder / "navigation").mkdir()
    rows = []
    for t in times:
        # 40 N: 85.4 km to a degree of longitude
        lon = -83.0 + t * 10.0 / 85_394.0
        sigma = "" if blank else "0.02"
        place = f"{WEEK},{TOW + t:.7f},40.0000000000,{lon:.10f},300.0,0.0,10.0,0.0"
        angles = f"5.0,-3.0,{(350.0 + t) % 360.0:.4f}"
        rows.append(f"{place},{angles},{sigma},0.03,0.05,0.1,0.1,0.3")
    text = "\n".join(["# place: imu", HEAD, *rows]) + "\n"
    (folder / "navigation" / "trajectory.csv").write_text(text)
    return SimpleNamespace(navigation=folder / "navigation")


def tracks(path: Path) -> list[etree._Element]:
    return [t for _, root in documents(path) for t in root.iter(GX + "Track")]


def times_of(track: etree._Element) -> list[datetime]:
    return [datetime.fromisoformat(e.text) for e in track.iter(K + "when")]


def written(folder: Path, project: object, **options: object) -> Path:
    write_kmz(make_site(folder), folder / "s.kmz", KmzOptions(overlay="none", **options),
              CollectingFeedback(), project)  # type: ignore[arg-type]  # fmt: skip
    assert faults_of(folder / "s.kmz") == []
    return folder / "s.kmz"


def test_trajectory_is_thinned_and_in_utc(tmp_path):
    project = write_table(tmp_path, np.arange(0.0, 60.0, 0.1))
    (track,) = tracks(written(tmp_path, project, track_hz=2.0))
    times = times_of(track)
    assert times[0] == START
    assert times[-1] == START + timedelta(seconds=59.9)
    assert np.diff([t.timestamp() for t in times])[:-1] == pytest.approx(0.5, abs=1e-3)
    lon, lat, height = map(float, track.find(GX + "coord").text.split())
    n = float(geoid_undulation(ORIGIN.lat, ORIGIN.lon))
    assert (lon, lat) == pytest.approx((-83.0, 40.0), abs=1e-9)
    assert height == pytest.approx(300.0 - n, abs=2e-3)
    assert track.findtext(K + "altitudeMode") == "absolute"


def test_angles_and_sigmas_go_with_every_sample(tmp_path):
    project = write_table(tmp_path, np.arange(0.0, 20.0, 0.1))
    (track,) = tracks(written(tmp_path, project))
    angles = np.array([e.text.split() for e in track.iter(GX + "angles")], float)
    # A model turns clockwise about x (right) and y (forward): nose up is a negative tilt.
    assert angles[0] == pytest.approx([350.0, 3.0, -5.0])
    assert angles[-1] == pytest.approx([9.9, 3.0, -5.0], abs=1e-3)
    arrays = {a.get("name"): [float(v.text) for v in a] for a in track.iter(GX + "SimpleArrayData")}
    assert arrays["speed_m_s"] == pytest.approx([10.0] * len(angles))
    assert arrays["sigma_e_m"][0] == 0.03
    assert arrays["sigma_n_m"][0] == 0.02
    assert arrays["sigma_u_m"][0] == 0.05
    assert arrays["sigma_yaw_deg"][0] == 0.3
    assert arrays["pitch_deg"][0] == -3.0


def test_a_gap_parts_the_track(tmp_path):
    times = np.concatenate([np.arange(0.0, 20.0, 0.1), np.arange(60.0, 90.0, 0.1)])
    path = written(tmp_path, write_table(tmp_path, times))
    (multi,) = [m for _, root in documents(path) for m in root.iter(GX + "MultiTrack")]
    found = [times_of(track) for track in multi.iter(GX + "Track")]
    ends = [((t[0] - START).total_seconds(), (t[-1] - START).total_seconds()) for t in found]
    assert ends == [(0.0, pytest.approx(19.9)), (60.0, pytest.approx(89.9))]


def test_what_is_not_known_is_an_empty_value_or_no_array(tmp_path):
    (track,) = tracks(written(tmp_path, write_table(tmp_path, np.arange(0, 9, 0.1), blank=True)))
    names = {a.get("name") for a in track.iter(GX + "SimpleArrayData")}
    assert "sigma_n_m" not in names
    assert "sigma_e_m" in names


def test_photos_with_times_give_the_flight_where_there_is_no_trajectory(tmp_path):
    path = written(tmp_path, None)
    (track,) = tracks(path)
    assert [t.isoformat() for t in times_of(track)] == [
        f"2026-05-01T12:00:0{s}+00:00" for s in (0, 2, 4)
    ]
    speed = next(a for a in track.iter(GX + "SimpleArrayData") if a.get("name") == "speed_m_s")
    # 20 m in 2 s; a sphere for the ellipsoid
    assert [float(v.text) for v in speed] == pytest.approx([10.0] * 3, rel=0.01)
    # the line through the photos is there for viewers without tracks, and not drawn twice
    root = dict(documents(path))["doc.kml"]
    (line,) = [m for m in root.iter(K + "Placemark") if m.find(K + "LineString") is not None]
    assert line.findtext(K + "visibility") == "0"


def test_no_time_is_invented(tmp_path):
    site = make_site(tmp_path)
    photos = tuple(replace(p, photo=replace(p.photo, time_gps=None)) for p in site.photos)
    timeless = replace(site, photos=photos)
    write_kml(timeless, tmp_path / "s.kml")
    assert faults_of(tmp_path / "s.kml") == []
    assert tracks(tmp_path / "s.kml") == []
    (root,) = [root for _, root in documents(tmp_path / "s.kml")]
    (line,) = list(root.iter(K + "LineString"))
    assert line.getparent().find(K + "visibility") is None


def test_a_broken_trajectory_is_told_and_the_photos_are_taken(tmp_path):
    project = write_table(tmp_path, np.arange(0.0, 5.0, 0.1))
    table = project.navigation / "trajectory.csv"
    table.write_text(table.read_text() + "half a li")
    with pytest.raises(ExportError, match=r"trajectory\.csv: cannot be read .*georef navigate"):
        read_trajectory(table)
    feedback = CollectingFeedback()
    write_kmz(make_site(tmp_path), tmp_path / "s.kmz", KmzOptions(), feedback, project)
    assert faults_of(tmp_path / "s.kmz") == []
    assert any("drawn from its photos" in warning for warning in feedback.warnings)
    assert len(times_of(tracks(tmp_path / "s.kmz")[0])) == 3


def test_a_leap_second_keeps_the_times_in_order():
    # 2017-01-01: GPS - UTC went from 17 to 18 s; half a second each around it
    last = (datetime(2016, 12, 31, 23, 59, 58) - datetime(1980, 1, 6)).total_seconds() + 17.0
    time = last + np.array([0.0, 1.0, 3.0, 4.0])
    flown = Flown(name="f", said="", time=time, lonlat=np.zeros((4, 2)), height=np.zeros(4),
                  values=np.full((4, 11), np.nan), gap=10.0)  # fmt: skip
    (mark,) = flight_placemarks([flown], 10.0, None)
    whens = [part.partition("</when>")[0] for part in mark.split("<when>")[1:]]
    assert whens == [
        "2016-12-31T23:59:58.000Z", "2016-12-31T23:59:59.000Z",
        "2017-01-01T00:00:00.000Z", "2017-01-01T00:00:01.000Z",
    ]  # fmt: skip


def test_gdal_reads_the_track_sample_by_sample(tmp_path):
    write_kml(make_site(tmp_path), tmp_path / "s.kml",
              project=write_table(tmp_path, np.arange(0.0, 10.0, 0.1)))  # type: ignore[arg-type]  # fmt: skip
    (track,) = tracks(tmp_path / "s.kml")
    wanted = np.array([e.text.split() for e in track.iter(GX + "coord")], float)
    (line,) = pyogrio.read_dataframe(tmp_path / "s.kml", layer="Flight in time").geometry
    assert np.array(line.coords) == pytest.approx(wanted, abs=1e-9)
