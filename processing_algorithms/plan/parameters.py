"""What `plan_flight` asks: area or road, camera, sensors."""

from __future__ import annotations

from typing import Literal

from georef_gis.toolbox import parameters as p


class PlanFlightParameters(p.Parameters):
    """Parameters of `plan_flight`."""

    height: p.Length = p.length(title="Height above the ground", unit="m", gt=0, le=20000)
    speed: p.Number = p.number(title="Ground speed", unit="m/s", gt=0, le=300)
    area: p.VectorLayer | None = p.vector_layer(
        None, title="File with the area to cover, one polygon"
    )
    line: p.VectorLayer | None = p.vector_layer(None, title="File with a centre line, for a road")
    layer: p.Text | None = p.text(None, title="Layer of that file, if several have shapes")
    corner: tuple[p.MapPoint, ...] = p.map_point(
        (), title="Corner of the area, x,y (lon,lat unless @CRS is added); give it once per corner"
    )
    width: p.Length = p.length(60.0, title="Width to cover along a centre line", gt=0)
    overlap: p.Number = p.number(80.0, title="Overlap along a line", unit="%", ge=0, lt=100)
    sidelap: p.Number = p.number(40.0, title="Overlap of lines", unit="%", ge=0, lt=100)
    heading: p.Angle | None = p.angle(
        None, title="Heading of the lines; by default along the longer side", ge=-360, le=360
    )
    across: Literal["width", "height"] = p.choice("width", title="Side of the photo across lines")
    crossed: p.Flag = p.flag(
        False, title="Add a line across at a second height",
        help="tells boresight, lever arm and focal length apart",
    )  # fmt: skip
    second_height: p.Length | None = p.length(
        None, title="Its height; by default 1.3 of the first", gt=0, le=20000
    )
    relief: p.Length = p.length(0.0, title="How much higher the ground rises in the area", ge=0)
    photo: p.File | None = p.file(None, title="A photo of the camera, whose tags describe it")
    focal: p.Length | None = p.length(None, title="Focal length, of no photo", unit="mm", gt=0)
    sensor_width: p.Length | None = p.length(None, title="Width of the sensor", unit="mm", gt=0)
    columns: p.Integer | None = p.integer(None, title="Columns of a photo", unit="px", ge=2)
    rows: p.Integer | None = p.integer(None, title="Rows of a photo", unit="px", ge=2)
    exposure: p.Number = p.number(0.001, title="Exposure time", unit="s", gt=0, le=10)
    rate: p.Angle = p.angle(5.0, title="Usual rate of roll and pitch, per second", ge=0, le=360)
    gnss: p.Length = p.length(2.2, title="One sigma of the position, east and north each", ge=0)
    gnss_up: p.Length = p.length(5.0, title="One sigma of the height", ge=0)
    roll_pitch: p.Angle = p.angle(1.0, title="One sigma of roll and pitch", ge=0, le=90)
    yaw: p.Angle = p.angle(2.0, title="One sigma of yaw", ge=0, le=180)
    boresight: p.Angle = p.angle(0.5, title="One sigma of the boresight", ge=0, le=90)
    lever_arm: p.Length = p.length(0.05, title="One sigma of the lever arm", ge=0)
    time: p.Number = p.number(0.002, title="One sigma of the exposure time", unit="s", ge=0)
    focal_percent: p.Number = p.number(
        0.5, title="One sigma of the focal length", unit="%", ge=0, le=50
    )
    centre_px: p.Number = p.number(8.0, title="One sigma of the principal point", unit="px", ge=0)
    ground: p.Length = p.length(1.5, title="One sigma of the height of the ground", ge=0)
    click: p.Number = p.number(1.0, title="One sigma of a click", unit="px", ge=0, le=100)
    tie_px: p.Number = p.number(
        0.5, title="One sigma of a tie point", unit="px", gt=0, le=20, advanced=True
    )
    control: p.Integer = p.integer(0, title="Control points in the block", ge=0, le=50)
    target: p.File | None = p.file(None, title="KML to write", suffixes=(".kml",), writes=True)
    picture: p.File | None = p.file(None, title="PNG to write", suffixes=(".png",), writes=True)
