"""A real fixed wing (thor75: 50 Hz IMU, 1 Hz fixes) against the filter that flew on board."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.frames import Array, R_ned_from_body, rpy_from_R_ned_from_body
from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import GnssLog, ImuLog, unknown
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import innovation_score, smooth_flight
from georef_gis.navigate.settings import NavigationSettings
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.navigate.tuning import tune

# s of the log by which the filter on board has settled
ONBOARD_SETTLED = 275.0
# m/s and m above the lowest fix: airborne
FLYING, ABOVE = 8.0, 15.0


def read(path: Path) -> tuple[Any, ImuLog, GnssLog]:
    """The columns themselves, and the logs in their own seconds."""
    from scipy.io import loadmat

    d = loadmat(path, squeeze_me=True, struct_as_record=False)["flight_data"]
    new = np.flatnonzero(np.concatenate([[False], np.diff(d.GPS_TOW) != 0]))
    n = len(new)
    imu = ImuLog(
        time=d.time, gyro=np.column_stack([d.p, d.q, d.r]),
        accel=np.column_stack([d.ax, d.ay, d.az]), source=path.name,
    )  # fmt: skip
    gnss = GnssLog(
        time=d.time[new], lat=np.radians(d.lat[new]), lon=np.radians(d.lon[new]),
        height=d.alt[new], height_kind=HeightKind.ELLIPSOIDAL, geoid_separation=unknown(n),
        v_ned=np.column_stack([d.vn, d.ve, d.vd])[new], covariance_ned=unknown(n, 3, 3),
        covariance_v_ned=unknown(n, 3, 3), fix=np.full(n, 3), satellites=np.full(n, -1),
        source=path.name,
    )  # fmt: skip
    return d, imu, gnss


def against_onboard(d: Any, found: InertialTrajectory) -> tuple[Array, Array]:
    """Times airborne, s, and roll, pitch, yaw less those of the filter on board, deg."""
    t = d.time[(d.time > found.span[0] + 1.0) & (d.time < found.span[1] - 1.0)][::5]
    t = t[[not found.why_not(float(value)) for value in t]]
    speed = np.interp(t, d.time, np.hypot(d.vn, d.ve))
    height = np.interp(t, d.time, d.alt)
    flying = (speed > FLYING) & (height > height.min() + ABOVE)
    ours = rpy_from_R_ned_from_body(found.states(t)[0][:, 6:].reshape(-1, 3, 3))
    angles = [np.interp(t, d.time, a) for a in (d.phi, d.theta, np.unwrap(d.psi))]
    onboard = rpy_from_R_ned_from_body(R_ned_from_body(*angles))
    apart = (ours - onboard + np.pi) % (2.0 * np.pi) - np.pi
    return t[flying], np.degrees(apart[flying])


def thor_table(folder: str) -> None:
    """Table of ours against the filter on board, delay as logged and found."""
    if not folder:
        print("\nthor75 is left out: GEOREF_DATA is not set.")
        return
    path = Path(folder) / "flight_logs" / "thor75" / "thor_flight75.mat"
    d, imu, gnss = read(path)
    fixes = prepare_fixes(gnss)
    found = tune(imu, fixes, NavigationSettings(), noise=True, delay=True)
    print("\n### thor75 against the filter on board (agreement, not truth), rms "
          "roll/pitch/heading deg\n\n| run | airborne | behind 275 s | innovations |\n"
          "|---|---|---|---|")  # fmt: skip
    for name, used in (("delay 0", fixes), ("delay found", found.fixes)):
        solved = smooth_flight(imu, used, found.settings)
        t, apart = against_onboard(d, solved)
        cells = []
        for chosen in (t > 0.0, t > ONBOARD_SETTLED):
            cells.append("/".join(f"{v:.2f}" for v in np.sqrt(np.mean(apart[chosen] ** 2, axis=0))))
        score = ", ".join(f"{k} {v:.2f}" for k, v in innovation_score(solved).items())
        print(f"| {name} | {cells[0]} | {cells[1]} | {score} |")
    print("\n" + "; ".join(found.notes))
    sys.stdout.flush()
