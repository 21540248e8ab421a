"""A finished trajectory of another program, or of the 9-state filter, as any other trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.ellipsoid import meridian_radius, prime_vertical_radius
from georef_gis.errors import NavigationError
from georef_gis.frames import Array, R_ned_from_body
from georef_gis.model.logs import TrajectoryLog
from georef_gis.model.trajectory import StateChain, TrajectoryStates
from georef_gis.navigate.resample import at_times
from georef_gis.project.columns_file import read_columns, write_columns

KIND = "table"
# s without rows that is not bridged
LONGEST_GAP = 1.0
# s; errors of smoothed trajectories stay alike for about this long
CORRELATION = 30.0
# one sigma where the trajectory states none: m per axis, and rad of roll, pitch and of heading
SIGMA_POSITION = 2.0
SIGMA_LEVEL = math.radians(1.0)
SIGMA_HEADING = math.radians(3.0)


def of_imu(log: TrajectoryLog, antenna: Array, camera: Array) -> TrajectoryLog:
    """A trajectory of the antenna or of the camera as that of the IMU.

    Parameters
    ----------
    antenna, camera : shape (3,), m
        Lever arms from the IMU in body axes.
    """
    arms = {"antenna": antenna, "camera": camera}
    if log.position_of not in arms:
        return log
    n, e, d = (R_ned_from_body(*log.rpy.T) @ arms[log.position_of]).T
    return replace(
        log,
        lat=log.lat - n / (meridian_radius(log.lat) + log.height),
        lon=log.lon - e / ((prime_vertical_radius(log.lat) + log.height) * np.cos(log.lat)),
        height=log.height + d,
        position_of="imu",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class TableTrajectory:
    """Rows of a trajectory with attitude, of the IMU; between them it is interpolated."""

    log: TrajectoryLog

    def __post_init__(self) -> None:
        """Check that there is something to interpolate."""
        if len(self.log) < 2:
            raise NavigationError(f"{self.log.source}: {len(self.log)} rows; two are needed")
        if not np.isfinite(self.log.rpy).any():
            raise NavigationError(f"{self.log.source}: holds no attitude; use it as [logs] gnss")

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.log.time[0]), float(self.log.time[-1])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of every row, as stated or by default; (n, 6, 6)."""
        out = self.log.covariance.copy()
        position, angle = (~np.isfinite(out[:, k, k]) for k in (0, 3))
        for rows, first in ((position, 0), (angle, 3)):
            out[rows, first : first + 3, :] = 0.0
            out[rows, :, first : first + 3] = 0.0
        for k, sigma in enumerate((SIGMA_LEVEL, SIGMA_LEVEL, SIGMA_HEADING)):
            out[position, k, k] = SIGMA_POSITION**2
            out[angle, 3 + k, 3 + k] = sigma**2
        return np.where(np.isfinite(out), out, 0.0)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is doubtful."""
        bare = np.count_nonzero(~np.isfinite(self.log.covariance[:, 0, 0]))
        if not bare:
            return self.log.doubts
        return (
            *self.log.doubts,
            f"{self.log.source}: no accuracies in {bare} of {len(self.log)} rows: "
            f"{SIGMA_POSITION} m, {math.degrees(SIGMA_LEVEL):.0f} deg of roll and pitch and "
            f"{math.degrees(SIGMA_HEADING):.0f} deg of heading are taken",
        )

    def why_not(self, time: float) -> str:
        """Reason, in words, why there is no state at a time; empty where there is one."""
        first, last = self.span
        if not np.isfinite(time):
            return "its time is not known"
        if time < first:
            return f"its time lies {first - time:.1f} s before the trajectory"
        if time > last:
            return f"its time lies {time - last:.1f} s after the trajectory"
        i = int(np.searchsorted(self.log.time, time, side="left"))
        gap = float(self.log.time[i] - self.log.time[max(i - 1, 0)])
        usual = float(np.median(np.diff(self.log.time)))
        if gap > max(LONGEST_GAP, 2.0 * usual):
            return f"its time lies in a gap of {gap:.1f} s of the trajectory"
        for what, values in (("attitude", self.log.rpy), ("position", self.log.height[:, None])):
            if not np.isfinite(values[max(i - 1, 0) : i + 1]).all():
                return f"the trajectory has no {what} at its time"
        return ""

    def at(self, times: ArrayLike) -> TrajectoryStates:
        """States at times, in any order."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        self._check(t)
        here = at_times(self.log, t)
        R = R_ned_from_body(here.rpy[:, 0], here.rpy[:, 1], here.rpy[:, 2])
        return TrajectoryStates(
            time=t,
            p_geo=np.stack([here.lat, here.lon, here.height], axis=-1),
            v_ned=np.where(np.isfinite(here.v_ned), here.v_ned, 0.0),
            R_ned_from_body=R,
            rate_body=self._rates(t, R),
            covariance=self._covariance(t),
        )

    def chain(self, times: ArrayLike) -> StateChain:
        """Errors at increasing times, alike over `CORRELATION` seconds."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        self._check(t)
        P = self._covariance(t)
        L = np.linalg.cholesky(P + 1e-12 * np.eye(6) * np.trace(P, axis1=1, axis2=2)[:, None, None])
        G = np.zeros_like(P)
        for i in range(len(t) - 1):
            rho = math.exp(-(t[i + 1] - t[i]) / CORRELATION)
            G[i] = rho * L[i] @ np.linalg.inv(L[i + 1])
        return StateChain(time=t, covariance=P, gain=G)

    def _covariance(self, t: Array) -> Array:
        time, P = self.log.time, self.covariance
        i = np.clip(np.searchsorted(time, t, side="right") - 1, 0, len(time) - 2)
        u = ((t - time[i]) / (time[i + 1] - time[i]))[:, None, None]
        return np.asarray((1.0 - u) * P[i] + u * P[i + 1])

    def _rates(self, t: Array, R: Array) -> Array:
        """Angular rates by differences over the usual step, rad/s; level axes turn slowly."""
        from georef_gis.frames import log_so3

        h = 0.5 * float(np.median(np.diff(self.log.time)))
        first, last = self.span
        before, after = np.clip(t - h, first, last), np.clip(t + h, first, last)
        turned = [R_ned_from_body(*(at_times(self.log, x).rpy.T)) for x in (before, after)]
        rotation = np.swapaxes(turned[0], -1, -2) @ turned[1]
        return np.asarray(log_so3(rotation) / np.maximum(after - before, 1e-6)[:, None])

    def _check(self, t: Array) -> None:
        for value in t:
            if why := self.why_not(float(value)):
                raise NavigationError(f"time {value:.3f} s: {why}")

    def save(self, path: Path) -> None:
        """Write all columns into one ``.npz``, whole or not at all."""
        names = [item.name for item in fields(self.log) if item.name != "scale"]
        write_columns(path, KIND, {name: getattr(self.log, name) for name in names})

    @classmethod
    def load(cls, path: Path) -> TableTrajectory:
        """Read what `save` wrote; raises InputError if the file is none."""
        columns = read_columns(path, KIND)
        columns["doubts"] = tuple(str(word) for word in columns["doubts"])
        for name in ("source", "position_of"):
            columns[name] = str(columns[name])
        return cls(log=TrajectoryLog(**columns))
