"""Exporter of the mosaic as PMTiles 3: web tiles in one file that any web server can hold."""

from __future__ import annotations

import gzip
import hashlib
import json
import tempfile
from array import array
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from exports.tiles.options import TileOptions
from exports.tiles.web_tiles import write_tiles
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from pmtiles.tile import HeaderDict

    from exports.tiles.web_plan import TileSet

    Entries = NDArray[Any]

# bytes; a reader's first request gets the header and the root directory
_HEADER, _FIRST_READ = 127, 16384
# Entries of a leaf directory, more where the root would grow too large.
_LEAF = 4096


class Pmtiles(Exporter[TileOptions]):
    """The mosaic, or another GeoTIFF, as PMTiles 3: web tiles in one file on any web server.

    A browser reads the tiles it needs by ranges of bytes; no tile server is needed. Pictures are
    for the eye: their CRS is web mercator and their pixels are packed with loss. Measure in the
    mosaic itself. While it is written, twice its size is needed on the disk.
    """

    id = "pmtiles"
    name = "PMTiles"
    suffix = ".pmtiles"
    accepts = ("raster",)
    target = "mosaic.pmtiles"
    needs = ("mosaic",)
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: TileOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the tiles to `target`."""
        stop = partial(check_cancelled, feedback)
        return write_tiles(source, options, feedback, lambda tiles: _archive(target, tiles, stop))


class SpoolSink:
    """Tiles in the order they come, in one nameless file, and 40 bytes on each in memory."""

    def __init__(self, stream: BinaryIO) -> None:
        from pmtiles.tile import zxy_to_tileid

        self._stream, self._id_of = stream, zxy_to_tileid
        self._ids, self._offsets = array("Q"), array("Q")
        self._lengths, self._digests = array("Q"), array("Q")
        self._size = 0

    def put(self, zoom: int, x: int, y: int, data: bytes) -> None:
        """Take one tile."""
        self._stream.write(data)
        self._ids.append(self._id_of(zoom, x, y))
        self._offsets.append(self._size)
        self._lengths.append(len(data))
        self._digests.frombytes(hashlib.blake2b(data, digest_size=16).digest())
        self._size += len(data)

    def index(self) -> Index:
        """Where the tiles go: in the order of their ids, equal ones once."""
        import numpy as np

        ids = np.frombuffer(self._ids, dtype=np.uint64)
        order = np.argsort(ids)
        lengths = np.frombuffer(self._lengths, dtype=np.uint64)[order]
        digests = np.frombuffer(self._digests, dtype=np.uint64).reshape(-1, 2)[order]
        _, first, back = np.unique(digests, axis=0, return_index=True, return_inverse=True)
        original = first[back.ravel()]
        is_new = original == np.arange(len(order))
        ends = np.cumsum(np.where(is_new, lengths, 0), dtype=np.uint64)
        return Index(
            ids=ids[order],
            offsets=(ends - lengths)[original],
            lengths=lengths,
            spooled=np.frombuffer(self._offsets, dtype=np.uint64)[order],
            is_new=is_new,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Index:
    """Tiles of an archive in the order of their ids.

    Parameters
    ----------
    ids : shape (n,)
        Numbers of tiles along Hilbert curves, zoom by zoom.
    offsets, lengths : shape (n,)
        Of their bytes in the archive's tile data.
    spooled : shape (n,)
        Of their bytes in the spool.
    is_new : shape (n,)
        Whether no tile before has the same bytes.
    """

    ids: NDArray[Any]
    offsets: NDArray[Any]
    lengths: NDArray[Any]
    spooled: NDArray[Any]
    is_new: NDArray[Any]

    @property
    def data_length(self) -> int:
        """Bytes of all tiles."""
        return int(self.lengths[self.is_new].sum())

    def entries(self) -> Entries:
        """Entries of directories: neighbours of the same bytes are one."""
        import numpy as np

        same = (np.diff(self.ids) == 1) & (np.diff(self.offsets) == 0)
        starts = np.flatnonzero(np.concatenate([[True], ~same]))
        runs = np.diff(np.append(starts, len(self.ids)))
        columns = (self.ids[starts], self.offsets[starts], self.lengths[starts], runs)
        return np.stack([column.astype(np.uint64) for column in columns], axis=1)


@contextmanager
def _archive(target: Path, tiles: TileSet, stop: Callable[[], None]) -> Iterator[SpoolSink]:
    with tempfile.TemporaryFile(dir=target.parent) as stream:
        sink = SpoolSink(stream)
        yield sink
        index = sink.index()
        with target.open("wb") as archive:
            _write_head(archive, tiles, index)
            for start, length in zip(
                index.spooled[index.is_new].tolist(), index.lengths[index.is_new].tolist(),
                strict=True,
            ):  # fmt: skip
                stop()
                stream.seek(start)
                archive.write(stream.read(length))


def _write_head(archive: BinaryIO, tiles: TileSet, index: Index) -> None:
    """All that comes before the tiles: header, root directory, metadata, leaf directories."""
    from pmtiles.tile import serialize_header

    entries = index.entries()
    root, leaves = directories(entries)
    document = tiles.tilejson() | {"type": "baselayer"}
    metadata = gzip.compress(json.dumps(document, ensure_ascii=False).encode(), mtime=0)
    sizes = (len(root), len(metadata), len(leaves), index.data_length)
    header = _header(tiles, sizes, (len(index.ids), len(entries), int(index.is_new.sum())))
    for part in (serialize_header(header), root, metadata, leaves):
        archive.write(part)


def _header(
    tiles: TileSet, sizes: tuple[int, int, int, int], counts: tuple[int, int, int]
) -> HeaderDict:
    """Header of an archive.

    Parameters
    ----------
    sizes
        Of root directory, metadata, leaf directories and tile data, bytes, in this order.
    counts
        Of tiles, entries and different tiles.
    """
    from pmtiles.tile import Compression, TileType

    west, south, east, north = (round(value * 1e7) for value in tiles.bounds)
    lon, lat, zoom = tiles.center
    root, metadata, leaves, data = sizes
    kinds = {"jpg": TileType.JPEG, "png": TileType.PNG, "webp": TileType.WEBP}
    return {
        "version": 3,
        "root_offset": _HEADER,
        "root_length": root,
        "metadata_offset": _HEADER + root,
        "metadata_length": metadata,
        "leaf_directory_offset": _HEADER + root + metadata,
        "leaf_directory_length": leaves,
        "tile_data_offset": _HEADER + root + metadata + leaves,
        "tile_data_length": data,
        "addressed_tiles_count": counts[0],
        "tile_entries_count": counts[1],
        "tile_contents_count": counts[2],
        "clustered": True,
        "internal_compression": Compression.GZIP,
        "tile_compression": Compression.NONE,
        "tile_type": kinds[tiles.format],
        "min_zoom": tiles.min_zoom,
        "max_zoom": tiles.max_zoom,
        "min_lon_e7": west,
        "min_lat_e7": south,
        "max_lon_e7": east,
        "max_lat_e7": north,
        "center_zoom": zoom,
        "center_lon_e7": round(lon * 1e7),
        "center_lat_e7": round(lat * 1e7),
    }


def directories(entries: Entries) -> tuple[bytes, bytes]:
    """Root directory, which the first read of a reader must hold, and the leaves behind it.

    Parameters
    ----------
    entries : shape (n, 4)
        Id, offset, length and run of tiles, in the order of ids.
    """
    if len(entries) < _FIRST_READ:
        root = _directory(entries)
        if len(root) <= _FIRST_READ - _HEADER:
            return root, b""
    size = _LEAF
    while True:
        root, leaves = _two_levels(entries, size)
        if len(root) <= _FIRST_READ - _HEADER:
            return root, leaves
        size *= 2


def _two_levels(entries: Entries, size: int) -> tuple[bytes, bytes]:
    import numpy as np

    leaves, pointers = bytearray(), []
    for start in range(0, len(entries), size):
        leaf = _directory(entries[start : start + size])
        # A run of 0 tells a reader that the entry is of a leaf.
        pointers.append((int(entries[start, 0]), len(leaves), len(leaf), 0))
        leaves += leaf
    return _directory(np.array(pointers, dtype=np.uint64)), bytes(leaves)


def _directory(entries: Entries) -> bytes:
    from pmtiles.tile import Entry, serialize_directory

    return serialize_directory([Entry(*row) for row in entries.tolist()])
