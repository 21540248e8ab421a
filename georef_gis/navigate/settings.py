"""What the navigation believes of its sensors: one sigmas, SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from georef_gis.frames import Array

_HOUR = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuNoise:
    """Errors of a consumer MEMS unit, as it comes; see `docs/navigation.md`.

    Parameters
    ----------
    gyro_walk, accel_walk : rad/s/sqrt(Hz), m/s2/sqrt(Hz)
        White noise: 0.3 deg/sqrt(h) and 0.1 m/s/sqrt(h).
    gyro_bias, accel_bias : rad/s, m/s2
        Turn-on biases: 1000 deg/h and 0.15 m/s2 (15 mg).
    gyro_bias_walk, accel_bias_walk : rad/s/sqrt(s), m/s2/sqrt(s)
        Random walk of the biases.
    scale, misalignment
        Of the gyro, a pure number and rad; both 0 = not estimated. Misalignment is against the
        accelerometers, which are what "body" means.
    """

    gyro_walk: float = math.radians(0.3) / 60.0
    accel_walk: float = 0.1 / 60.0
    gyro_bias: float = math.radians(1000.0) / _HOUR
    accel_bias: float = 0.15
    gyro_bias_walk: float = math.radians(5.0) / _HOUR / 60.0
    accel_bias_walk: float = 0.001 / 60.0
    scale: float = 0.005
    misalignment: float = math.radians(0.3)

    @property
    def scaled(self) -> bool:
        """Whether the gyro's scale and misalignment are estimated."""
        return self.scale > 0.0 or self.misalignment > 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class NavigationSettings:
    """Settings of a run.

    Parameters
    ----------
    lever_arm_body_antenna : shape (3,), m
        IMU to antenna.
    slow_sigma : m or None
        Slow GNSS error per axis that no filter removes; None = what the fixes' stated sigma
        leaves beside their measured scatter. 0 = all error is white.
    slow_tau : s
        Its correlation time.
    gate
        Probability with which a good fix is refused.
    reacquire : s
        After so long without an accepted fix the next is believed.
    node_gap : s
        Longest step between two nodes of the smoother.
    imu_gap : s
        A longer gap of the IMU is refused by `Trajectory`; a shorter one costs accuracy.
    baro_sigma, baro_tau : m, s
        Offset of a barometric height, which wanders.
    wind_sigma, wind_tau : m/s, s
        Per axis, for airspeed.
    """

    imu: ImuNoise = field(default_factory=ImuNoise)
    lever_arm_body_antenna: Array = field(default_factory=lambda: np.zeros(3))
    slow_sigma: float | None = None
    slow_tau: float = 100.0
    gate: float = 0.001
    reacquire: float = 10.0
    node_gap: float = 0.2
    imu_gap: float = 0.5
    baro_sigma: float = 20.0
    baro_tau: float = 3600.0
    wind_sigma: float = 5.0
    wind_tau: float = 600.0
