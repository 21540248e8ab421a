"""GeoTIFF tags of a profile: by hand for CRSs of EPSG codes, by GDAL for all others.

Writing the few keys by hand keeps rasterio (0.2 to 0.4 CPU s) out of the common run.
"""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass

from georef_gis.errors import CrsError
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.tiff import DOUBLE, SHORT, Tag, numbers, text

_PIXEL_SCALE, _TIEPOINT = 33550, 33922
_KEYS, _KEY_DOUBLES, _KEY_TEXT = 34735, 34736, 34737
_GDAL_METADATA, _GDAL_NODATA = 42112, 42113

_PROJECTED = {"PROJCRS", "PROJECTEDCRS", "PROJCS"}
_GEOGRAPHIC = {"GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS", "GEOGCS"}
_VERTICAL = {"VERTCRS", "VERTICALCRS", "VERT_CS"}
_COMPOUND = {"COMPOUNDCRS", "COMPD_CS"}
# EPSG unit of length of a factor to metres, rounded to 1e-9
_UNITS = {1.0: 9001, 0.3048: 9002, 0.304800610: 9003}
# A short in a key directory that means "not one of the codes".
_LARGEST_CODE = 32766


@dataclass(frozen=True, slots=True)
class _Node:
    """A keyword of WKT with what stands between its brackets."""

    name: str
    values: list[str | _Node]

    def children(self, names: set[str]) -> list[_Node]:
        return [item for item in self.values if isinstance(item, _Node) and item.name in names]

    def title(self) -> str:
        return next((item for item in self.values if isinstance(item, str)), "")


def geo_tags(profile: RasterProfile) -> list[Tag]:
    """Tags that place a raster and describe it, for its first directory."""
    a, _, c, _, e, f = profile.transform
    tags = [
        numbers(_PIXEL_SCALE, DOUBLE, (a, -e, 0.0)),
        numbers(_TIEPOINT, DOUBLE, (0.0, 0.0, 0.0, c, f, 0.0)),
        *_crs_tags(profile),
    ]
    if profile.band_descriptions or profile.metadata:
        tags.append(text(_GDAL_METADATA, _metadata_xml(profile)))
    return tags


def nodata_tags(profile: RasterProfile) -> list[Tag]:
    """The tag for the value of missing pixels, for every image directory."""
    if profile.nodata is None:
        return []
    value = profile.nodata
    whole = value == value and abs(value) < 1e15 and value == int(value)
    return [text(_GDAL_NODATA, str(int(value)) if whole else f"{value:.17g}")]


def _metadata_xml(profile: RasterProfile) -> str:
    items = [
        f'  <Item name="{_escaped(name)}">{_twice_escaped(value)}</Item>'
        for name, value in profile.metadata.items()
    ]
    items += [
        f'  <Item name="DESCRIPTION" sample="{band}" role="description">'
        f"{_twice_escaped(name)}</Item>"
        for band, name in enumerate(profile.band_descriptions)
        if name
    ]
    return "\n".join(["<GDALMetadata>", *items, "</GDALMetadata>", ""])


def _twice_escaped(value: str) -> str:
    # GDAL writes and reads values so
    return _escaped(_escaped(value))


def _escaped(value: str) -> str:
    # xml.sax.saxutils would do it but imports half the web (0.02 CPU s)
    for character, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        value = value.replace(character, entity)
    return value


def _crs_tags(profile: RasterProfile) -> list[Tag]:
    if not profile.crs_wkt and profile.epsg is None:
        return []
    return _by_hand(profile) or _by_gdal(profile)


def _by_hand(profile: RasterProfile) -> list[Tag]:
    """Keys of a 2D CRS, or of one with heights, whose parts all have EPSG codes; else none."""
    root = _parse(profile.crs_wkt)
    if root is None:
        return []
    vertical: _Node | None = None
    horizontal = root
    code = _epsg(root)
    if profile.epsg is not None and code is not None and code != profile.epsg:
        raise CrsError(f"WKT of EPSG:{code} beside EPSG:{profile.epsg}; give one of them")
    code = code or profile.epsg
    if root.name in _COMPOUND:
        across, up = root.children(_PROJECTED | _GEOGRAPHIC), root.children(_VERTICAL)
        if len(across) != 1 or len(up) != 1:
            return []
        horizontal, vertical = across[0], up[0]
        code = _epsg(horizontal)
    flat = all("3" not in system.values for system in horizontal.children({"CS"}))
    projected = horizontal.name in _PROJECTED
    if code is None or not flat or not (projected or horizontal.name in _GEOGRAPHIC):
        return []
    name = root.title() + "|"
    keys = [
        (1024, 0, 1, 1 if projected else 2),
        (1025, 0, 1, 1),
        (1026, _KEY_TEXT, len(name.encode()), 0),
        (3072 if projected else 2048, 0, 1, code),
    ]
    if projected and (unit := _unit(horizontal)):
        keys.append((3076, 0, 1, unit))
    if vertical is not None:
        height = _epsg(vertical)
        if height is None:
            return []
        keys.append((4096, 0, 1, height))
        if unit := _unit(vertical):
            keys.append((4099, 0, 1, unit))
    # revision 1.1 makes readers look at the vertical keys
    return [_key_tag(keys, minor=0 if vertical is None else 1), text(_KEY_TEXT, name)]


def _key_tag(keys: list[tuple[int, int, int, int]], *, minor: int) -> Tag:
    flat = [1, 1, minor, len(keys), *(value for key in keys for value in key)]
    return numbers(_KEYS, SHORT, flat)


def _epsg(node: _Node) -> int | None:
    """EPSG code a definition carries, in the range a key can hold."""
    for mark in node.children({"ID", "AUTHORITY"}):
        if mark.title().upper() == "EPSG" and isinstance(mark.values[1], str):
            code = int(mark.values[1]) if mark.values[1].isdigit() else 0
            return code if 0 < code <= _LARGEST_CODE else None
    return None


def _unit(node: _Node) -> int | None:
    """EPSG code of the CRS's unit of length, if one of the three in use."""
    found = node.children({"LENGTHUNIT", "UNIT"})
    for axis in node.children({"AXIS"}):
        found += axis.children({"LENGTHUNIT", "UNIT"})
    if not found or not isinstance(found[0].values[1], str):
        return None
    return _UNITS.get(round(float(found[0].values[1]), 9))


def _parse(wkt: str) -> _Node | None:
    """Tree of a WKT string; None if it is not one."""
    tokens = re.findall(r'"(?:[^"]|"")*"|[A-Za-z_]\w*|[-+.\d][-+.\deE]*|[\[\](),]', wkt)
    stack: list[_Node] = [_Node("", [])]
    for index, token in enumerate(tokens):
        if token in "[(":
            name = stack[-1].values.pop() if stack[-1].values else ""
            if not isinstance(name, str):
                return None
            node = _Node(name.upper(), [])
            stack[-1].values.append(node)
            stack.append(node)
        elif token in "])":
            stack.pop()
            if not stack:
                return None
        elif token != ",":
            quoted = token.startswith('"')
            stack[-1].values.append(token[1:-1].replace('""', '"') if quoted else tokens[index])
    roots = [item for item in stack[0].values if isinstance(item, _Node)]
    return roots[0] if len(stack) == 1 and len(roots) == 1 else None


def _by_gdal(profile: RasterProfile) -> list[Tag]:
    """Keys as GDAL writes them into a tiny file, refused if the CRS does not come back."""
    import rasterio
    from rasterio.crs import CRS
    from rasterio.errors import CRSError
    from rasterio.io import MemoryFile

    root = _parse(profile.crs_wkt)
    # WKT 2 of a compound CRS has a code for the whole but none for its parts, which keys need
    code = profile.epsg or (root and _epsg(root))
    try:
        crs = CRS.from_epsg(code) if code else CRS.from_wkt(profile.crs_wkt)
    except CRSError as error:
        raise CrsError(f"the CRS cannot be read ({error}); give WKT or an EPSG code") from error
    made = {"driver": "GTiff", "width": 1, "height": 1, "count": 1, "dtype": "uint8"}
    with warnings.catch_warnings(), MemoryFile(ext=".tif") as memory:
        warnings.simplefilter("ignore")
        transform = rasterio.Affine(1.0, 0.0, 0.0, 0.0, -1.0, 1.0)
        with memory.open(**made, crs=crs, transform=transform):
            pass
        raw = memory.read()
    with MemoryFile(raw, ext=".tif") as memory, memory.open() as tiny:
        back = tiny.crs
    from georef_gis.geodesy import same_crs

    if back != crs and not same_crs(back.to_wkt(), crs.to_wkt()):
        raise CrsError(
            f"GeoTIFF cannot hold this CRS: {crs.to_wkt()[:80]}...; "
            "reproject to a CRS with an EPSG code"
        )
    return _copied(raw)


def _copied(raw: bytes) -> list[Tag]:
    """Key tags of a TIFF held in memory."""
    import tifffile

    with tifffile.TiffFile(io.BytesIO(raw)) as tiff:
        found = tiff.pages.first.tags
        tags = [numbers(_KEYS, SHORT, found[_KEYS].value)]
        if _KEY_DOUBLES in found:
            tags.append(numbers(_KEY_DOUBLES, DOUBLE, found[_KEY_DOUBLES].value))
        if _KEY_TEXT in found:
            # the zero byte at the end is part of the value, not of its text
            tags.append(text(_KEY_TEXT, found[_KEY_TEXT].value.rstrip("\0")))
    return tags
