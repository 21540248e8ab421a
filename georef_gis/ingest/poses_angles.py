"""Angles and standard deviations in the rows of a table of poses."""

from __future__ import annotations

import math

from georef_gis.errors import InputError
from georef_gis.ingest.tables import Row
from georef_gis.model.photo import AttitudeTag
from georef_gis.units import wrap_angle

_GROUPS = (("yaw", "pitch", "roll"), ("omega", "phi", "kappa"))
# rows; fewer say nothing about their unit
_ENOUGH_ROWS = 4


def _angles(row: Row) -> tuple[str, tuple[float | None, ...]] | None:
    for names in _GROUPS:
        if all(name in row.columns for name in names):
            return ("ypr" if names[0] == "yaw" else "opk"), tuple(row.number(n, n) for n in names)
    return None


def attitude_of(row: Row, unit: str) -> AttitudeTag | None:
    """Angles of a row, of dialect `ypr` or `opk`, with their sigmas; None where it has none."""
    found = _angles(row)
    if found is None or found[1][1] is None or found[1][2] is None:
        return None
    dialect, values = found
    scale = 1.0 if unit == "radians" else math.pi / 180.0
    a, b, c = (None if v is None else v * scale for v in values)
    if dialect == "opk":
        if a is None or b is None or c is None:
            return None
        sigmas = _angle_sigmas(row, scale, ("acc_omega", "acc_phi", "acc_kappa"))
        return AttitudeTag(
            dialect="opk", roll=a, pitch=b, yaw=wrap_angle(c),
            sigma_roll_pitch=sigmas[0], sigma_yaw=sigmas[1],
        )  # fmt: skip
    if b is None or c is None:
        return None
    yaw = None if a is None else wrap_angle(a)
    sigmas = _angle_sigmas(row, scale, ("acc_roll", "acc_pitch", "acc_yaw"))
    return AttitudeTag(
        dialect="ypr", roll=c, pitch=b, yaw=yaw, sigma_roll_pitch=sigmas[0], sigma_yaw=sigmas[1]
    )


def _angle_sigmas(
    row: Row, scale: float, columns: tuple[str, str, str]
) -> tuple[float | None, float | None]:
    """Sigma of the first two angles, root mean square, and of the third, rad; None = not told."""
    a, b, c = (sigma_of(row, column) for column in columns)
    tilt = None if a is None or b is None else math.sqrt((a * a + b * b) / 2.0) * scale
    return tilt, None if c is None else c * scale


def check_angle_unit(rows: tuple[Row, ...], unit: str) -> None:
    """Refuse degrees given for radians and the other way round."""
    largest, cells, fractions = 0.0, 0, 0
    for row in rows:
        found = _angles(row)
        for value in found[1] if found else ():
            if value is None:
                continue
            limit = 2.0 * math.pi + 0.01 if unit == "radians" else 360.01
            if abs(value) > limit:
                what = "radians; they look like degrees" if unit == "radians" else "degrees"
                raise InputError(
                    f"{value:g} is no angle in {what}; check the columns and the unit",
                    source=row.source,
                    field="angles",
                )
            largest, cells = max(largest, abs(value)), cells + 1
            fractions += value != round(value)
    if unit == "degrees" and cells >= 3 * _ENOUGH_ROWS and 1.0 < largest <= 2.0 * math.pi:
        if fractions > cells // 2:
            raise InputError(
                f"no angle of {len(rows)} photos is larger than {largest:.3f}: these are radians; "
                "write degrees or say that the unit is radians",
                source=str(rows[0].path),
                field="angles",
            )


def sigma_of(row: Row, column: str, unit: float = 1.0) -> float | None:
    """One standard deviation in a column, times the length of its unit; None = not told."""
    value = row.number(column, column) if column in row.columns else None
    if value is not None and value < 0.0:
        raise InputError(
            f"{value:g} {'m' if column in ('acc_h', 'acc_v') else 'deg'} is negative; give one "
            "standard deviation",
            source=row.source,
            field=column,
        )
    return value * unit if value else None
