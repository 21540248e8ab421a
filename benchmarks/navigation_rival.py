"""pyins' filter (MIT, PyPI `python-ins`) over a simulated flight; run by its own venv's Python.

Usage: ``python navigation_rival.py LOGS.npz RESULT.npz [STEP]``. Imports nothing of this project.
LOGS holds the columns that `navigation.py` writes; RESULT gets the trajectory and the CPU seconds.
"""

from __future__ import annotations

import sys
import time

import numpy as np


def main() -> None:
    import pandas as pd
    from pyins import filters, inertial_sensor, measurements, strapdown

    logs = np.load(sys.argv[1])
    step = float(sys.argv[3]) if len(sys.argv) > 3 else 0.2
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    imu = pd.DataFrame(np.hstack([logs["gyro"], logs["accel"]]), logs["imu_time"], columns)
    fixes = pd.DataFrame(
        np.column_stack([logs["lla_deg"], logs["v_ned"]]), logs["fix_time"],
        ["lat", "lon", "alt", "VN", "VE", "VD"],
    )  # fmt: skip
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    start = pd.Series(logs["start"], names, name=float(logs["imu_time"][0]))
    arm = logs["arm"]
    sheet = logs["sheet"]  # gyro bias, gyro walk, accelerometer bias, accelerometer walk; SI
    seen = [
        measurements.Position(fixes, float(logs["sigma_p"]), arm),
        measurements.NedVelocity(fixes, float(logs["sigma_v"]), arm),
    ]
    gyro = inertial_sensor.EstimationModel(bias_sd=sheet[0], noise=sheet[1])
    accel = inertial_sensor.EstimationModel(bias_sd=sheet[2], noise=sheet[3])
    begin = time.process_time()
    increments = strapdown.compute_increments_from_imu(imu, "rate")
    found = filters.run_feedback_filter(
        start, 3.0, 0.5, 1.0, 5.0, increments, gyro, accel, seen, time_step=step
    )
    cpu = time.process_time() - begin
    at = found.trajectory
    np.savez(sys.argv[2], time=at.index.to_numpy(), states=at[names].to_numpy(), cpu=cpu)


if __name__ == "__main__":
    main()
