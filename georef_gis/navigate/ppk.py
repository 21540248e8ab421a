"""Carrier-phase differential positions (PPK) of a rover and a base, by RTKLIB.

RTKLIB 2.4.3 (through pyrtklib) solves; here its inputs are checked, its process is guarded, and
its answer becomes a `GnssLog` of the rover's antenna. The place is in the datum of the base.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.ellipsoid import ecef_from_geo, geo_from_ecef
from georef_gis.errors import InputError
from georef_gis.frames import Array, R_ecef_from_enu
from georef_gis.model.logs import FIX_FIXED, FIX_FLOAT, EventLog, GnssLog, unknown
from georef_gis.navigate.ppk_files import (
    Observations,
    kind_of,
    read_ephemeris_times,
    read_observations,
    unpacked,
)
from georef_gis.navigate.ppk_options import (
    SYSTEMS,
    BasePosition,
    PpkOptions,
    check_options,
)
from georef_gis.navigate.ppk_pos import PpkSolution, log_of_rows, pos_rows, write_pos
from georef_gis.navigate.ppk_process import run_worker
from georef_gis.units import utc_from_gps

__all__ = ["BasePosition", "PpkOptions", "PpkSolution", "run_ppk", "solve_ppk", "write_pos"]

# s that broadcast elements are good for, on either side, with a margin
EPHEMERIS_AGE = 3.0 * 3600.0
# m; farther than this the air over the two differs by more than single-frequency phase allows
LONG_BASELINE = 15e3
# m, horizontal and vertical; of a fix that is not believed: a few wavelengths
DISPUTED_SIGMA = (0.5, 1.0)
# s; marks are in the receiver's clock, whose offset (up to 1 ms) RTKLIB takes from positions only
EVENT_SIGMA = 1e-3


def solve_ppk(
    rover: Path, base: Path, nav: Sequence[Path], options: PpkOptions | None = None
) -> GnssLog:
    """Fixes of the rover's antenna; see `run_ppk`, which gives its marks and RTKLIB's figures too.

    Raises
    ------
    InputError
        If the files do not fit, or RTKLIB finds nothing.
    """
    return run_ppk(rover, base, nav, options).log


def run_ppk(
    rover: Path,
    base: Path | None,
    nav: Sequence[Path],
    options: PpkOptions | None = None,
    *,
    check: Callable[[], None] = lambda: None,
) -> PpkSolution:
    """Positions of the rover's antenna.

    Parameters
    ----------
    rover, base
        RINEX 2 or 3 observations or UBX with RXM-RAWX, also gzipped. Without a base the positions
        are single points (metres), for comparison.
    nav
        RINEX navigation files; a UBX rover with RXM-SFRBX needs none.
    check
        Called some times a second while RTKLIB works; may raise, which ends it.
    """
    options = options or PpkOptions()
    if util.find_spec("pyrtklib") is None:
        raise InputError("PPK needs pyrtklib; pip install georef-gis[logs]", source=str(rover))
    check_options(options)
    with tempfile.TemporaryDirectory(prefix="georef_ppk_") as name:
        folder = Path(name)
        job = _Job(folder, options, check)
        return job.run(rover, base, nav)


class _Job:
    """One run in one temporary folder."""

    def __init__(self, folder: Path, options: PpkOptions, check: Callable[[], None]) -> None:
        self.folder, self.options, self.check = folder, options, check
        self.doubts: list[str] = []
        self.bands = 1

    def run(self, rover: Path, base: Path | None, nav: Sequence[Path]) -> PpkSolution:
        if base is not None and rover.exists() and base.exists() and rover.samefile(base):
            raise InputError("is given as rover and as base", source=str(rover))
        rover_obs, found = self._observations(rover, "rover")
        base_obs = None
        if base is not None:
            base_obs, more = self._observations(base, "base")
            found += more
            self._check_pair(rover_obs, base_obs, rover, base)
        navigation = [unpacked(file, self.folder) for file in nav] + found
        self._check_navigation(rover_obs, base_obs, navigation, rover)
        place = None
        if base_obs is not None and base is not None:
            place = self._base_antenna(base_obs, base)
        text, program = self._solve(rover_obs, base_obs, navigation, place)
        return self._solution(text, program, rover, rover_obs, place)

    def _observations(self, file: Path, role: str) -> tuple[Observations, list[Path]]:
        """Scan of a file (converted if need be), and navigation files that came out of it."""
        plain = unpacked(file, self.folder)
        if kind_of(plain) != "ubx":
            return read_observations(plain, name=file), []
        obs, nav = self.folder / f"{role}_ubx.obs", self.folder / f"{role}_ubx.nav"
        raw = self._plain_name(plain, f"{role}.ubx")
        self._work({"task": "convert", "raw": raw, "obs": str(obs), "nav": str(nav)}, file)
        if not obs.exists() or obs.stat().st_size == 0:
            raise InputError(
                "has no raw measurements (RXM-RAWX); log them, or convert by hand with convbin",
                source=str(file),
            )
        has_nav = nav.exists() and bool(read_ephemeris_times(nav))
        return read_observations(obs, name=file), [nav] if has_nav else []

    def _check_pair(self, rover: Observations, base: Observations, *files: Path) -> None:
        if rover.first > base.last or base.first > rover.last:
            raise InputError(
                f"does not overlap {files[1].name} in time: {_span(rover)} against {_span(base)}; "
                "take the base's file of the flight",
                source=str(files[0]),
            )
        outside = max(base.first - rover.first, 0.0) + max(rover.last - base.last, 0.0)
        if outside > self.options.max_age:
            self.doubts.append(f"{outside:.0f} s of the rover lie outside the base's time")
        if not self._used(rover.satellites) & self._used(base.satellites):
            raise InputError(
                f"has no satellite in common with {files[1].name} "
                f"(systems {', '.join(self.options.systems)})",
                source=str(files[0]),
            )

    def _used(self, satellites: frozenset[str]) -> set[str]:
        letters = {SYSTEMS[name] for name in self.options.systems}
        return {name for name in satellites if name[0] in letters}

    def _check_navigation(
        self, rover: Observations, base: Observations | None, nav: Sequence[Path], source: Path
    ) -> None:
        if not nav:
            raise InputError(
                "no navigation file is given; add the broadcast ephemerides of the day "
                "(BRDC...rnx), or the receiver's own",
                source=str(source),
            )
        wanted = self._used(rover.satellites)
        if base is not None:
            wanted &= self._used(base.satellites)
        good = set()
        for file in nav:
            for name, times in read_ephemeris_times(file).items():
                near = (
                    rover.first - EPHEMERIS_AGE <= t <= rover.last + EPHEMERIS_AGE for t in times
                )
                if name in wanted and any(near):
                    good.add(name)
        if len(good) < 4:
            raise InputError(
                f"the navigation files have elements of {len(good)} of {len(wanted)} satellites "
                f"for {_span(rover)}; take the file of that day",
                source=str(nav[0]),
            )

    def _base_antenna(self, scan: Observations, file: Path) -> Array | None:
        """Antenna of the base (lat, lon rad, ellipsoidal height m); None to let RTKLIB average."""
        given = self.options.base
        if given == "single":
            self.doubts.append(
                "the base stands where its single point positions average: all positions share "
                "an error of metres"
            )
            return None
        up = (
            scan.antenna_up
            if self.options.base_antenna_up is None
            else self.options.base_antenna_up
        )
        if isinstance(given, BasePosition):
            geo = np.array([given.lat, given.lon, 0.0])
            geo[2] = given.height.ellipsoidal(given.lat, given.lon)
            if scan.marker_ecef is not None:
                off = float(np.linalg.norm(scan.marker_ecef - ecef_from_geo(geo)))
                if off > 100.0:
                    self.doubts.append(
                        f"the base's given place lies {off:.0f} m from that of its header"
                    )
            if not given.datum.is_known:
                self.doubts.append("the datum of the base's place is not stated")
            if given.of == "antenna":
                return geo
        elif scan.marker_ecef is None:
            raise InputError(
                "the header has no position of the base; give its coordinates, or let them be "
                "averaged (base position 'single')",
                source=str(file),
                field="APPROX POSITION XYZ",
            )
        else:
            geo = geo_from_ecef(scan.marker_ecef)
            self.doubts.append(
                "the base's place is the approximate one of its header: check that it is surveyed, "
                "and in which datum"
            )
        delta = np.array([scan.antenna_east, scan.antenna_north, up])
        return geo_from_ecef(ecef_from_geo(geo) + R_ecef_from_enu(geo[0], geo[1]) @ delta)

    # -----------------------------------------------------------------------------------------
    # RTKLIB's process
    # -----------------------------------------------------------------------------------------

    def _plain_name(self, file: Path, name: str) -> str:
        """A name that RTKLIB cannot take for a pattern, an archive or a keyword."""
        target = self.folder / name
        try:
            target.symlink_to(file.resolve())
        except OSError:
            shutil.copyfile(file, target)
        return str(target)

    def _solve(
        self,
        rover: Observations,
        base: Observations | None,
        nav: Sequence[Path],
        place: Array | None,
    ) -> tuple[str, str]:
        o = self.options
        both = rover.bands[1] and (base is None or base.bands[1])
        bands = 1 if o.frequency == "L1" or (o.frequency == "auto" and not both) else 2
        if bands == 2 and not both:
            raise InputError("rover and base have no L2 both; use L1", field="frequency")
        self.bands = bands
        out = self.folder / "out.pos"
        job = {
            "task": "solve",
            "rover": self._plain_name(rover.file, "rover.obs"),
            "base": self._plain_name(base.file, "base.obs") if base else "",
            "nav": [self._plain_name(file, f"nav{i}.nav") for i, file in enumerate(nav)],
            "out": str(out),
            "direction": ("forward", "backward", "combined").index(o.direction) if base else 0,
            "bands": bands,
            "systems": list(o.systems),
            "elevation_mask_deg": math.degrees(o.elevation_mask),
            "dynamics": o.dynamics,
            "accel_noise": list(o.acceleration_noise),
            "fix": o.fix,
            "hold": o.hold,
            "ratio": o.ratio,
            "max_age_s": o.max_age,
            "phase_sigma_m": o.phase_sigma,
            "code_phase_ratio": o.code_sigma / o.phase_sigma,
            "base_ecef": None if place is None else ecef_from_geo(place).tolist(),
        }
        done = self._work(job, rover.file)
        text = out.read_text(encoding="ascii", errors="replace") if out.exists() else ""
        if not any(line and line[0] != "%" for line in text.splitlines()):
            said = self._trace(out)
            raise InputError(f"RTKLIB finds no position{said}", source=str(rover.file))
        return text, f"RTKLIB {done['version']}"

    def _trace(self, out: Path) -> str:
        """RTKLIB's last word, if it left one."""
        trace = Path(f"{out}.trace")
        lines = trace.read_text(errors="replace").split("\n") if trace.exists() else []
        lines = [line.strip() for line in lines if line.strip()]
        if lines:
            return f": {lines[-1][:120]}"
        return " (too few common satellites above the elevation mask, or no usable ephemeris)"

    def _work(self, job: dict[str, Any], source: Path) -> dict[str, Any]:
        timeout = self.options.timeout
        return run_worker(job, self.folder, source, timeout=timeout, check=self.check)

    # -----------------------------------------------------------------------------------------
    # Its answer
    # -----------------------------------------------------------------------------------------

    def _solution(
        self, text: str, program: str, rover: Path, scan: Observations, place: Array | None
    ) -> PpkSolution:
        rows = pos_rows(text, str(rover))
        log = self._scaled(log_of_rows(rows, str(rover)), rows[:, 14])
        self._judge(log, scan, place)
        given = self.options.base
        return PpkSolution(
            log=replace(log, doubts=tuple(self.doubts)),
            events=_events(scan, rover),
            ratio=rows[:, 14],
            age=rows[:, 13],
            base_geo=place,
            datum=str(given.datum) if isinstance(given, BasePosition) else "unknown",
            program=program,
        )

    def _scaled(self, log: GnssLog, ratio: Array) -> GnssLog:
        """With the sigmas that the options and the two passes ask for."""
        o = self.options
        scale = np.ones(len(log))
        scale[(log.fix == FIX_FIXED) | (log.fix == FIX_FLOAT)] = o.sigma_scale
        scale[log.fix == FIX_FLOAT] *= o.float_sigma_scale
        covariance = log.covariance_ned * scale[:, None, None] ** 2
        # RTKLIB calls it float when its passes fix to unequal integers, but leaves the sigma of a
        # fix; the ratio gives it away.
        disputed = (log.fix == FIX_FLOAT) & (ratio >= o.ratio) & o.fix
        self._distrust(covariance, disputed, "forward and backward disagree")
        few = (log.fix == FIX_FIXED) & (log.satellites < o.single_band_satellites)
        if self.bands > 1:
            few[:] = False
        self._distrust(covariance, few, f"L1 has fewer than {o.single_band_satellites} satellites")
        return replace(log, covariance_ned=covariance, fix=np.where(few, FIX_FLOAT, log.fix))

    def _distrust(self, covariance: Array, rows: NDArray[np.bool_], why: str) -> None:
        if np.any(rows):
            h, v = DISPUTED_SIGMA
            covariance[rows] += np.diag([h**2, h**2, v**2])
            self.doubts.append(f"{np.count_nonzero(rows)} fixes not believed ({h} m): {why}")

    def _judge(self, log: GnssLog, scan: Observations, place: Array | None) -> None:
        if len(log) < 0.9 * scan.epochs:
            self.doubts.append(f"{scan.epochs - len(log)} of {scan.epochs} epochs have no position")
        if place is None:
            return
        fixed = float(np.mean(log.fix == FIX_FIXED))
        if fixed < 0.9 and self.options.fix:
            self.doubts.append(f"only {100 * fixed:.0f} % of the positions are fixed")
        start = ecef_from_geo(np.array([log.lat[0], log.lon[0], log.height[0]]))
        baseline = float(np.linalg.norm(start - ecef_from_geo(place)))
        if baseline > LONG_BASELINE:
            self.doubts.append(f"the base is {baseline / 1e3:.0f} km away")


def _span(scan: Observations) -> str:
    first, last = utc_from_gps(scan.first), utc_from_gps(scan.last)
    return f"{first:%Y-%m-%d %H:%M:%S} to {last:%Y-%m-%d %H:%M:%S} UTC"


def _events(scan: Observations, rover: Path) -> EventLog | None:
    count = len(scan.events)
    if not count:
        return None
    return EventLog(
        time=np.array(scan.events), source=str(rover), kind="feedback",
        sequence=np.full(count, -1, dtype=np.int64), sigma=np.full(count, EVENT_SIGMA),
        lat=unknown(count), lon=unknown(count), height=unknown(count),
        covariance_ned=unknown(count, 3, 3), rpy=unknown(count, 3),
        names=("",) * count, flags=np.full(count, -1, dtype=np.int64),
    )  # fmt: skip
