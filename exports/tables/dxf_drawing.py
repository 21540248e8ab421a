"""DXF of AutoCAD 2007 (AC1021, UTF-8) as text: the sections of a drawing around its entities.

Written by own code because GDAL's writer takes labels from styles only, which cannot be handed to
it from here. Group codes are those of Autodesk's DXF reference.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

# $INSUNITS by the length of a CRS unit in m; anything else is unitless
UNITS = ((1.0, 6), (0.3048, 2), (1200.0 / 3937.0, 21))
# handles of what every drawing has
MODEL, PAPER, FIRST = "1F", "1E", 0x100
_FORBIDDEN = re.compile(r'[<>/\\":;?*|=,`\x00-\x1f]')
# AutoCAD's longest name of a layer
_NAME_LENGTH = 255
_COLOURS = (1, 2, 3, 4, 5, 6, 30, 150)


@dataclass(kw_only=True)
class Handles:
    """Numbers by which the objects of a drawing are known."""

    _numbers: Iterator[int] = field(default_factory=lambda: count(FIRST))
    last: int = FIRST

    def take(self) -> str:
        """A new one, in hexadecimal."""
        self.last = next(self._numbers)
        return f"{self.last:X}"


def layer_name(text: str) -> str:
    """Name of a layer that AutoCAD takes, for any text."""
    return _FORBIDDEN.sub("_", text).strip()[:_NAME_LENGTH] or "_"


def text_value(text: str) -> str:
    """Text of one line: ^ and %% begin control codes, control characters become blanks."""
    text = text.replace("^", "^ ").replace("%%", "%%%%%%")
    return re.sub(r"[\x00-\x1f\x7f\u2028\u2029]", " ", text)


def units_of(metres_per_unit: float) -> int:
    """$INSUNITS of a CRS; 0 = unitless."""
    # US survey and international feet differ by 2e-6
    return next((code for m, code in UNITS if abs(m - metres_per_unit) < 1e-8), 0)


def groups(*pairs: tuple[int, object]) -> str:
    """Pairs of group code and value."""
    return "".join(f"{code}\n{value}\n" for code, value in pairs)


def head(
    *,
    units: int,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    handles: Handles,
    layers: Iterable[str],
    comment: str,
) -> str:
    """Everything before the entities.

    Parameters
    ----------
    low, high
        Corners of the box around all entities, CRS units.
    layers
        Names of layers, beside "0".
    """
    tables = _tables(handles, layers)
    variables: Mapping[str, tuple[tuple[int, object], ...]] = {
        "$ACADVER": ((1, "AC1021"),),
        "$DWGCODEPAGE": ((3, "ANSI_1252"),),
        # what follows takes handles too
        "$HANDSEED": ((5, "FFFFFFFF"),),
        "$INSUNITS": ((70, units),),
        "$MEASUREMENT": ((70, 1 if units == 6 else 0),),
        "$EXTMIN": tuple(zip((10, 20, 30), low, strict=True)),
        "$EXTMAX": tuple(zip((10, 20, 30), high, strict=True)),
        # points as crosses of 1 % of the screen: a dot is hardly seen
        "$PDMODE": ((70, 2),),
        "$PDSIZE": ((40, -1.0),),
    }
    header = "".join(groups((9, name), *values) for name, values in variables.items())
    return (
        groups((999, text_value(comment)))
        + groups((0, "SECTION"), (2, "HEADER")) + header + groups((0, "ENDSEC"))
        + groups((0, "SECTION"), (2, "CLASSES"), (0, "ENDSEC"))
        + groups((0, "SECTION"), (2, "TABLES")) + tables + groups((0, "ENDSEC"))
        + groups((0, "SECTION"), (2, "BLOCKS")) + _blocks(handles) + groups((0, "ENDSEC"))
        + groups((0, "SECTION"), (2, "ENTITIES"))
    )  # fmt: skip


def tail() -> str:
    """Everything after the entities."""
    root, group = "C", "D"
    return (
        groups((0, "ENDSEC"), (0, "SECTION"), (2, "OBJECTS"))
        + groups((0, "DICTIONARY"), (5, root), (330, 0), (100, "AcDbDictionary"), (281, 1),
                 (3, "ACAD_GROUP"), (350, group))
        + groups((0, "DICTIONARY"), (5, group), (330, root), (100, "AcDbDictionary"), (281, 1))
        + groups((0, "ENDSEC"), (0, "EOF"))
    )  # fmt: skip


def _tables(handles: Handles, layers: Iterable[str]) -> str:
    def record(owner: str, kind: str, name: str, *pairs: tuple[int, object], flags: int = 0) -> str:
        code = 105 if kind == "DIMSTYLE" else 5
        return groups((0, kind), (code, handles.take()), (330, owner),
                      (100, "AcDbSymbolTableRecord"), (100, _RECORDS[kind]), (2, name),
                      (70, flags), *pairs)  # fmt: skip

    line = ((3, ""), (72, 65), (73, 0), (40, 0.0))
    port = ((10, 0.0), (20, 0.0), (11, 1.0), (21, 1.0), (40, 1.0), (41, 1.0))
    font = ((40, 0.0), (41, 1.0), (50, 0.0), (71, 0), (42, 1.0), (3, "txt"), (4, ""))
    contents: dict[str, list[str]] = {
        "VPORT": [record("8", "VPORT", "*Active", *port)],
        "LTYPE": [record("5", "LTYPE", x, *line) for x in ("ByBlock", "ByLayer", "Continuous")],
        "LAYER": [
            record("2", "LAYER", name, (62, 7 if i == 0 else _COLOURS[i % len(_COLOURS)]),
                   (6, "Continuous"))
            for i, name in enumerate(("0", *layers))
        ],
        "STYLE": [record("3", "STYLE", "Standard", *font)],
        "VIEW": [],
        "UCS": [],
        "APPID": [record("9", "APPID", "ACAD")],
        "DIMSTYLE": [record("A", "DIMSTYLE", "Standard")],
        "BLOCK_RECORD": [
            groups((0, "BLOCK_RECORD"), (5, handle), (330, "1"), (100, "AcDbSymbolTableRecord"),
                   (100, "AcDbBlockTableRecord"), (2, name))
            for handle, name in ((MODEL, "*Model_Space"), (PAPER, "*Paper_Space"))
        ],
    }  # fmt: skip
    out = ""
    for kind, records in contents.items():
        out += groups((0, "TABLE"), (2, kind), (5, _TABLES[kind]), (330, 0),
                      (100, "AcDbSymbolTable"), (70, len(records)))  # fmt: skip
        if kind == "DIMSTYLE":
            out += groups((100, "AcDbDimStyleTable"))
        out += "".join(records) + groups((0, "ENDTAB"))
    return out


_TABLES = {"VPORT": "8", "LTYPE": "5", "LAYER": "2", "STYLE": "3", "VIEW": "6", "UCS": "7",
           "APPID": "9", "DIMSTYLE": "A", "BLOCK_RECORD": "1"}  # fmt: skip
_RECORDS = {"VPORT": "AcDbViewportTableRecord", "LTYPE": "AcDbLinetypeTableRecord",
            "LAYER": "AcDbLayerTableRecord", "STYLE": "AcDbTextStyleTableRecord",
            "APPID": "AcDbRegAppTableRecord", "DIMSTYLE": "AcDbDimStyleTableRecord"}  # fmt: skip


def _blocks(handles: Handles) -> str:
    out = ""
    for owner, name in ((MODEL, "*Model_Space"), (PAPER, "*Paper_Space")):
        out += groups((0, "BLOCK"), (5, handles.take()), (330, owner), (100, "AcDbEntity"),
                      (8, "0"), (100, "AcDbBlockBegin"), (2, name), (70, 0), (10, 0.0), (20, 0.0),
                      (30, 0.0), (3, name), (1, ""))  # fmt: skip
        out += groups((0, "ENDBLK"), (5, handles.take()), (330, owner), (100, "AcDbEntity"),
                      (8, "0"), (100, "AcDbBlockEnd"))  # fmt: skip
    return out


# -- entities ----------------------------------------------------------------------------------


def _begin(kind: str, handle: str, layer: str, marker: str, owner: str = MODEL) -> str:
    return f"0\n{kind}\n5\n{handle}\n330\n{owner}\n100\nAcDbEntity\n8\n{layer}\n100\n{marker}\n"


def point(handle: str, layer: str, at: str) -> str:
    """Point at a place: groups 10, 20, 30."""
    return _begin("POINT", handle, layer, "AcDbPoint") + at


def flat_line(handle: str, layer: str, vertices: str, *, count: int, closed: bool) -> str:
    """Line of places in the plane: groups 10, 20."""
    return (
        f"{_begin('LWPOLYLINE', handle, layer, 'AcDbPolyline')}90\n{count}\n"
        f"70\n{int(closed)}\n43\n0.0\n{vertices}"
    )


def solid_line(handles: Handles, layer: str, vertices: list[str], *, closed: bool) -> str:
    """Line of places in space: groups 10, 20, 30; the handle was taken last."""
    own = f"{handles.last:X}"
    out = [
        _begin("POLYLINE", own, layer, "AcDb3dPolyline"),
        f"66\n1\n10\n0.0\n20\n0.0\n30\n0.0\n70\n{8 | int(closed)}\n",
    ]
    for vertex in vertices:
        begin = _begin("VERTEX", handles.take(), layer, "AcDbVertex", own)
        out.append(f"{begin}100\nAcDb3dPolylineVertex\n{vertex}70\n32\n")
    end = f"0\nSEQEND\n5\n{handles.take()}\n330\n{own}\n100\nAcDbEntity\n8\n{layer}\n"
    return "".join(out) + end


def label(handle: str, layer: str, at: str, text: str, height: str) -> str:
    """Text beside a place: groups 10, 20, 30."""
    begin = _begin("TEXT", handle, layer, "AcDbText")
    return f"{begin}{at}40\n{height}\n1\n{text_value(text)}\n100\nAcDbText\n"
