"""What a simulated flight is made of: camera, lines and the one-sigmas of every error source."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

VectorOf3 = tuple[float, float, float]

CEP_FROM_SIGMA = 1.1774100225154747  # sqrt(2 ln 2): radius holding half of a circular normal


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTruth:
    """True interior orientation, pixels of the stored image, OpenCV's direction.

    Rebel XTi (22.2 x 14.8 mm, 3888 x 2592) at 18 mm, reduced to a third: nominal focal length
    1050.8 px. (0, 0) is the centre of the first pixel.
    """

    width: int = 1296
    height: int = 864
    fx: float = 1043.40
    fy: float = 1043.40
    cx: float = 657.10
    cy: float = 424.30
    k1: float = -0.1620
    k2: float = 0.1080
    k3: float = -0.0210
    p1: float = 0.00060
    p2: float = -0.00040


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightLine:
    """A straight row of photos in the road's coordinates.

    Parameters
    ----------
    along, across
        Middle of the row in metres along the road and left of it.
    heading_deg
        Direction of flight, counter-clockwise from the road's direction.
    height
        Above the site origin's ground, m.
    photos, base
        Number of photos, and metres between two.
    """

    along: float
    across: float
    heading_deg: float
    height: float
    photos: int
    base: float


DEFAULT_LINES = (
    FlightLine(along=2.0, across=-10.0, heading_deg=0.0, height=56.0, photos=5, base=20.0),
    FlightLine(along=24.0, across=0.0, heading_deg=90.0, height=86.0, photos=3, base=30.0),
    FlightLine(along=2.0, across=10.0, heading_deg=180.0, height=62.0, photos=5, base=20.0),
    FlightLine(along=-26.0, across=0.0, heading_deg=270.0, height=76.0, photos=3, base=30.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightSettings:
    """Everything the simulator can be asked for; sigmas are one standard deviation.

    Parameters
    ----------
    speed, wind_sigma
        Ground speed and each horizontal component of the wind, m/s. The wind makes the crab angle
        that a yaw taken from the GPS course misses.
    roll_sigma_deg, pitch_sigma_deg, yaw_sigma_deg, turbulence_tau
        Attitude in turbulence about trim, with its correlation time in s.
    gnss
        ``"coloured"``: white plus Gauss-Markov; ``"white"``: white with `gnss_cep` only.
    gnss_white, gnss_markov, gnss_tau, gnss_cep, gnss_velocity
        Per axis m, m, s; circular error probable in m; m/s.
    gyro_scale_percent, gyro_misalignment_deg
        One sigma of each gyro's scale, and of each of the six angles between the axes of gyros
        and accelerometers, which are what "body" means.
    tag_position
        Position in the tag: ``"last_fix"`` (up to one fix old) or ``"at_exposure"``.
    attitude_tag
        ``"camera"``: Pix4D ``Camera`` XMP; ``"none"``.
    attitude_sigma_deg, attitude_tau
        Autopilot's roll, pitch error, and yaw error beside the crab angle; 0 s is white.
    trigger_sigma
        Jitter of the sync board's time, s.
    mark_sigma
        Pixel marks, px.
    """

    camera: CameraTruth = CameraTruth()
    lines: tuple[FlightLine, ...] = DEFAULT_LINES
    speed: float = 20.0
    lead_in: float = 8.0
    turn_radius: float = 55.0
    wind_sigma: float = 1.5
    pitch_trim_deg: float = 2.5
    roll_sigma_deg: float = 3.0
    pitch_sigma_deg: float = 2.0
    yaw_sigma_deg: float = 1.2
    turbulence_tau: float = 0.9
    path_sigma: float = 0.6

    gnss: Literal["coloured", "white"] = "coloured"
    gnss_rate: float = 5.0
    gnss_white: float = 0.7
    gnss_markov: float = 2.0
    gnss_tau: float = 100.0
    gnss_cep: float = 2.5
    gnss_velocity: float = 0.1

    imu_rate: float = 100.0
    gyro_bias_deg_h: float = 100.0
    gyro_walk_deg_rt_h: float = 0.3
    accel_bias: float = 0.030
    accel_walk_rt_h: float = 0.1
    gyro_scale_percent: float = 0.0
    gyro_misalignment_deg: float = 0.0

    lever_arm_camera: VectorOf3 = (0.15, 0.02, 0.08)
    lever_arm_antenna: VectorOf3 = (-0.25, 0.0, -0.12)
    lever_arm_sigma: float = 0.01
    boresight_sigma_deg: float = 1.0

    tag_position: Literal["last_fix", "at_exposure"] = "last_fix"
    attitude_tag: Literal["camera", "none"] = "camera"
    attitude_sigma_deg: float = 1.5
    attitude_tau: float = 15.0

    clock_offset_sigma: float = 20.0
    clock_drift_sigma: float = 20e-6
    trigger_sigma: float = 0.001
    missed_triggers: int = 1
    spurious_triggers: int = 1

    control_sigma_h: float = 0.02
    control_sigma_v: float = 0.03
    mark_sigma: float = 0.3
    dem_sigma: float = 0.10

    @property
    def gnss_sigma(self) -> float:
        """One sigma of a fix on each axis, m, all parts together."""
        if self.gnss == "white":
            return self.gnss_cep / CEP_FROM_SIGMA
        return math.hypot(self.gnss_white, self.gnss_markov)

    @property
    def tag_sigma_h(self) -> float:
        """Root mean square of the tag's position on a horizontal axis, m, with its age."""
        age = self.speed / self.gnss_rate / math.sqrt(3.0) if self.tag_position == "last_fix" else 0
        return math.hypot(self.gnss_sigma, age / math.sqrt(2.0))

    @property
    def tag_sigma_v(self) -> float:
        """Root mean square of the tag's height, m."""
        return self.gnss_sigma

    @property
    def tag_sigma_yaw_deg(self) -> float:
        """Root mean square of the tag's yaw, deg: crab, turbulence in yaw, autopilot."""
        crab = math.degrees(math.atan2(self.wind_sigma, self.speed))
        return math.sqrt(crab**2 + self.yaw_sigma_deg**2 + self.attitude_sigma_deg**2)
