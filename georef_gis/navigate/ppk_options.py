"""How carrier-phase differential positions are to be solved."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from georef_gis.errors import InputError
from georef_gis.geodesy import Datum, Height

# RTKLIB's names of systems, and the letters of RINEX
SYSTEMS = {"GPS": "G", "GLO": "R", "GAL": "E", "CMP": "C", "QZS": "J"}


@dataclass(frozen=True, slots=True, kw_only=True)
class BasePosition:
    """Place of the base: lat, lon rad and a height of a kind; of its marker or its antenna."""

    lat: float
    lon: float
    height: Height
    datum: Datum = field(default_factory=Datum)
    of: Literal["marker", "antenna"] = "marker"


@dataclass(frozen=True, slots=True, kw_only=True)
class PpkOptions:
    """How to solve.

    Parameters
    ----------
    base
        Where the base stands: a place, "header" (of its RINEX file) or "single" (average of its
        single point positions: metres off, the same for the whole flight).
    base_antenna_up
        Antenna over the marker, m; None takes delta H of the header.
    frequency
        "auto" takes L2 where both files have it.
    elevation_mask : rad
    direction
        "combined" runs forward and backward and joins them.
    fix, hold
        Whether ambiguities are fixed to integers; whether a fix is held for later epochs.
    ratio
        Of the second best to the best integers, from which a fix is taken.
    dynamics, acceleration_noise
        Constant-acceleration filter, and its horizontal and vertical noise, m/s2/s^0.5. Without
        it epochs are independent, which a later IMU filter prefers.
    code_sigma, phase_sigma : m, of one measurement at the zenith
        The code's stands for multipath of minutes, which RTKLIB takes for white noise: with
        0.3 m it fixes less and trusts its float more.
    max_age
        Oldest measurement of the base that is used, s.
    single_band_satellites
        Least number for a fix on one frequency: below it a wrong one passes the ratio test, and
        what claims to be fixed is taken as float.
    sigma_scale, float_sigma_scale
        Factors on RTKLIB's sigmas: of fixed and float positions, and of float ones besides. The
        passes use each epoch twice, and errors that last minutes are not white (docs/ppk.md).
    timeout : s
    """

    base: BasePosition | Literal["header", "single"] = "header"
    base_antenna_up: float | None = None
    frequency: Literal["auto", "L1", "L1+L2"] = "auto"
    systems: tuple[str, ...] = tuple(SYSTEMS)
    elevation_mask: float = math.radians(15.0)
    direction: Literal["forward", "backward", "combined"] = "combined"
    fix: bool = True
    hold: bool = False
    ratio: float = 3.0
    dynamics: bool = False
    acceleration_noise: tuple[float, float] = (3.0, 1.0)
    phase_sigma: float = 0.003
    code_sigma: float = 1.0
    max_age: float = 30.0
    single_band_satellites: int = 6
    sigma_scale: float = 1.25
    float_sigma_scale: float = 4.0
    timeout: float = 3600.0


def check_options(options: PpkOptions) -> None:
    """Refuse options that RTKLIB would take without a word.

    Raises
    ------
    InputError
        If a value is out of its range.
    """
    for name in options.systems:
        if name not in SYSTEMS:
            raise InputError(f"{name!r} is no system; use {', '.join(SYSTEMS)}", field="systems")
    limits = {"sigma_scale": options.sigma_scale, "float_sigma_scale": options.float_sigma_scale,
              "phase_sigma": options.phase_sigma, "code_sigma": options.code_sigma,
              "ratio": options.ratio, "timeout": options.timeout}  # fmt: skip
    for name, value in limits.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{value} must be above zero", field=name)
    if not 0.0 <= options.elevation_mask < math.radians(60.0):
        degrees = math.degrees(options.elevation_mask)
        raise InputError(f"{degrees:.1f} deg must be in 0 to 60 deg", field="elevation_mask")
