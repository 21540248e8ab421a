"""Tool `band-index`: NDVI and its like from the bands of one map, or of two cameras' maps."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.mosaic.band_math import Expression
    from georef_gis.mosaic.band_shift import BandShift
    from georef_gis.rasters.profile import RasterProfile
    from georef_gis.rasters.resampled import Bands, MapHeader
    from processing_algorithms.mosaic.band_pair import Picked
    from processing_algorithms.mosaic.band_tiles import BandTiles

_ROLE_HELP = "number, or name in the file; other:1 is band 1 of the other map"
# px; scatter of the shift over the map from which on it is told
_UNEVEN = 0.5
_RADIOMETRY = "grey values are no reflectances unless the cameras were calibrated"


class BandIndexParameters(p.Parameters):
    """Parameters of `band-index`."""

    raster: p.RasterLayer = p.raster_layer(
        title="Map, such as products/mosaic.tif", positional=True
    )
    index: Literal["ndvi", "gndvi", "blue-ndvi", "savi", "ndwi", "exg"] = p.choice(
        "ndvi", title="Index",
        help="blue-ndvi: NIR-modified cameras without red; exg: excess green of plain colour",
    )  # fmt: skip
    expression: p.Text | None = p.text(
        None, title="Own formula instead, of band names, numbers, + - * / and ( )",
        help="such as (nir - 0.8 * red) / (nir + red); b1 is band 1, other.b1 that of the other "
        "map; values are 0 to 1",
    )  # fmt: skip
    nir: p.Text | None = p.text(None, title="Band of near infrared", help=_ROLE_HELP)
    red: p.Text | None = p.text(None, title="Band of red", help=_ROLE_HELP)
    green: p.Text | None = p.text(None, title="Band of green", help=_ROLE_HELP)
    blue: p.Text | None = p.text(None, title="Band of blue", help=_ROLE_HELP)
    other: p.RasterLayer | None = p.raster_layer(
        None, title="Map of another camera over the same ground",
        help="any CRS, GSD and extent; it is brought to the grid of the first",
    )  # fmt: skip
    align: Literal["auto", "none"] = p.choice(
        "auto", title="Shift between the two maps",
        help="auto: found by their edges and taken out; none: their places hold",
    )  # fmt: skip
    max_shift: p.Number = p.number(
        32.0, title="Largest shift that is believed", unit="px", ge=1, le=250
    )
    clipped: Literal["mask", "keep"] = p.choice(
        "mask", title="Pixels that are overexposed in a band", advanced=True
    )
    white: p.Number | None = p.number(
        None, title="Grey value that counts as 1; by default the largest of the type", gt=0,
        advanced=True,
    )  # fmt: skip
    clip_at: p.Number | None = p.number(
        None, title="Grey value from which on pixels are overexposed; by default 99 % of "
        "the largest",
        gt=0, advanced=True,
    )  # fmt: skip
    bands_out: p.File | None = p.file(
        None, title="File for the co-registered bands", suffixes=(".tif", ".tiff"), writes=True
    )
    target: p.File | None = p.file(
        None, title="File for the index; by default beside the map", suffixes=(".tif", ".tiff"),
        writes=True,
    )  # fmt: skip


class BandIndex(Algorithm[BandIndexParameters]):
    """An index of bands, such as NDVI, as a cloud-optimised GeoTIFF of 32-bit numbers.

    The bands are those of one map (a NIR-modified or multispectral camera), or of two: a colour
    camera and a NIR camera over the same ground, brought to one grid and registered on each other
    by their edges. Overexposed pixels and divisions by zero have no value.
    """

    id, name, group = "band_index", "Index of bands", "mosaic"
    needs_project = False
    outputs = (
        Output(name="index", title="Index", type="RasterLayer"),
        Output(name="bands", title="Co-registered bands", type="RasterLayer"),
        Output(name="style", title="Its colours, for QGIS"),
    )

    def run(self, context: Context, parameters: BandIndexParameters, feedback: Feedback) -> Result:
        """Compute it."""
        from georef_gis.mosaic.band_math import INDICES, Expression
        from georef_gis.rasters.resampled import open_bands
        from processing_algorithms.mosaic.band_style import write_style

        own = parameters.expression is not None
        expression = Expression(parameters.expression or INDICES[parameters.index].expression)
        targets = _Targets.of(parameters)
        with ExitStack() as stack:
            sources = [stack.enter_context(open_bands(parameters.raster))]
            _check_grid(sources[0].header)
            pair = _Pair(shift=None, left=None)
            if parameters.other is not None:
                second, pair = _other(stack, sources[0], parameters, feedback)
                sources.append(second)
            tiles = _tiles(parameters, expression, sources, stacked=targets.bands is not None)
            items = _items(parameters, tiles, pair)
            _write(context, tiles, targets, items, feedback)
        outputs = targets.outputs()
        if not own:
            outputs["style"] = write_style(targets.index, INDICES[parameters.index])
        told = tiles.account.told()
        doubts = _doubts(told, parameters, pair)
        for doubt in doubts:
            feedback.warn(doubt)
        summary = {
            "products": [str(outputs[name]) for name in ("index", "bands") if name in outputs],
            "formula": items["FORMULA"], "bands": items["BANDS"], **pair.told(), **told,
            "doubts": doubts,
        }  # fmt: skip
        return Result(outputs=outputs, summary=summary)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Targets:
    """Files to write."""

    index: Path
    bands: Path | None

    @classmethod
    def of(cls, parameters: BandIndexParameters) -> _Targets:
        """Files of the parameters, none of which is read."""
        from georef_gis.errors import InputError

        raster = Path(parameters.raster)
        suffix = "index" if parameters.expression is not None else parameters.index
        index = parameters.target or raster.with_name(f"{raster.stem}_{suffix}.tif")
        taken = [raster, *([Path(parameters.other)] if parameters.other else [])]
        for target, field in ((index, "target"), (parameters.bands_out, "bands_out")):
            if target is None:
                continue
            if any(target.resolve() == one.resolve() for one in taken):
                raise InputError(f"{target} is read or written already; name another", field=field)
            taken.append(target)
        return cls(index=index, bands=parameters.bands_out)

    def outputs(self) -> dict[str, Path]:
        """Files by the names of the tool's outputs."""
        return {"index": self.index} | ({"bands": self.bands} if self.bands else {})


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pair:
    """How two maps lie upon each other: what was found, and what is left after moving by it."""

    shift: BandShift | None
    left: BandShift | None

    def told(self) -> dict[str, Any]:
        """Figures for the summary."""
        if self.shift is None:
            return {}
        one = self.shift
        told = {
            "shift_px": [round(value, 3) for value in one.shift],
            "shift_sigma_px": round(one.sigma, 3),
            "shift_scatter_px": round(one.scatter, 3),
            "shift_windows": f"{one.agreeing} of {one.peaked} agree, {one.tried} tried",
            "shift_kind": "sloped" if one.sloped else "constant",
            "shift_applied": one.significant,
        }
        if self.left is not None:
            told["shift_left_px"] = [round(value, 3) for value in self.left.shift]
        return told


def _other(
    stack: ExitStack, first: Bands, parameters: BandIndexParameters, feedback: Feedback
) -> tuple[Bands, _Pair]:
    """The other map on the grid of the first, moved upon it."""
    from georef_gis.rasters.resampled import open_bands_on
    from processing_algorithms.mosaic.band_pair import find_shift

    assert parameters.other is not None
    path = Path(parameters.other)
    as_placed = stack.enter_context(open_bands_on(path, first.header))
    if parameters.align == "none":
        return as_placed, _Pair(shift=None, left=None)
    paths, most = (Path(parameters.raster), path), parameters.max_shift
    shift = find_shift(first, as_placed, paths, most=most, feedback=feedback)
    if not shift.significant:
        return as_placed, _Pair(shift=shift, left=None)
    moved = stack.enter_context(open_bands_on(path, first.header, moved=shift.moved))
    left = find_shift(first, moved, paths, most=most, feedback=feedback)
    feedback.info(
        f"{path.name} is moved by {shift.shift[0]:.2f}, {shift.shift[1]:.2f} px "
        f"(sigma {shift.sigma:.2f} px, {shift.agreeing} of {shift.peaked} windows agree)"
    )
    return moved, _Pair(shift=shift, left=left)


def _tiles(
    parameters: BandIndexParameters,
    expression: Expression,
    sources: Sequence[Bands],
    *,
    stacked: bool,
) -> BandTiles:
    """What makes the tiles, once it is known which bands are meant."""
    from processing_algorithms.mosaic.band_pair import ROLES, pick_bands
    from processing_algorithms.mosaic.band_tiles import BandTiles, Levels

    headers = [source.header for source in sources]
    given = {role: getattr(parameters, role) for role in ROLES}
    roles = {role: text for role, text in given.items() if text is not None}
    picked = pick_bands(expression.names, roles, headers)
    return BandTiles(
        sources=sources,
        expression=expression,
        picked=picked,
        levels=Levels(
            white=parameters.white,
            clip_at=parameters.clip_at,
            keep_clipped=parameters.clipped == "keep",
        ),
        rounded=parameters.expression is None,
        stacked=_stacked(picked, headers) if stacked else (),
    )


def _check_grid(header: MapHeader) -> None:
    from georef_gis.errors import InputError

    a, b, _, d, e, _ = header.transform
    if b != 0.0 or d != 0.0 or a <= 0.0 or e >= 0.0:
        raise InputError("is not a north-up map; give a GeoTIFF that is", source=header.name)


def _stacked(picked: dict[str, Picked], headers: Sequence[MapHeader]) -> tuple[Picked, ...]:
    """All bands of the map, and those of the other one that the formula uses, else all of it."""
    from processing_algorithms.mosaic.band_pair import pick_bands

    names = [f"b{i + 1}" for i in range(len(headers[0].bands))]
    if len(headers) > 1:
        used = sorted({one.band for one in picked.values() if one.source == 1})
        names += [f"other.b{i}" for i in used or range(1, len(headers[1].bands) + 1)]
    return tuple(pick_bands(names, {}, headers).values())


def _items(parameters: BandIndexParameters, tiles: BandTiles, pair: _Pair) -> dict[str, str]:
    """Metadata of the files."""
    from georef_gis.mosaic.band_math import INDICES

    used = sorted({one.source for one in tiles.picked.values()})
    white = {tiles.levels.white_of(tiles.sources[source].header) for source in used}
    items = {
        "SOFTWARE": "georef_gis",
        "FORMULA": tiles.expression.text,
        "BANDS": ", ".join(f"{name} = {one.told}" for name, one in tiles.picked.items()),
        "WHITE": ", ".join(f"{value:g}" for value in sorted(white)),
        "RADIOMETRY": _RADIOMETRY,
        "CLIPPED": "no value" if parameters.clipped == "mask" else "kept",
    }
    if parameters.expression is None:
        index = INDICES[parameters.index]
        items |= {"TITLE": index.name, "SOURCE": index.source}
    if pair.shift is not None:
        items["SHIFT"] = ", ".join(f"{key[6:]} {value}" for key, value in pair.told().items())
    return items


def _write(
    context: Context, tiles: BandTiles, targets: _Targets, items: dict[str, str], feedback: Feedback
) -> None:
    """Tile by tile; files appear whole or not at all."""
    from georef_gis.errors import GeometryError
    from georef_gis.rasters.writer import TiledWriter

    workers = max(1, context.workers)
    with ExitStack() as stack:
        writer = stack.enter_context(
            TiledWriter(targets.index, _index_profile(tiles, items), workers=workers)
        )
        bands = None
        if targets.bands is not None:
            profile = _stack_profile(tiles, items)
            bands = stack.enter_context(TiledWriter(targets.bands, profile, workers=workers))
        size, count = writer.profile.tile_size, writer.tile_rows * writer.tile_cols
        for number in range(count):
            row, col = divmod(number, writer.tile_cols)
            rows, cols = writer.tile_shape(row, col)
            tile = tiles.read((col * size, row * size, cols, rows))
            if tile.valid.any():
                writer.write_tile(row, col, tiles.index(tile))
            else:
                writer.skip_tile(row, col)
            if bands is not None and tile.stack_valid.any():
                bands.write_tile(row, col, tiles.stack(tile), tile.stack_valid)
            feedback.progress((number + 1) / count, f"tile {number + 1} of {count}")
            check_cancelled(feedback)
        if not tiles.account.count:
            told = tiles.account
            raise GeometryError(
                f"no pixel has a value: {told.seen} are shown by all bands, {told.clipped} of "
                f"them overexposed, {told.undefined} divided by zero; check bands and maps"
            )


def _index_profile(tiles: BandTiles, items: dict[str, str]) -> RasterProfile:
    from processing_algorithms.mosaic.band_tiles import NODATA

    name = items.get("TITLE", "index")
    return _profile(tiles.sources[0].header, items, (name,), dtype="float32", nodata=NODATA)


def _stack_profile(tiles: BandTiles, items: dict[str, str]) -> RasterProfile:
    from processing_algorithms.mosaic.band_pair import band_name

    roles = {(one.source, one.band): name for name, one in tiles.picked.items()}
    names: list[str] = []
    for one in tiles.stacked:
        name = band_name(tiles.sources[one.source].header, one.band)
        if one.source == 1:
            name = roles.get((1, one.band), name)
            name = f"other {name}" if name in names else name
        names.append(name)
    kept = {k: v for k, v in items.items() if k in ("SOFTWARE", "RADIOMETRY", "SHIFT")}
    kept["BANDS"] = ", ".join(
        f"{n} = {one.told}" for n, one in zip(names, tiles.stacked, strict=True)
    )
    return _profile(tiles.sources[0].header, kept, tuple(names), dtype=tiles.stack_dtype)


def _profile(
    header: MapHeader, items: dict[str, str], names: tuple[str, ...], *, dtype: str,
    nodata: float | None = None,
) -> RasterProfile:  # fmt: skip
    from georef_gis.rasters.profile import RasterProfile

    return RasterProfile(
        width=header.width, height=header.height, transform=header.transform,
        crs_wkt=header.crs_wkt, epsg=header.epsg, bands=len(names), dtype=dtype,
        compression="deflate", band_descriptions=names, metadata=items, nodata=nodata,
        validity="mask" if nodata is None else None,
    )  # fmt: skip


def _doubts(told: dict[str, float], parameters: BandIndexParameters, pair: _Pair) -> list[str]:
    doubts = []
    if pair.shift is not None and pair.shift.scatter > _UNEVEN:
        doubts.append(
            f"the shift between the maps differs by {pair.shift.scatter:.1f} px from place to "
            "place; edges are off by that"
        )
    share = told["clipped_share"]
    if share > 0.01:
        fate = "have no value" if parameters.clipped == "mask" else "have a wrong one"
        doubts.append(f"{share:.1%} of the pixels are overexposed in a band and {fate}")
    if told["undefined_share"] > 0.01:
        doubts.append(f"{told['undefined_share']:.1%} of the pixels are black in all bands")
    return doubts
