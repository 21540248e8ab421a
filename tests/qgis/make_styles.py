"""Writes the QML styles of the QGIS plug-in: assets from the table of classes, and the rest.

Run it when `georef_gis/data/asset_classes.toml` gets a class; a test compares.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

ROOT = Path(__file__).parent.parent.parent
STYLES = ROOT / "georef_gis/qgis_plugin/georef_qgis/styles"
CLASSES = ROOT / "georef_gis/data/asset_classes.toml"
# Group of classes -> colour r,g,b
COLOURS = {
    "channelizing device": "255,112,0",
    "barrier": "120,94,240",
    "panel": "255,200,0",
    "sign": "255,200,0",
    "people": "220,38,127",
    "vehicle": "38,110,220",
    "signal": "0,160,90",
    "marking": "255,255,255",
    "layout": "0,200,220",
    "other": "160,160,160",
}
SHAPES = {
    "cone": "equilateral_triangle", "drum": "square", "tubular_marker": "line",
    "vertical_panel": "half_square", "barricade_1": "cross", "barricade_2": "cross",
    "barricade_3": "cross_fill", "crash_cushion": "pentagon", "arrow_board": "filled_arrowhead",
    "message_sign": "square_with_corners", "sign": "diamond", "flagger": "star",
    "shadow_vehicle": "hexagon", "temporary_signal": "circle", "point": "circle",
}  # fmt: skip
HEAD = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"


def options(values: Mapping[str, str]) -> str:
    """Options of a symbol layer."""
    rows = (
        f'<Option name={quoteattr(k)} value={quoteattr(v)} type="QString"/>'
        for k, v in values.items()
    )
    return f'<Option type="Map">{"".join(rows)}</Option>'


def symbol(number: int, kind: str, layers: Sequence[tuple[str, Mapping[str, str]]]) -> str:
    """A symbol of layers, from below to above."""
    inner = "".join(
        f'<layer class="{name}" enabled="1" locked="0" pass="0">{options(values)}</layer>'
        for name, values in layers
    )
    return f'<symbol type="{kind}" name="{number}" alpha="1" force_rhr="0">{inner}</symbol>\n'


def marker(shape: str, colour: str, size: str = "3.4") -> tuple[str, dict[str, str]]:
    """A point's sign with a dark rim, so that it stands out on any ground."""
    return "SimpleMarker", {
        "name": shape, "color": f"{colour},255", "outline_color": "20,20,20,255",
        "outline_width": "0.35", "outline_width_unit": "MM", "size": size, "size_unit": "MM",
    }  # fmt: skip


def line(colour: str, width: str, style: str = "solid") -> tuple[str, dict[str, str]]:
    """A line."""
    return "SimpleLine", {
        "line_color": f"{colour},255", "line_width": width, "line_width_unit": "MM",
        "line_style": style, "capstyle": "round", "joinstyle": "round",
    }  # fmt: skip


def fill(colour: str, alpha: int, rim: str, width: str) -> tuple[str, dict[str, str]]:
    """An area."""
    return "SimpleFill", {
        "color": f"{colour},{alpha}", "style": "solid" if alpha else "no",
        "outline_color": f"{rim},255", "outline_width": width, "outline_width_unit": "MM",
        "outline_style": "solid",
    }  # fmt: skip


def of_class(name: str, entry: Mapping[str, str]) -> tuple[str, list[tuple[str, dict[str, str]]]]:
    """Kind and layers of the symbol of a class of assets."""
    colour = COLOURS[entry["group"]]
    if entry["geometry"] == "point":
        return "marker", [marker(SHAPES.get(name, "circle"), colour)]
    if entry["geometry"] == "line":
        dashed = "dash" if entry["group"] == "layout" else "solid"
        return "line", [line("20,20,20", "0.9"), line(colour, "0.55", dashed)]
    return "fill", [fill(colour, 60, colour, "0.5")]


def labels(field: str) -> str:
    """Names beside the features, with a white halo, from near by."""
    return (
        '<labeling type="simple"><settings calloutType="simple">'
        f'<text-style fieldName={quoteattr(field)} fontSize="8" fontSizeUnit="Point" '
        'textColor="20,20,20,255" isExpression="0"><text-buffer bufferDraw="1" bufferSize="0.8" '
        'bufferSizeUnits="MM" bufferColor="255,255,255,255" bufferOpacity="0.9"/></text-style>'
        '<placement placement="6" dist="1.2" distUnits="MM"/>'
        '<rendering scaleVisibility="1" scaleMin="1" scaleMax="2500" obstacle="1"/>'
        "</settings></labeling>\n"
    )


def qml(renderer: str, *, label: str = "", tip: str = "") -> str:
    """A style file."""
    parts = "Symbology|MapTips" + ("|Labeling" if label else "")
    flag = ' labelsEnabled="1"' if label else ""
    return (
        f'{HEAD}<qgis version="3.22.0" styleCategories="{parts}"{flag}>\n{renderer}'
        f"{labels(label) if label else ''}"
        f"<mapTip>{tip.replace('&', '&amp;').replace('<', '&lt;')}</mapTip>\n</qgis>\n"
    )


def by_class(geometry: str) -> str:
    """Style of the assets of a geometry: a category for every class."""
    with CLASSES.open("rb") as stream:
        table = tomllib.load(stream)["classes"]
    mine = {name: entry for name, entry in table.items() if entry["geometry"] == geometry}
    other = {"group": "other", "geometry": geometry}
    made = [*(of_class(*item) for item in mine.items()), of_class(geometry, other)]
    names = [*((name, entry["title"]) for name, entry in mine.items()), ("", "Other")]
    rows = "".join(
        f'<category symbol="{n}" value={quoteattr(v)} type="string" render="true" '
        f"label={quoteattr(title)}/>"
        for n, (v, title) in enumerate(names)
    )
    symbols = "".join(symbol(n, kind, layers) for n, (kind, layers) in enumerate(made))
    renderer = (
        '<renderer-v2 type="categorizedSymbol" attr="class" symbollevels="0" enableorderby="0" '
        f'forceraster="0">\n<categories>{rows}</categories>\n<symbols>\n{symbols}</symbols>\n'
        "</renderer-v2>\n"
    )
    tip = '<b>[% "name" %]</b> [% "class" %]<br/>[% "note" %]<br/>n_rays [% "n_rays" %]'
    return qml(renderer, label="name" if geometry == "point" else "", tip=tip)


def single(kind: str, layers: Sequence[tuple[str, Mapping[str, str]]], **more: str) -> str:
    """Style with one symbol."""
    return qml(
        '<renderer-v2 type="singleSymbol" symbollevels="0" enableorderby="0" forceraster="0">\n'
        f"<symbols>\n{symbol(0, kind, layers)}</symbols>\n</renderer-v2>\n",
        **more,
    )


def ellipses() -> str:
    """Style of error ellipses: an outline, so that what lies below is seen."""
    tip = '<b>[% "name" %]</b><br/>holds the place with a probability of [% "conf" %]'
    return single("fill", [fill("215,25,28", 25, "215,25,28", "0.45")], tip=tip)


def places() -> str:
    """Style of a table of measured places: a cross, and the ellipse at its true size."""
    # QGIS knows no CASE x WHEN; degrees have no circle
    unit = (
        "CASE WHEN layer_property(@layer, 'distance_units') ILIKE '%degree%' THEN NULL "
        "WHEN regexp_match(layer_property(@layer, 'distance_units'), '(?i)feet|foot|ft') "
        "THEN 1 / 0.3048 ELSE 1 END"
    )
    expression = (
        f'make_ellipse($geometry, "semi_major_m" * {unit}, "semi_minor_m" * {unit}, '
        '"azimuth_deg", 72)'
    )
    drawn = options({"geometryModifier": expression, "SymbolType": "Fill", "units": "MapUnit"})
    inner = symbol(0, "fill", [fill("215,25,28", 25, "215,25,28", "0.45")]).replace(
        'name="0"', 'name="@0@0"'
    )
    ellipse = (
        f'<layer class="GeometryGenerator" enabled="1" locked="0" pass="0">{drawn}{inner}</layer>'
    )
    cross = symbol(
        0, "marker", [marker("cross", "255,255,255", "3"), marker("circle", "215,25,28", "1.2")]
    )
    cross = cross.replace("<layer", f"{ellipse}<layer", 1)
    renderer = (
        '<renderer-v2 type="singleSymbol" symbollevels="0" enableorderby="0" forceraster="0">\n'
        f"<symbols>\n{cross}</symbols>\n</renderer-v2>\n"
    )
    tip = '<b>[% "name" %]</b><br/>[% "semi_major_m" %] x [% "semi_minor_m" %] m'
    return qml(renderer, label="name", tip=tip)


def overlap() -> str:
    """Style of the number of photos that show a place."""
    ramp = ((0, "215,25,28", 0), (1, "215,25,28", 200), (2, "253,174,97", 190),
            (4, "255,255,191", 180), (6, "166,217,106", 180), (9, "26,150,65", 180))  # fmt: skip
    items = "".join(
        f'<item value="{v}" color="#{"".join(f"{int(c):02x}" for c in rgb.split(","))}" '
        f'alpha="{alpha}" label="{v}"/>'
        for v, rgb, alpha in ramp
    )
    return (
        f'{HEAD}<qgis version="3.22.0" styleCategories="Symbology">\n<pipe>\n'
        '<rasterrenderer type="singlebandpseudocolor" band="1" opacity="0.7" alphaBand="-1" '
        'nodataColor="" classificationMin="0" classificationMax="9">\n<rastershader>'
        '<colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" '
        f'minimumValue="0" maximumValue="9">{items}</colorrampshader></rastershader>\n'
        "</rasterrenderer>\n</pipe>\n</qgis>\n"
    )


def surface() -> str:
    """Style of heights: shaded, which needs no range of them."""
    return (
        f'{HEAD}<qgis version="3.22.0" styleCategories="Symbology">\n<pipe>\n'
        '<rasterrenderer type="hillshade" band="1" azimuth="315" angle="45" zfactor="2" '
        'multidirection="1" opacity="1" alphaBand="-1" nodataColor=""/>\n</pipe>\n</qgis>\n'
    )


def styles() -> dict[str, str]:
    """Every style by the name of its file."""
    return {
        "asset_points.qml": by_class("point"),
        "asset_lines.qml": by_class("line"),
        "asset_polygons.qml": by_class("polygon"),
        "ellipses.qml": ellipses(),
        "places.qml": places(),
        "overlap.qml": overlap(),
        "surface.qml": surface(),
        "seams.qml": single("fill", [fill("0,0,0", 0, "255,0,160", "0.5")], tip='[% "photo" %]'),
    }


if __name__ == "__main__":
    STYLES.mkdir(exist_ok=True)
    for name, text in styles().items():
        (STYLES / name).write_text(text, encoding="utf-8")
