"""The simulator's own geodesy against PROJ, which it does not use."""

import ast
from pathlib import Path

import numpy as np
import pyproj
import pytest

import georef_gis.simulate
from georef_gis.simulate import ellipsoid, site

LAT = np.radians([39.0975, 39.1, 0.1, -33.0, 85.0])
LON = np.radians([-80.467, -80.4, 0.0, 151.0, -179.9])
HEIGHT = np.array([277.0, 0.0, 9000.0, -40.0, 100.0])


def test_ecef_agrees_with_proj():
    oracle = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    expected = oracle.transform(np.degrees(LON), np.degrees(LAT), HEIGHT)
    actual = ellipsoid.ecef_from_geodetic(LAT, LON, HEIGHT)
    np.testing.assert_allclose(actual, np.stack(expected, axis=-1), atol=1e-6)  # m


def test_geodetic_and_ecef_are_inverse():
    lat, lon, h = ellipsoid.geodetic_from_ecef(ellipsoid.ecef_from_geodetic(LAT, LON, HEIGHT))
    np.testing.assert_allclose(lat, LAT, atol=1e-13)  # rad: below a micrometre
    np.testing.assert_allclose(lon, LON, atol=1e-13)
    np.testing.assert_allclose(h, HEIGHT, atol=1e-6)  # m


@pytest.mark.parametrize(
    ("forward", "crs", "unit"),
    [
        (ellipsoid.utm17_from_geodetic, "EPSG:32617", 1.0),
        (ellipsoid.state_plane_from_geodetic, "EPSG:6601", 1200 / 3937),
    ],
    ids=["utm", "state plane"],
)
def test_projection_agrees_with_proj(forward, crs, unit):
    lat, lon = np.radians([39.0975, 39.2, 38.9]), np.radians([-80.467, -80.3, -80.9])
    oracle = pyproj.Proj(crs)
    expected = np.stack(oracle(np.degrees(lon), np.degrees(lat)), axis=-1)
    np.testing.assert_allclose(forward(lat, lon) * unit, expected * unit, atol=1e-4)  # m


def test_enu_agrees_with_proj():
    p_enu = np.array([[120.0, -80.0, 15.0], [0.0, 0.0, 0.0]])
    lat, lon, h = np.degrees(site.ORIGIN_LAT), np.degrees(site.ORIGIN_LON), site.ORIGIN_HEIGHT
    oracle = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat} +lon_0={lon} +h_0={h}"
    )
    p = ellipsoid.geodetic_from_ecef(site.ecef_from_enu(p_enu))
    actual = oracle.transform(np.degrees(p[1]), np.degrees(p[0]), p[2])
    np.testing.assert_allclose(np.stack(actual, axis=-1), p_enu, atol=1e-6)  # m


def test_rotations_are_right_handed_and_ned_is_enu_turned():
    for make in (ellipsoid.rotation_ecef_from_enu, ellipsoid.rotation_ecef_from_ned):
        R = make(LAT, LON)
        np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
        np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape),
                                   atol=1e-12)  # fmt: skip


def test_gravity_at_45_degrees_is_the_table_value():
    # NIMA TR8350.2 table 3.4: 9.8061977 m/s2 mean latitude; closed form at the surface
    assert ellipsoid.gravity(np.radians(45.0), np.zeros(1))[0] == pytest.approx(
        9.80619777, abs=1e-6
    )
    fall = ellipsoid.gravity(np.radians(45.0), np.array([0.0, 1000.0]))
    assert fall[0] - fall[1] == pytest.approx(3.086e-3, abs=2e-6)  # free air, m/s2 per km


def test_simulator_imports_only_errors_and_units_of_the_package():
    for path in Path(georef_gis.simulate.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert name.split(".")[0] not in {"pyproj", "rasterio", "pyins", "lensfunpy"}, path
                if name.startswith("georef_gis"):
                    allowed = ("georef_gis.simulate", "georef_gis.errors", "georef_gis.units")
                    assert name.startswith(allowed), path
        assert "projectPoints" not in path.read_text(encoding="utf-8")
