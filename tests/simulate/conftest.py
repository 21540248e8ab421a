"""One flight and one written folder, shared by the tests of the simulator."""

import pytest

from georef_gis.simulate import FlightSettings, simulate_flight, write_flight


@pytest.fixture(scope="session")
def flight():
    return simulate_flight(FlightSettings(), seed=7)


@pytest.fixture(scope="session")
def folder(flight, tmp_path_factory):
    """A flight folder with one photo."""
    path = tmp_path_factory.mktemp("flight")
    write_flight(flight, path, photos=[2], truth_imu=True)
    return path
