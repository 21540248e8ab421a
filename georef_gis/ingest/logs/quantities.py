"""Quantities of a text table in SI: units as stated, as told by the numbers, or an error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.column_names import TARGETS
from georef_gis.ingest.logs.column_resolve import Column, Resolved
from georef_gis.ingest.logs.column_units import Unit, names_of, unit_of
from georef_gis.ingest.logs.text_table import TextTable
from georef_gis.ingest.logs.unit_telling import (
    tell_angle_unit,
    tell_force_unit,
    tell_place_unit,
    tell_rate_unit,
    tell_speed_unit,
)
from georef_gis.model.logs import IntArray

_SI = {"length": "m", "speed": "m/s", "time": "s", "angle": "rad"}


class Quantities:
    """Columns of a table as SI arrays.

    Parameters
    ----------
    table
        Table; doubts are added to it.
    resolved
        Its columns by quantity, and what clashes.
    """

    def __init__(self, table: TextTable, resolved: Resolved) -> None:
        self.table = table
        self.columns: dict[str, Column] = dict(resolved.columns)
        self._clashes = resolved.clashes
        self._doubted: set[str] = set()

    def has(self, *targets: str) -> bool:
        """Whether all of these quantities are there."""
        return all(t in self.columns for t in targets)

    def refuse_clash(self, targets: Sequence[str]) -> None:
        """Raise if several columns claim one of these quantities.

        Raises
        ------
        InputError
            Naming the columns and how to choose.
        """
        for target in targets:
            if target in self._clashes:
                names = self._clashes[target]
                raise InputError(
                    f"{len(names)} columns may be {target}: {', '.join(names)}; choose one in "
                    f"[logs.columns] or by --map, such as --map '{target} = {names[0]}'",
                    source=self.table.source,
                    field=target,
                )

    def doubt_clashes(self) -> None:
        """Note the quantities left out because several columns claim them."""
        for target, names in self._clashes.items():
            self.table.doubts.append(
                f"{target} is not read: columns {', '.join(names)} may all be it; map one"
            )

    def raw(self, target: str) -> Array:
        """Numbers as logged with the sign of the mapping; shape (rows,). Infinite is missing."""
        column = self.columns[target]
        values = self.table.numbers(column.index) * column.sign
        infinite = np.isinf(values)
        if infinite.any():
            if target not in self._doubted:
                self._doubted.add(target)
                count = int(infinite.sum())
                self.table.doubts.append(
                    f"column {column.header}: {count} infinite values; taken as missing"
                )
            values = np.where(infinite, np.nan, values)
        return np.asarray(values)

    def whole(self, target: str, missing: int) -> IntArray:
        """Whole numbers as logged; `missing` where there is none; shape (rows,)."""
        if target not in self.columns:
            return np.full(self.table.rows, missing, dtype=np.int64)
        values = self.raw(target)
        known = np.isfinite(values) & (np.abs(values) < 2.0**53)
        return np.where(known, values, missing).astype(np.int64)

    def si(self, target: str, told: Unit | None = None) -> Array:
        """Values in SI; shape (rows,), NaN everywhere if the quantity is not there.

        Parameters
        ----------
        target
            Quantity.
        told
            Unit where the column states none; without it a length, speed or time is taken in SI,
            with a doubt unless the header is the documented name.
        """
        if target not in self.columns:
            return np.full(self.table.rows, np.nan)
        column = self.columns[target]
        unit = column.unit or told or self._assumed(column)
        return np.asarray(self.raw(target) * (unit.factor if unit else 1.0))

    def _assumed(self, column: Column) -> Unit | None:
        dimension = TARGETS[column.target]
        if dimension not in _SI:
            return None
        if not column.documented and column.target not in self._doubted:
            self._doubted.add(column.target)
            self.table.doubts.append(
                f"column {column.header} states no unit; taken in {_SI[dimension]}"
            )
        return unit_of(_SI[dimension], dimension)

    def triplet(self, quantity: str, R_body_from_sensor: Array) -> Array:
        """x, y and z in SI and body axes; shape (rows, 3).

        Raises
        ------
        InputError
            If the unit is neither stated nor to be told.
        """
        targets = [f"{quantity}_{a}" for a in "xyz"]
        raw = np.stack([self.raw(t) for t in targets], axis=1)
        if TARGETS[targets[0]] == "field":
            return _turned(raw, R_body_from_sensor)
        tell = {"gyro": tell_rate_unit, "accel": tell_force_unit}[quantity]
        units = self._units(targets, tell(raw))
        return _turned(raw * [u.factor for u in units], R_body_from_sensor)

    def place(self) -> tuple[Array, Array]:
        """Latitude and longitude, rad; shapes (rows,), NaN where impossible.

        Raises
        ------
        InputError
            If the unit cannot be told, or most places are not on the Earth.
        """
        lat, lon = self.raw("lat"), self.raw("lon")
        stated = self.columns["lat"].unit or self.columns["lon"].unit
        units = self._units(["lat", "lon"], stated or tell_place_unit(lat, lon))
        return self._on_earth(lat * units[0].factor, lon * units[1].factor)

    def _on_earth(self, lat: Array, lon: Array) -> tuple[Array, Array]:
        known = np.isfinite(lat) & np.isfinite(lon)
        limit = np.pi / 2.0 + 1e-9
        wrong = known & ((np.abs(lat) > limit) | (np.abs(lon) > 4.0 * limit))
        if wrong.sum() > known.sum() / 2:
            i = int(np.flatnonzero(wrong)[0])
            swapped = abs(lon[i]) <= limit and abs(lat[i]) <= 2.0 * limit
            cure = (
                "latitude and longitude are swapped: map lat and lon to the other columns"
                if swapped
                else "check the columns and their unit (deg, rad, deg*1e7)"
            )
            raise InputError(
                f"latitude {np.degrees(lat[i]):g}, longitude {np.degrees(lon[i]):g} deg is not on "
                f"the Earth; {cure}",
                source=self.table.source,
                field=f"{self.columns['lat'].header}, {self.columns['lon'].header}",
            )
        if wrong.any():
            self.table.doubts.append(f"{int(wrong.sum())} places are not on the Earth; left out")
        bad = wrong | ~known
        return np.where(bad, np.nan, lat), np.where(bad, np.nan, lon)

    def angles(self, targets: Sequence[str]) -> Array:
        """Angles of one filter, rad, with one unit told from all; shape (rows, k).

        Raises
        ------
        InputError
            If the unit is neither stated nor to be told.
        """
        raw = np.stack([self.raw(t) for t in targets], axis=1)
        units = self._units(targets, tell_angle_unit(*raw.T))
        return np.asarray(raw * [u.factor for u in units])

    def angle_unit(self, targets: Sequence[str]) -> Unit:
        """Unit of the first of some angles, as `angles` takes it."""
        return self._units(targets, tell_angle_unit(*(self.raw(t) for t in targets)))[0]

    def speed_unit(self, target: str, time: Array, place: tuple[Array, Array]) -> Unit | None:
        """Unit of a horizontal speed that states none, told by the distance between fixes."""
        column = self.columns[target]
        if column.unit is not None or column.documented:
            return column.unit
        unit = tell_speed_unit(time, *place, self.raw(target))
        if unit is not None:
            self.table.doubts.append(
                f"column {column.header} states no unit; {unit.name} by the distance between fixes"
            )
        return unit

    def _units(self, targets: Sequence[str], told: Unit | None) -> list[Unit]:
        units = [self.columns[t].unit or told for t in targets]
        if None not in units:
            return [u for u in units if u is not None]
        open_ones = [self.columns[t] for t in targets if self.columns[t].unit is None]
        names = ", ".join(c.header for c in open_ones)
        dimension = TARGETS[targets[0]]
        example = (
            f"{open_ones[0].target} = {open_ones[0].header}:{names_of(dimension).split(',')[0]}"
        )
        raise InputError(
            "no unit is stated and none can be told from the numbers; write it in the header or "
            f"map it in [logs.columns] or by --map, such as --map '{example}' "
            f"({names_of(dimension)})",
            source=self.table.source,
            field=names,
        )


def _turned(values: Array, R_body_from_sensor: Array) -> Array:
    """Vectors with their axes exchanged; a missing component does not take the others along."""
    axis = np.argmax(np.abs(R_body_from_sensor), axis=1)
    return np.asarray(values[:, axis] * R_body_from_sensor[np.arange(3), axis])
