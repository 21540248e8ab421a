"""Synthetic flights and photos with known truth; shares no geometry with the estimators."""

from georef_gis.simulate.flight import (
    SimulatedFlight,
    project_truth,
    simulate_flight,
    simulate_imu,
)
from georef_gis.simulate.settings import CameraTruth, FlightLine, FlightSettings
from georef_gis.simulate.site import ecef_from_enu, enu_from_ecef, ground_height
from georef_gis.simulate.write import write_flight

__all__ = [
    "CameraTruth",
    "FlightLine",
    "FlightSettings",
    "SimulatedFlight",
    "ecef_from_enu",
    "enu_from_ecef",
    "ground_height",
    "project_truth",
    "simulate_flight",
    "simulate_imu",
    "write_flight",
]
