"""Tiles of an index, and of the stack of bands it is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.mosaic.band_math import Expression, Values
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import Bands, MapHeader
from processing_algorithms.mosaic.band_pair import Picked

NODATA = -9999.0
# 2^-13 of an index is less than the noise of 16 bits, and packs to half the file
_STEP = 2.0**-13
# of the largest value: JPEG and resampling scatter the values of an overexposed area
_CLIPPED = 0.99


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """How grey values are read.

    Parameters
    ----------
    white
        Grey value that counts as 1; None = the largest of the type, 1 for floating point.
    clip_at
        Grey value from which on a pixel is clipped; None = 99 % of the largest of the type, never
        for floating point.
    keep_clipped
        Compute them none the less.
    """

    white: float | None = None
    clip_at: float | None = None
    keep_clipped: bool = False

    def white_of(self, header: MapHeader) -> float:
        """White level of a map, in its values."""
        if self.white is not None:
            return self.white
        scaled = any(scale != (1.0, 0.0) for scale in header.scales)
        return _largest(header.dtype) if header.dtype[0] in "ui" and not scaled else 1.0

    def clip_of(self, header: MapHeader) -> float:
        """Grey value of a map from which on it is clipped."""
        if self.clip_at is not None:
            return self.clip_at
        return _CLIPPED * _largest(header.dtype) if header.dtype[0] in "ui" else np.inf


@dataclass(slots=True)
class Account:
    """What the tiles held."""

    seen: int = 0
    clipped: int = 0
    undefined: int = 0
    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    lowest: float = np.inf
    highest: float = -np.inf

    def add(self, values: Values) -> None:
        """Take in the values of a tile."""
        if not values.size:
            return
        self.count += values.size
        self.total += float(values.sum())
        self.squares += float((values**2).sum())
        self.lowest = min(self.lowest, float(values.min()))
        self.highest = max(self.highest, float(values.max()))

    def told(self) -> dict[str, float]:
        """Figures for the summary; shares are of the pixels that all bands show."""
        seen, count = max(self.seen, 1), max(self.count, 1)
        mean = self.total / count
        deviation = max(self.squares / count - mean**2, 0.0) ** 0.5
        return {
            "pixels": self.count,
            "clipped_share": round(self.clipped / seen, 5),
            "undefined_share": round(self.undefined / seen, 5),
            "mean": round(mean, 4),
            "deviation": round(deviation, 4),
            "lowest": round(self.lowest, 4),
            "highest": round(self.highest, 4),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileSamples:
    """Bands of a tile as stored.

    Parameters
    ----------
    samples
        By map and band, each of shape (rows, cols).
    valid, stack_valid : shape (rows, cols)
        Where all bands of the formula, and all of the stack, have a value.
    """

    samples: dict[tuple[int, int], NDArray[Any]]
    valid: NDArray[np.bool_]
    stack_valid: NDArray[np.bool_]


@dataclass(slots=True, kw_only=True)
class BandTiles:
    """Makes tiles of one formula.

    Parameters
    ----------
    sources
        The map, and the other one on its grid.
    picked
        Band of every name of the formula.
    rounded
        Round to 2^-13, for indices of about 1.
    stacked
        Bands of the stack; empty = none.
    """

    sources: Sequence[Bands]
    expression: Expression
    picked: Mapping[str, Picked]
    levels: Levels
    rounded: bool
    stacked: Sequence[Picked] = ()
    account: Account = field(default_factory=Account)

    def read(self, window: Window) -> TileSamples:
        """Samples of every band that is used or stacked."""
        tile = TileSamples(
            samples={},
            valid=np.ones((window[3], window[2]), np.bool_),
            stack_valid=np.ones((window[3], window[2]), np.bool_),
        )
        used = {(one.source, one.band) for one in self.picked.values()}
        stacked = {(one.source, one.band) for one in self.stacked}
        for number, source in enumerate(self.sources):
            bands = sorted(band for own, band in used | stacked if own == number)
            if not bands:
                continue
            read, seen = source.read(window, bands)
            for i, band in enumerate(bands):
                tile.samples[number, band] = read[:, :, i]
                if (number, band) in used:
                    np.logical_and(tile.valid, seen[:, :, i], out=tile.valid)
                if (number, band) in stacked:
                    np.logical_and(tile.stack_valid, seen[:, :, i], out=tile.stack_valid)
        return tile

    def index(self, tile: TileSamples) -> NDArray[np.float32]:
        """Values of a tile, `NODATA` where there are none."""
        bands: dict[str, Values] = {}
        valid, clipped = tile.valid, np.zeros_like(tile.valid)
        for name, one in self.picked.items():
            header = self.sources[one.source].header
            raw = tile.samples[one.source, one.band]
            factor, offset = header.scales[one.band - 1]
            bands[name] = (raw.astype(np.float64) * factor + offset) / self.levels.white_of(header)
            clipped |= raw >= self.levels.clip_of(header)
        values = np.where(valid, self.expression.evaluate(bands), np.nan)
        if self.rounded:
            values = np.round(values / _STEP) * _STEP
        self.account.seen += int(valid.sum())
        self.account.clipped += int((valid & clipped).sum())
        if not self.levels.keep_clipped:
            valid = valid & ~clipped
        finite = np.isfinite(values)
        self.account.undefined += int((valid & ~finite).sum())
        kept = valid & finite
        self.account.add(values[kept])
        return np.where(kept, values, NODATA).astype(np.float32)

    def stack(self, tile: TileSamples) -> NDArray[Any]:
        """Bands of a tile upon each other, shape (rows, cols, bands), of `stack_dtype`."""
        kind = np.dtype(self.stack_dtype)
        layers = []
        for one in self.stacked:
            raw = tile.samples[one.source, one.band]
            # black and white stay black and white
            spread = 257 if raw.dtype == np.uint8 and kind == np.uint16 else 1
            layers.append(raw.astype(kind) * kind.type(spread))
        return np.stack(layers, axis=2)

    @property
    def stack_dtype(self) -> str:
        """Type that holds all bands of the stack."""
        kinds = {self.sources[one.source].header.dtype for one in self.stacked}
        if kinds <= {"uint8"}:
            return "uint8"
        return "uint16" if kinds <= {"uint8", "uint16"} else "float32"


def _largest(dtype: str) -> float:
    return float(np.iinfo(dtype).max)
