"""Accuracy, honesty and cost of the inertial filter and smoother, on simulated and real flights.

    python benchmarks/navigation.py [--flights 10] [--rival] [--rival-python VENV/bin/python]

Prints markdown tables. The survey is 300 m rows at 20 m/s with turns of 25 deg of bank, 100 Hz,
fixes at 5 Hz of 2.12 m and 0.1 m/s per axis, gyro bias 100 deg/h and 0.3 deg/sqrt(h),
accelerometer bias 0.03 m/s2. `--rival` runs pyins over one of the same flights, in a venv
of its own. The real flight is found by GEOREF_DATA. Linux only: memory is read from /proc.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

# the simulated logs are those of the tests
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "navigate"))

from navigation_flights import drawn, logs_of, settings_of, truth_at
from navigation_thor import thor_table

from georef_gis.frames import (
    Array,
    R_ned_from_body,
    exp_so3,
    log_so3,
    rpy_from_R_ned_from_body,
)
from georef_gis.model.logs import ImuLog, covariance_of_sigmas, unknown
from georef_gis.navigate import filter_pass, first_state, inertial_solution
from georef_gis.navigate.dense import unpack
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.navigate.tuning import tune
from georef_gis.simulate import SimulatedFlight

SHEET = {"gyro_bias": math.radians(100.0) / 3600.0, "accel_bias": 0.03, "scale": 0.0,
         "misalignment": 0.0}  # fmt: skip
REAL_AXES = {"gyro_scale_percent": 0.5, "gyro_misalignment_deg": 0.3}
# s; a filter is judged behind its first minute, a smoother as a whole
SETTLED = 60.0
# rows of the survey that last about an hour
HOUR_ROWS = 60


def rms(rows: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))


def compared(
    flight: SimulatedFlight, times: Array, p_geo: Array, R: Array, *, constant: bool
) -> tuple[Array, Array]:
    """Errors N, E, D in m and about the nose's level direction, the wing's and down in deg.

    `constant` takes the flight's mean rotation in the body out first.
    """
    p, _, R_true = truth_at(flight, times)
    dp = (p - p_geo) * np.array([6.3576e6, 6.3856e6 * math.cos(p[0, 0]), -1.0])
    turned = R_true
    if constant:
        turned = R_true @ exp_so3(-log_so3(np.swapaxes(R, -1, -2) @ R_true).mean(axis=0))
    n, e, d = log_so3(turned @ np.swapaxes(R, -1, -2)).T
    heading = np.arctan2(R_true[:, 1, 0], R_true[:, 0, 0])
    c, s = np.cos(heading), np.sin(heading)
    return dp, np.degrees(np.stack([c * n + s * e, c * e - s * n, d], axis=-1))


def filter_errors(
    flight: SimulatedFlight, found: InertialTrajectory, *, constant: bool
) -> tuple[Array, Array, float]:
    late = found.nodes > found.nodes[0] + SETTLED
    nav = found.post_nav[late]
    R = nav[:, 6:].reshape(-1, 3, 3)
    dp, rph = compared(flight, found.nodes[late], nav[:, :3], R, constant=constant)
    theta = log_so3(truth_at(flight, found.nodes[late])[2] @ np.swapaxes(R, -1, -2))
    n = found.model.shape[1]
    C = np.stack([unpack(row, n)[6:9, 6:9] for row in found.filtered[late][::7]])
    return dp, rph, nees(theta[::7], C)


def nees(theta: Array, C: Array) -> float:
    return float(np.einsum("ni,nij,nj->n", theta, np.linalg.inv(C), theta).mean() / 3.0)


def smoother_errors(
    flight: SimulatedFlight, found: InertialTrajectory, *, constant: bool
) -> tuple[Array, Array, float, Array]:
    times = np.arange(found.span[0] + 0.5, found.span[1] - 0.5, 0.73)
    states = found.at(times)
    R = states.R_ned_from_body
    dp, rph = compared(flight, times, states.p_geo, R, constant=constant)
    theta = log_so3(truth_at(flight, times)[2] @ np.swapaxes(R, -1, -2))
    sigma = np.sqrt(np.einsum("nii->ni", states.covariance))
    ratio = np.concatenate([dp, theta], axis=-1) / sigma
    return dp, rph, nees(theta, states.covariance[:, 3:, 3:]), ratio


def numbers(values: Array, digits: int) -> str:
    return "/".join(f"{v:.{digits}f}" for v in values)


def accuracy(flights: int) -> None:
    """Table of the accuracy over flights."""
    print(f"\n### Simulated survey, {flights} flights of 600 s\n")
    print(
        "| GNSS | axes | states | run | N/E/D m | roll/pitch/heading deg | attitude NEES/3 | "
        "error/sigma position, attitude | 1 to 5 s apart m |\n|---|---|---|---|---|---|---|---|---|"
    )
    for gnss, real, sheet in (
        ("white", False, True), ("white", False, False), ("coloured", False, True),
        ("white", True, True), ("white", True, False), ("coloured", True, False),
    ):  # fmt: skip
        lines = _lines(flights, gnss, real=real, sheet=sheet)
        axes = "0.5 %, 0.3 deg" if real else "ideal"
        for line in lines:
            print(f"| {gnss} | {axes} | {15 if sheet else 24} | {line}")
    sys.stdout.flush()


def _lines(flights: int, gnss: str, *, real: bool, sheet: bool) -> list[str]:
    kept: dict[str, list[tuple[Array, Array, float]]] = {"filter": [], "RTS": []}
    ratios, apart = [], []
    for seed in range(flights):
        flight = drawn(seed, gnss=gnss, **(REAL_AXES if real else {}))
        log, fixes = logs_of(flight)
        imu = SHEET if sheet else {}
        # a gate wide open: a filter that takes real axes as perfect is refused otherwise
        settings = replace(settings_of(flight, **imu), gate=1e-12 if real and sheet else 0.001)
        found = smooth_flight(log, prepare_fixes(fixes), settings)
        dp, rph, value = filter_errors(flight, found, constant=real)
        kept["filter"].append((rms(dp), rms(rph), value))
        dp, rph, value, ratio = smoother_errors(flight, found, constant=real)
        kept["RTS"].append((rms(dp), rms(rph), value))
        ratios.append(ratio**2)
        apart.append([rms(dp[k:] - dp[:-k]) for k in (1, 3, 7)])
    ratio = np.sqrt(np.mean(np.concatenate(ratios), axis=0))
    lines = []
    for name, rows in kept.items():
        ned, rph = rms(np.array([r[0] for r in rows])), rms(np.array([r[1] for r in rows]))
        value = np.mean([r[2] for r in rows])
        more = "- | -"
        if name == "RTS":
            worst = rms(np.array(apart)).max()
            more = f"{numbers(ratio[:3], 2)}, {numbers(ratio[3:], 2)} | {worst:.3f}"
        lines.append(f"{name} | {numbers(ned, 3)} | {numbers(rph, 4)} | {value:.2f} | {more} |")
    return lines


@contextmanager
def counted(spent: dict[str, float], *names: str) -> Iterator[None]:
    """Sum the CPU seconds of functions of the filter and the smoother while within."""
    homes = {
        (module, name): getattr(module, name)
        for module in (inertial_solution, filter_pass, first_state)
        for name in names
        if hasattr(module, name)
    }

    def timed(name: str, function: Callable[..., object]) -> Callable[..., object]:
        def wrapper(*args: object) -> object:
            begin = time.process_time()
            try:
                return function(*args)
            finally:
                spent[name] = spent.get(name, 0.0) + time.process_time() - begin

        return wrapper

    try:
        for (module, name), function in homes.items():
            setattr(module, name, timed(name, function))
        yield
    finally:
        for (module, name), function in homes.items():
            setattr(module, name, function)


def memory_mb(field: str) -> float:
    """A line of /proc/self/status, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) / 1024.0
    raise OSError(f"no {field} in /proc/self/status")


def draw_hour(path: Path) -> None:
    """Logs of about an hour into a file, so that drawing them leaves no memory behind."""
    flight = drawn(2, HOUR_ROWS)
    log, fixes = logs_of(flight)
    np.savez(
        path, imu_time=log.time, gyro=log.gyro, accel=log.accel, time=fixes.time, lat=fixes.lat,
        lon=fixes.lon, height=fixes.height, v_ned=fixes.v_ned,
    )  # fmt: skip


def cost_of(path: Path, *, sheet: bool) -> dict[str, float]:
    """CPU seconds and memory of this process over the hour, warm."""
    short = drawn(1, 2)
    imu = SHEET if sheet else {}
    log, fixes = logs_of(short)
    settings = settings_of(short, **imu)
    found = smooth_flight(log, prepare_fixes(fixes), settings)
    found.at(np.linspace(*found.span, 50))
    tune(log, prepare_fixes(fixes), settings, noise=True, delay=True)
    with np.load(path) as hour:
        log = ImuLog(time=hour["imu_time"], gyro=hour["gyro"], accel=hour["accel"])
        n = len(hour["time"])
        sigma = short.settings.gnss_sigma, short.settings.gnss_velocity
        fixes = replace(
            fixes, **{name: hour[name] for name in ("time", "lat", "lon", "height", "v_ned")},
            geoid_separation=unknown(n), fix=np.full(n, 3), satellites=np.full(n, -1),
            covariance_ned=covariance_of_sigmas(np.full((n, 3), sigma[0])),
            covariance_v_ned=covariance_of_sigmas(np.full((n, 3), sigma[1])),
        )  # fmt: skip
    # forget the peak of what came before
    Path("/proc/self/clear_refs").write_text("5")
    before = memory_mb("VmRSS")
    spent: dict[str, float] = {}
    begin = time.process_time()
    ready = prepare_fixes(fixes)
    with counted(spent, "run_filter", "run_smoother", "align"):
        found = smooth_flight(log, ready, settings)
    solved = time.process_time()
    found.at(np.linspace(found.span[0] + 1.0, found.span[1] - 1.0, 1000))
    done = time.process_time()
    out = {
        "hours": (log.time[-1] - log.time[0]) / 3600.0, "solved": solved - begin,
        "at": done - solved, "peak": memory_mb("VmHWM") - before,
        "kept": memory_mb("VmRSS") - before, **spent,
    }  # fmt: skip
    tune(log, ready, settings, noise=True, delay=True)
    return {**out, "tune": time.process_time() - done}


def cold() -> dict[str, float]:
    """CPU and wall seconds of a first and a second run of this process."""
    flight = drawn(1, 2)
    log, fixes = logs_of(flight)
    ready, settings = prepare_fixes(fixes), settings_of(flight)
    out = {}
    for name in ("first", "second"):
        begin, wall = time.process_time(), time.perf_counter()
        found = smooth_flight(log, ready, settings)
        found.at(np.linspace(*found.span, 50))
        out[name] = time.process_time() - begin
        out[f"{name}_wall"] = time.perf_counter() - wall
    return out


def in_a_process(what: str, *arguments: str, cache: str = "") -> dict[str, float]:
    """One of the measurements above in a process of its own."""
    environment = {**os.environ, **({"NUMBA_CACHE_DIR": cache} if cache else {})}
    done = subprocess.run(
        [sys.executable, __file__, "--only", what, *arguments], check=True, text=True,
        stdout=subprocess.PIPE, env=environment,
    )  # fmt: skip
    return dict(json.loads(done.stdout.splitlines()[-1]))


def cost() -> None:
    """Table of the cost of an hour."""
    print("\n### Cost of one hour of 100 Hz, fixes at 5 Hz, warm, one process\n")
    print(
        "| states | filter + smoother CPU s | of it first attitude / filter / smoother | 1000 "
        "exposures CPU s | together | peak memory above the logs MB | tuning CPU s |\n"
        "|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hour.npz"
        draw_hour(path)
        for states in ("15", "24"):
            found = in_a_process("cost", "--states", states, "--logs", str(path))
            h = found["hours"]
            together = (found["solved"] + found["at"]) / h
            parts = "/".join(f"{found[k] / h:.2f}" for k in ("align", "run_filter", "run_smoother"))
            print(f"| {states} | {found['solved'] / h:.2f} | {parts} | {found['at']:.2f} | "
                  f"{together:.2f} | {found['peak'] / h:.0f} | {found['tune']:.1f} |")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        first, later = (in_a_process("cold", cache=folder) for _ in range(2))
    print(f"\nCompiling, once per machine: {first['first'] - first['second']:.1f} CPU s "
          f"({first['first_wall']:.1f} s wall); loading what is compiled, once per process: "
          f"{later['first'] - later['second']:.2f} CPU s.")  # fmt: skip
    sys.stdout.flush()


def rival_python(given: str, folder: Path) -> str:
    """Python of a venv with pyins; made in a folder where none is given."""
    if given:
        return given
    venv.create(folder / "venv", with_pip=True)
    python = str(folder / "venv" / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", "-q", "python-ins==1.0.1"], check=True)
    return python


def rival(given: str) -> None:
    """Table of ours and pyins over one flight."""
    flight = drawn(0, gnss="white")
    log, fixes = logs_of(flight)
    p, v, R = truth_at(flight, log.time[:1])
    rpy = np.degrees(rpy_from_R_ned_from_body(R)[0]) + np.array([0.5, -0.5, 3.0])
    start = np.concatenate([np.degrees(p[0, :2]), p[0, 2:], v[0], rpy])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(
            folder / "logs.npz", imu_time=log.time - flight.start_gps, gyro=log.gyro,
            accel=log.accel, fix_time=fixes.time - flight.start_gps, v_ned=fixes.v_ned,
            lla_deg=np.column_stack([np.degrees(fixes.lat), np.degrees(fixes.lon), fixes.height]),
            start=start, arm=flight.settings.lever_arm_antenna, sigma_p=flight.settings.gnss_sigma,
            sigma_v=flight.settings.gnss_velocity,
            sheet=[SHEET["gyro_bias"], math.radians(0.3) / 60.0, SHEET["accel_bias"], 0.1 / 60.0],
        )  # fmt: skip
        script = Path(__file__).with_name("navigation_rival.py")
        subprocess.run(
            [rival_python(given, folder), script, folder / "logs.npz", folder / "out.npz"],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        out = np.load(folder / "out.npz")
        begin = time.process_time()
        found = smooth_flight(log, prepare_fixes(fixes), settings_of(flight, **SHEET))
        ours = time.process_time() - begin
        _rival_table(flight, found, ours, out["time"], out["states"], float(out["cpu"]))


def _rival_table(
    flight: SimulatedFlight, found: InertialTrajectory, ours: float, t: Array, states: Array,
    cpu: float,
) -> None:  # fmt: skip
    hours = (found.span[1] - found.span[0]) / 3600.0
    print("\n### pyins 1.0.1 over the first of these flights (filter, step 0.2 s; it has no "
          "smoother), behind its first minute\n\n| run | N/E/D m | roll/pitch/heading deg | "
          "CPU s per hour |\n|---|---|---|---|")  # fmt: skip
    late = (t > SETTLED) & (t < found.span[1] - flight.start_gps)
    t, states = t[late][::10], states[late][::10]
    R = R_ned_from_body(*np.radians(states[:, 6:]).T)
    p = np.column_stack([np.radians(states[:, :2]), states[:, 2]])
    dp, rph = compared(flight, t + flight.start_gps, p, R, constant=False)
    print(f"| pyins filter | {numbers(rms(dp), 3)} | {numbers(rms(rph), 4)} | {cpu / hours:.0f} |")
    dp, rph, _ = filter_errors(flight, found, constant=False)
    print(f"| our filter | {numbers(rms(dp), 3)} | {numbers(rms(rph), 4)} | |")
    dp, rph, _, _ = smoother_errors(flight, found, constant=False)
    print(f"| our RTS, whole flight | {numbers(rms(dp), 3)} | {numbers(rms(rph), 4)} | "
          f"{ours / hours:.2f} |\n\npyins / ours: {cpu / ours:.0f} times the CPU.")  # fmt: skip
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--rival", action="store_true", help="install pyins into a temporary venv")
    parser.add_argument("--rival-python", default="", help="Python of a venv with pyins")
    parser.add_argument("--only", default="", help=argparse.SUPPRESS)
    parser.add_argument("--states", default="24", help=argparse.SUPPRESS)
    parser.add_argument("--logs", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only == "cost":
        print(json.dumps(cost_of(options.logs, sheet=options.states == "15")))
        return
    if options.only == "cold":
        print(json.dumps(cold()))
        return
    print(f"{datetime.date.today()}, {platform.machine()}, {os.cpu_count()} cores, "
          f"Python {platform.python_version()}, numpy {np.__version__}")  # fmt: skip
    accuracy(options.flights)
    cost()
    thor_table(os.environ.get("GEOREF_DATA", ""))
    if options.rival or options.rival_python:
        rival(options.rival_python)


if __name__ == "__main__":
    main()
