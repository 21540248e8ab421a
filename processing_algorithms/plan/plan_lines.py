"""What `plan_flight` plans with: camera, sensors, and the lines over an area or along a road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from processing_algorithms.plan.plan_place import planned_place

if TYPE_CHECKING:
    from georef_gis.ellipsoid import Origin
    from georef_gis.frames import Array
    from georef_gis.measure.budget.forecast import Sensors
    from georef_gis.measure.preflight.layout import Layout, Plan
    from georef_gis.model.camera import Camera
    from processing_algorithms.plan.parameters import PlanFlightParameters

# Lines and photos of a plan without an area: what is told does not depend on more.
NOMINAL = (5, 9)
# width of a sensor by its focal length, from a telescope's to an extreme wide angle's
WIDTHS = (0.01, 8.0)
# longer side of a photo by its shorter one
SIDES = 5.0
# of the first height: the second one where none is given
SECOND = 1.3


def planned_camera(parameters: PlanFlightParameters) -> Camera:
    """Camera of a photo, or of focal length, sensor and pixels.

    Raises
    ------
    InputError
        If they do not describe one.
    """
    from dataclasses import replace

    from georef_gis.errors import InputError
    from georef_gis.model.camera import Camera

    given = (parameters.focal, parameters.sensor_width, parameters.columns, parameters.rows)
    if parameters.photo is not None and any(value is not None for value in given):
        raise InputError(
            "is described twice: give --photo, or --focal, --sensor-width, --columns and --rows",
            source="camera",
        )
    if parameters.photo is not None:
        from georef_gis.ingest.cameras import camera_for
        from georef_gis.ingest.photos import read_photo

        photo = read_photo(parameters.photo)
        size = (photo.width, photo.height)
        camera = camera_for(photo.tags, size, source=photo.path.name).camera
    elif None in given:
        raise InputError(
            "is not described: give --photo, or --focal, --sensor-width, --columns and --rows",
            source="camera",
        )
    else:
        focal, width, columns, rows = (float(v) for v in given if v is not None)
        _check_camera(focal, width, columns, rows)
        fx = focal / width * columns
        camera = Camera(
            id="camera", width=int(columns), height=int(rows), fx=fx, fy=fx,
            cx=(columns - 1) / 2.0, cy=(rows - 1) / 2.0,
        )  # fmt: skip
    share = parameters.focal_percent / 100.0
    return replace(camera, sigma_f=share * camera.fx, sigma_c=parameters.centre_px, readout_s=0.0)


def _check_camera(focal: float, width: float, columns: float, rows: float) -> None:
    """Refuse what no camera is, such as millimetres for metres; lengths in m."""
    from georef_gis.errors import InputError

    if not WIDTHS[0] <= width / focal <= WIDTHS[1]:
        raise InputError(
            f"a sensor of {1000 * width:g} mm behind a focal length of {1000 * focal:g} mm is no "
            "camera for a plan; check the units",
            source="camera",
        )
    if not 1.0 / SIDES <= columns / rows <= SIDES:
        raise InputError(
            f"{columns:g} x {rows:g} px is no photo of a frame camera; check --columns and --rows",
            source="camera",
        )


def planned_sensors(parameters: PlanFlightParameters, camera: Camera) -> Sensors:
    """Sigmas of the sensors, those of the camera among them."""
    from georef_gis.measure.budget.forecast import Sensors

    names = ("gnss", "gnss_up", "roll_pitch", "yaw", "boresight", "lever_arm", "time", "ground")
    values = {name: float(getattr(parameters, name)) for name in (*names, "click")}
    return Sensors(**values, focal=camera.sigma_f, centre=camera.sigma_c)


# -- lines -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedLines:
    """The plan on the plane of an origin; rim of the area, (n, 2) m; None of these without one.

    `doubts` are about where it lies.
    """

    plan: Plan
    origin: Origin | None
    ring: Array | None
    doubts: tuple[str, ...] = ()

    @classmethod
    def of(cls, parameters: PlanFlightParameters, camera: Camera) -> PlannedLines:
        """Lines over the area, along the line, or of nowhere."""
        import numpy as np

        from georef_gis.measure.preflight.layout import (
            Plan,
            crossing,
            layout_of,
            plan_area,
            plan_corridor,
        )

        _check_unused(parameters)
        layout = layout_of(
            camera, parameters.height, parameters.speed, overlap=parameters.overlap / 100.0,
            sidelap=parameters.sidelap / 100.0, across=parameters.across,
        )  # fmt: skip
        place = planned_place(parameters)
        ring, origin = (_nominal(layout), None) if place is None else (place.xy, place.origin)
        heading = parameters.heading
        if place is None:
            heading = heading or 0.0
        if parameters.line is not None:
            lines = plan_corridor(ring, parameters.width, layout)
        else:
            lines = plan_area(ring, layout, heading=heading)
        layouts = [layout]
        if parameters.crossed:
            second = _second(parameters, layout)
            course = float(np.median(lines[0].headings))
            area = _around(lines) if parameters.line is not None else ring
            lines = (*lines, crossing(area, second, course, first=len(lines) + 1))
            layouts.append(second)
        rim = ring if origin is not None and parameters.line is None else None
        plan = Plan(lines=lines, layouts=tuple(layouts))
        doubts = () if place is None else place.doubts
        return cls(plan=plan, origin=origin, ring=rim, doubts=doubts)


def _check_unused(parameters: PlanFlightParameters) -> None:
    """Refuse what would be ignored in silence."""
    from georef_gis.errors import InputError

    if parameters.second_height is not None and not parameters.crossed:
        raise InputError(
            "is the height of a line across: add --crossed, or leave it out", field="second_height"
        )
    if parameters.layer is not None and not (parameters.area or parameters.line):
        raise InputError("is of no file: give --area or --line, or leave it out", field="layer")


def _second(parameters: PlanFlightParameters, layout: Layout) -> Layout:
    from georef_gis.measure.preflight.layout import at_height

    return at_height(layout, parameters.second_height or SECOND * parameters.height)


def _nominal(layout: Layout) -> Array:
    """Area of a few lines of a few photos, m."""
    import numpy as np

    across = (NOMINAL[0] - 1) * layout.spacing + 0.79 * layout.across
    along = (NOMINAL[1] - 3) * layout.base
    return np.array([[0.0, 0.0], [across, 0.0], [across, along], [0.0, along]])


def _around(lines: Sequence[Any]) -> Array:
    """Rectangle around the photos of lines, (4, 2) m."""
    import numpy as np

    xy = np.vstack([line.photos for line in lines])
    (x0, y0), (x1, y1) = xy.min(axis=0) - 1.0, xy.max(axis=0) + 1.0
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
