"""The flight in time: `gx:Track` with angles and sigmas, from its trajectory or its photos."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exports.kml import elements as k
from exports.site.columns import Layer
from georef_gis.errors import ExportError
from georef_gis.frames import Array
from georef_gis.geodesy import geoid_undulation
from georef_gis.units import GPS_WEEK, gps_from_utc, utc_from_gps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from georef_gis.project import Project

# In the project's folder `navigation`, as `georef navigate` writes it
TABLE = "trajectory.csv"
# s; the trajectory is parted where nothing was logged for so long
GAP_S = 2.0
SCHEMA_ID = "schema-flight"
# Name, unit, meaning of what is told of every sample; the order of the columns of `Flown.values`
FIELDS = (
    ("speed_m_s", "m/s", "Speed over ground"),
    ("roll_deg", "deg", "Roll, right side down positive"),
    ("pitch_deg", "deg", "Pitch, nose up positive"),
    ("yaw_deg", "deg", "Heading, clockwise from true north"),
    ("height_ellipsoidal_m", "m", "Height above the WGS 84 ellipsoid"),
    ("sigma_e_m", "m", "One sigma of the place towards east"),
    ("sigma_n_m", "m", "One sigma of the place towards north"),
    ("sigma_u_m", "m", "One sigma of the height"),
    ("sigma_roll_deg", "deg", "One sigma of roll"),
    ("sigma_pitch_deg", "deg", "One sigma of pitch"),
    ("sigma_yaw_deg", "deg", "One sigma of yaw"),
)
_NAMES = tuple(name for name, _, _ in FIELDS)
_COLUMNS = {
    "roll_deg": "roll_deg", "pitch_deg": "pitch_deg", "yaw_deg": "yaw_deg",
    "height_ellipsoidal_m": "height_ellipsoidal_m", "sigma_e_m": "sigma_east_m",
    "sigma_n_m": "sigma_north_m", "sigma_u_m": "sigma_down_m",
    "sigma_roll_deg": "sigma_roll_deg", "sigma_pitch_deg": "sigma_pitch_deg",
    "sigma_yaw_deg": "sigma_yaw_deg",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flown:
    """Samples of a flight in order of time.

    Parameters
    ----------
    time : shape (n,)
        s on the GPS scale since 1980-01-06.
    lonlat : shape (n, 2)
        deg.
    height : shape (n,)
        m above EGM96.
    values : shape (n, 11)
        As `FIELDS` names them; NaN where not known.
    gap : s
        The track is parted where samples are farther apart.
    """

    name: str
    said: str
    time: Array
    lonlat: Array
    height: Array
    values: Array
    gap: float

    def thinned(self, rate: float, most: int | None = None) -> Flown:
        """At most `rate` samples a second, and at most about `most` in all."""
        if len(self.time) < 2:
            return self
        span = float(self.time[-1] - self.time[0])
        step = 1.0 / rate
        if most is not None:
            step = max(step, span / max(most - 1, 1))
        # half a usual step of tolerance: a 10 Hz log is not thinned to 1.7 Hz for 2 Hz
        usual = float(np.median(np.diff(self.time)))
        keep, last = [0], float(self.time[0])
        for i, t in enumerate(self.time.tolist()):
            if t - last >= step - 0.5 * usual - 1e-6:
                keep.append(i)
                last = t
        return self.at(np.unique([*keep, len(self.time) - 1]))

    def at(self, rows: NDArray[np.intp]) -> Flown:
        """Some samples."""
        return replace(
            self, time=self.time[rows], lonlat=self.lonlat[rows], height=self.height[rows],
            values=self.values[rows],
        )  # fmt: skip

    def parts(self) -> list[Flown]:
        """The same without its gaps; parts of one sample are left out."""
        at = np.flatnonzero(np.diff(self.time) > self.gap) + 1
        runs = np.split(np.arange(len(self.time)), at)
        return [self.at(run) for run in runs if len(run) > 1]


def _usual_step(time: Array) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


# -- where it is from ---------------------------------------------------------------------------


def flights(project: Project | None, photos: Layer) -> tuple[list[Flown], tuple[str, ...]]:
    """Flights of a project, and what to say of them: its trajectory, else its timed photos."""
    told: tuple[str, ...] = ()
    path = None if project is None else project.navigation / TABLE
    if path is not None and path.is_file():
        try:
            return [read_trajectory(path)], ()
        except ExportError as error:
            told = (f"the flight is drawn from its photos: {error}",)
    return photo_flights(photos), told


def read_trajectory(path: Path) -> Flown:
    """Flight of the table that `georef navigate` wrote.

    Raises
    ------
    ExportError
        If it cannot be read.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        head = next(i for i, line in enumerate(lines) if line and not line.startswith("#"))
        place = next((x.partition(":")[2].strip() for x in lines[:head] if "place" in x), "")
        names = lines[head].split(",")
        rows = [[float(c) if c else math.nan for c in line.split(",")]
                for line in lines[head + 1 :] if line]  # fmt: skip
        table = dict(zip(names, np.array(rows, float).T, strict=True))
        time = table["gps_week"] * GPS_WEEK + table["tow_s"]
        return _flown_of(table, time, place or "vehicle")
    except (OSError, ValueError, LookupError, StopIteration) as error:
        raise ExportError(f"{path}: cannot be read ({error}); run `georef navigate`") from error


def _flown_of(table: Mapping[str, Array], time: Array, place: str) -> Flown:
    lonlat = np.column_stack([table["lon_deg"], table["lat_deg"]])
    height = table["height_ellipsoidal_m"]
    known = np.isfinite(lonlat).all(axis=1) & np.isfinite(height) & np.isfinite(time)
    unknown = np.full(len(time), np.nan)
    values = {name: table.get(column, unknown) for name, column in _COLUMNS.items()}
    values["speed_m_s"] = np.hypot(table.get("v_north", unknown), table.get("v_east", unknown))
    lon, lat = np.radians(lonlat[known]).T
    order = np.argsort(time[known], kind="stable")
    what = {"imu": "the IMU", "antenna": "the antenna", "camera": "the camera"}
    return Flown(
        name="Trajectory",
        said=f"Place of {what.get(place, 'the vehicle')} and attitude of the vehicle, "
        "as the logs give them.",
        time=time[known][order],
        lonlat=lonlat[known][order],
        height=(height[known] - geoid_undulation(lat, lon))[order],
        values=np.column_stack([values[name] for name in _NAMES])[known][order],
        gap=GAP_S,
    )


def photo_flights(photos: Layer) -> list[Flown]:
    """Flights through the photos whose time is known in UTC; none of times that are not."""
    if not len(photos):
        return []
    get = {f.name: photos.columns[f.name].tolist() for f in photos.fields}
    groups: dict[str, list[int]] = {}
    height = photos.places.height_orthometric
    for i, (flight, stamp, kind) in enumerate(
        zip(get["flight"], get["time_utc"], get["pose_kind"], strict=True)
    ):
        if stamp and kind and np.isfinite(height[i]):
            groups.setdefault(str(flight or ""), []).append(i)
    out = []
    for flight, rows in sorted(groups.items()):
        found = _photo_flight(photos, get, flight, rows)
        if len(found.time) > 1:
            out.append(found)
    return out


def _photo_flight(
    photos: Layer, get: Mapping[str, Sequence[object]], flight: str, rows: Sequence[int]
) -> Flown:
    stamps = [gps_from_utc(datetime.fromisoformat(str(get["time_utc"][i]))) for i in rows]
    # Two photos at one instant would stand still for a moment and then jump.
    time, first = np.unique(stamps, return_index=True)
    index = np.array(rows)[first]
    values = np.column_stack([_numbers(get.get(name), index) for name in _NAMES])
    lonlat, height = photos.places.lonlat[index], photos.places.height_orthometric[index]
    values[:, 0] = _speed(time, lonlat)
    return Flown(
        name=f"Photos of {flight}" if flight else "Photos",
        said="Place and attitude of the camera at its photos; between them a straight line.",
        time=time, lonlat=lonlat, height=height, values=values,
        gap=max(10.0, 5.0 * _usual_step(time)),
    )  # fmt: skip


def _numbers(values: Sequence[object] | None, index: NDArray[np.intp]) -> Array:
    if values is None:
        return np.full(len(index), np.nan)
    return np.array([math.nan if values[i] is None else float(str(values[i])) for i in index])


def _speed(time: Array, lonlat: Array) -> Array:
    """Mean speed over ground to the samples around, m/s."""
    if len(time) < 2:
        return np.full(len(time), np.nan)
    # m per deg on a sphere: 0.3 % at most, of a speed that is a mean already
    scale = 111_200.0 * np.array([np.cos(np.radians(lonlat[:, 1].mean())), 1.0])
    return np.asarray(np.hypot(*np.gradient(lonlat * scale, time, axis=0).T))


# -- KML ----------------------------------------------------------------------------------------


def flight_schema() -> k.Element:
    """Declaration of what is told of every sample."""
    fields = [
        k.element("gx:SimpleArrayField", k.element("displayName", text=f"{doc}, {unit}"),
                  name=name, type="double")
        for name, unit, doc in FIELDS
    ]  # fmt: skip
    return k.element("Schema", *fields, name="flight", id=SCHEMA_ID)


def flight_placemarks(flown: Iterable[Flown], rate: float, most: int | None) -> list[k.Element]:
    """A placemark per flight, with a track per part."""
    out: list[k.Element] = []
    for one in flown:
        parts = one.parts()
        # Parted before they are thinned: each keeps its first and last sample.
        share = None if most is None else max(2, most // max(len(parts), 1))
        tracks = [_track(part.thinned(rate, share)) for part in parts]
        if not tracks:
            continue
        mode = k.element("altitudeMode", text="absolute")
        shape = tracks[0] if len(tracks) == 1 else k.element("gx:MultiTrack", mode, *tracks)
        out.append(
            k.element(
                "Placemark",
                k.element("name", text=one.name),
                k.element("description", text=one.said),
                k.element("styleUrl", text="#flight"),
                shape,
                id=f"flight-{len(out) + 1}",
            )
        )
    return out


def _track(part: Flown) -> k.Element:
    whens = [f"<when>{_utc(t)}</when>" for t in part.time.tolist()]
    coords = [
        f"<gx:coord>{x:.10f} {y:.10f} {z:.3f}</gx:coord>"
        for (x, y), z in zip(part.lonlat.tolist(), part.height.tolist(), strict=True)
    ]
    return k.element(
        "gx:Track",
        k.element("altitudeMode", text="absolute"),
        *whens,
        *coords,
        *_angles(part),
        k.element(
            "ExtendedData", k.element("SchemaData", *_arrays(part), schemaUrl=f"#{SCHEMA_ID}")
        ),
    )


def _angles(part: Flown) -> list[k.Element]:
    """Heading, tilt, roll of a model at every sample; none where one is not known.

    KML turns a model clockwise as seen from the tip of its axis (x right, y forward): tilt is
    nose down, roll is left side down.
    """
    roll, pitch, yaw = (part.values[:, _NAMES.index(f"{n}_deg")] for n in ("roll", "pitch", "yaw"))
    if not np.isfinite([roll, pitch, yaw]).all():
        return []
    rows = np.column_stack([yaw % 360.0, -pitch, -roll]).tolist()
    return [f"<gx:angles>{h:.4f} {t:.4f} {r:.4f}</gx:angles>" for h, t, r in rows]


def _arrays(part: Flown) -> list[k.Element]:
    out = []
    for i, name in enumerate(_NAMES):
        column = part.values[:, i].tolist()
        if not any(math.isfinite(v) for v in column):
            continue
        texts = "".join(
            f"<gx:value>{v:.4f}</gx:value>" if math.isfinite(v) else "<gx:value/>" for v in column
        )
        out.append(f'<gx:SimpleArrayData name="{name}">{texts}</gx:SimpleArrayData>')
    return out


def _utc(seconds_gps: float) -> str:
    return utc_from_gps(seconds_gps).isoformat(timespec="milliseconds").replace("+00:00", "Z")
