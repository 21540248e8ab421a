"""RTKLIB's solution rows as a `GnssLog`, and a solution as a `.pos` file (RTKLIB manual, B.1)."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import (
    FIX_DGNSS,
    FIX_FIXED,
    FIX_FLOAT,
    FIX_NONE,
    FIX_PPP,
    FIX_SINGLE,
    EventLog,
    GnssLog,
    unknown,
)
from georef_gis.units import GPS_ZERO, gps_from_week

# RTKLIB's quality codes (manual 2.4.2, appendix B.1)
FIX_OF_QUALITY = {1: FIX_FIXED, 2: FIX_FLOAT, 3: FIX_DGNSS, 4: FIX_DGNSS, 5: FIX_SINGLE, 6: FIX_PPP}
QUALITY_OF_FIX = {FIX_FIXED: 1, FIX_FLOAT: 2, FIX_DGNSS: 4, FIX_SINGLE: 5, FIX_PPP: 6}
# m; least sigma: the file's last digit
LEAST_SIGMA = 1e-4
HEAD = (
    "%  GPST                      latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   "
    "sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio    vn(m/s)    ve(m/s)    vu(m/s)"
    "      sdvn     sdve     sdvu    sdvne    sdveu    sdvun"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PpkSolution:
    """Fixes of the rover's antenna, and what stands beside them.

    Parameters
    ----------
    events
        Marks of the rover's RINEX file (flag 5); None where it has none.
    ratio, age
        RTKLIB's, one per fix; - and s.
    base_geo
        Antenna of the base, (lat, lon rad, ellipsoidal height m); None where RTKLIB averaged it
        or for single point positions.
    datum
        Of the base's place and so of all positions, as the user states it.
    program
        What solved, with its version.
    """

    log: GnssLog
    events: EventLog | None
    ratio: Array
    age: Array
    base_geo: Array | None
    datum: str
    program: str

    @property
    def fixed_share(self) -> float:
        """Share of the fixes whose ambiguities are integers."""
        return float(np.mean(self.log.fix == FIX_FIXED))


def pos_rows(text: str, source: str) -> Array:
    """Numbers of a `.pos` text with week and time of week, shape (n, 15 or 24)."""
    lines = [line for line in text.splitlines() if line.strip() and line[0] != "%"]
    width = len(lines[0].split()) if lines else 0
    try:
        rows = np.array([[float(cell) for cell in line.split()] for line in lines])
    except ValueError as error:
        raise InputError(f"RTKLIB's solution cannot be read: {error}", source=source) from error
    if rows.ndim != 2 or width not in (15, 24):
        raise InputError(f"RTKLIB's solution has {width} columns, not 15 or 24", source=source)
    return rows[np.all(np.isfinite(rows), axis=1)]


def covariance_ned(sd: Array) -> Array:
    """Covariances of (sdn, sde, sdu, sdne, sdeu, sdun); shape (n, 6) -> (n, 3, 3), ned.

    Notes
    -----
    RTKLIB writes the square root of the size of a covariance under the covariance's sign. Four
    digits can break what belongs together, so that eigenvalues are kept above zero.
    """
    n, e, u, ne, eu, un = (np.sign(c) * c**2 for c in sd.T)
    out = np.empty((len(sd), 3, 3))
    out[:, 0, 0], out[:, 1, 1], out[:, 2, 2] = n, e, u
    out[:, 0, 1] = out[:, 1, 0] = ne
    out[:, 1, 2] = out[:, 2, 1] = -eu
    out[:, 0, 2] = out[:, 2, 0] = -un
    values, vectors = np.linalg.eigh(out)
    values = np.maximum(values, LEAST_SIGMA**2)
    return np.asarray(vectors * values[:, None, :] @ np.swapaxes(vectors, -1, -2))


def signed_roots(covariance: Array) -> Array:
    """RTKLIB's six columns of covariances in ned; shape (n, 3, 3) -> (n, 6)."""
    c = covariance
    terms = np.stack(
        [c[:, 0, 0], c[:, 1, 1], c[:, 2, 2], c[:, 0, 1], -c[:, 1, 2], -c[:, 0, 2]], axis=-1
    )
    return np.asarray(np.sign(terms) * np.sqrt(np.abs(terms)))


def log_of_rows(rows: Array, source: str) -> GnssLog:
    """Fixes of the antenna as RTKLIB gives them; velocities where it has them."""
    count = len(rows)
    v_ned, covariance_v = unknown(count, 3), unknown(count, 3, 3)
    if rows.shape[1] == 24:
        known = np.all(rows[:, 18:21] > 0.0, axis=1)
        v_ned[known] = rows[known, 15:18] * [1.0, 1.0, -1.0]
        covariance_v[known] = covariance_ned(rows[known, 18:24])
    return GnssLog(
        time=np.array([gps_from_week(int(week), tow) for week, tow in rows[:, :2]]),
        source=source,
        lat=np.radians(rows[:, 2]),
        lon=np.radians(rows[:, 3]),
        height=rows[:, 4].copy(),
        height_kind=HeightKind.ELLIPSOIDAL,
        geoid_separation=unknown(count),
        v_ned=v_ned,
        covariance_ned=covariance_ned(rows[:, 7:13]),
        covariance_v_ned=covariance_v,
        fix=np.array([FIX_OF_QUALITY.get(int(q), FIX_NONE) for q in rows[:, 5]], dtype=np.int64),
        satellites=rows[:, 6].astype(np.int64),
    )


def write_pos(file: Path, solution: PpkSolution, *, inputs: tuple[Path, ...] = ()) -> None:
    """Write a solution as a `.pos` file, whole or not at all.

    Times are GPS time with microseconds (RTKLIB's usual milliseconds are a centimetre at 20 m/s),
    heights ellipsoidal, sigmas those of the log.

    Raises
    ------
    InputError
        If the place cannot be written to.
    """
    lines = [f"% program   : georef_gis with {solution.program}"]
    lines += [f"% inp file  : {path.name}" for path in inputs]
    lines.append(f"% datum     : {solution.datum} (that of the base)")
    if solution.base_geo is not None:
        lat, lon, h = solution.base_geo
        lines.append(f"% ref pos   :{math.degrees(lat):14.9f} {math.degrees(lon):14.9f} {h:10.4f}")
    lines += [f"% doubt     : {doubt}" for doubt in solution.log.doubts]
    lines += [
        "%",
        "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
        "ns=# of satellites)",
        HEAD,
    ]
    lines += [_row(solution, i) for i in range(len(solution.log))]
    part = file.with_name(f"{file.name}.part")
    try:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
        os.replace(part, file)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", source=str(file)) from error
    finally:
        part.unlink(missing_ok=True)


def _row(solution: PpkSolution, i: int) -> str:
    log = solution.log
    # Whole microseconds, so that 59.9999996 s does not become 60.
    day = GPS_ZERO + timedelta(microseconds=round(float(log.time[i]) * 1e6))
    sd = signed_roots(log.covariance_ned[i : i + 1])[0]
    line = (
        f"{day:%Y/%m/%d %H:%M:%S.%f} {math.degrees(log.lat[i]):14.9f} "
        f"{math.degrees(log.lon[i]):14.9f} {log.height[i]:10.4f} "
        f"{QUALITY_OF_FIX.get(int(log.fix[i]), 0):3d} {int(log.satellites[i]):3d} "
        + " ".join(f"{v:8.4f}" for v in sd)
        + f" {solution.age[i]:6.2f} {solution.ratio[i]:6.1f}"
    )
    if np.all(np.isfinite(log.v_ned[i])):
        v = log.v_ned[i] * [1.0, 1.0, -1.0]
        sdv = signed_roots(log.covariance_v_ned[i : i + 1])[0]
        line += "".join(f" {x:10.5f}" for x in v) + "".join(f" {x:8.5f}" for x in sdv)
    else:
        # A sigma of nothing is RTKLIB's "no velocity".
        line += "".join(f" {0.0:10.5f}" for _ in range(3)) + "".join(f" {0.0:8.5f}" for _ in sd)
    return line
