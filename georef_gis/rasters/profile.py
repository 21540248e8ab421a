"""What a raster file is: size, place, samples and compression, checked once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from georef_gis.errors import InputError

Compression = Literal["jpeg", "deflate", "zstd", "webp"]
Validity = Literal["mask", "alpha", "nodata", "none"]
# a, b, c, d, e, f: x = a*col + b*row + c, y = d*col + e*row + f, CRS units, (0, 0) = outer corner
Transform = tuple[float, float, float, float, float, float]

DTYPES = ("uint8", "uint16", "int16", "float32")
# Highest effort of the lossless codecs.
_LEVELS = {"deflate": 9, "zstd": 22}
# TIFF asks for tiles of whole 16-pixel blocks.
TILE_STEP = 16
# px; the TIFF header's limit would be 2^32, GDAL reads sizes as signed integers.
MAX_SIDE = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class RasterProfile:
    """What a raster file is.

    Parameters
    ----------
    width, height
        Size of the full resolution, px.
    transform
        Grid to map, north-up: ``(a, b, c, d, e, f)``, CRS units per px, (0, 0) = outer corner.
    crs_wkt
        The CRS, WKT 1 or 2; empty for a raster without a place.
    epsg
        Code of the whole CRS when it has one.
    bands
        Bands of colour or value, without alpha.
    dtype
        One of uint8, uint16, int16, float32.
    quality
        Of JPEG and WEBP, 1 to 100.
    level
        Effort of DEFLATE (1 to 9, default 6) and ZSTD (1 to 22, default 9).
    tile_size
        Side of a tile, px, a multiple of 16.
    band_descriptions
        One name a band, or none.
    metadata
        Items of the dataset, as GDAL shows them.
    nodata
        Value of missing pixels.
    validity
        How missing pixels are told: an internal 1-bit mask, an alpha band, the nodata value,
        or not at all. By default nodata if there is one; alpha for DEFLATE, ZSTD and WEBP of 1 or
        3 bands of unsigned integers; else a mask.
    """

    width: int
    height: int
    transform: Transform
    crs_wkt: str = ""
    epsg: int | None = None
    bands: int = 3
    dtype: str = "uint8"
    compression: Compression = "jpeg"
    quality: int = 85
    level: int | None = None
    tile_size: int = 512
    band_descriptions: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    nodata: float | None = None
    validity: Validity | None = None

    def __post_init__(self) -> None:
        """Check the values and settle how missing pixels are told."""
        if self.validity is None:
            object.__setattr__(self, "validity", self._default_validity())
        self._check_grid()
        self._check_samples()

    @property
    def alpha(self) -> bool:
        """Whether the file has an alpha band after the others."""
        return self.validity == "alpha"

    @property
    def samples(self) -> int:
        """Samples per pixel in the file, alpha included."""
        return self.bands + self.alpha

    @property
    def fill(self) -> float:
        """Value of missing pixels in the file."""
        return 0.0 if self.nodata is None else self.nodata

    def _default_validity(self) -> Validity:
        if self.nodata is not None:
            return "nodata"
        alpha = self.compression != "jpeg" and self.dtype[:1] == "u" and self.bands in (1, 3)
        return "alpha" if alpha else "mask"

    def _check_grid(self) -> None:
        if not (1 <= self.width <= MAX_SIDE and 1 <= self.height <= MAX_SIDE):
            raise ValueError(f"raster of {self.width} x {self.height} px: sides must be >= 1 px")
        if self.tile_size < TILE_STEP or self.tile_size % TILE_STEP:
            raise ValueError(f"tile_size {self.tile_size} px: must be a multiple of {TILE_STEP}")
        if len(self.transform) != 6 or not all(math.isfinite(value) for value in self.transform):
            raise ValueError(f"transform {self.transform}: six finite numbers are needed")
        a, b, _, d, e, _ = self.transform
        if b != 0.0 or d != 0.0 or a <= 0.0 or e >= 0.0:
            raise ValueError(
                f"transform {self.transform}: must be north-up (a > 0, e < 0, b = d = 0)"
            )

    def _check_samples(self) -> None:
        if self.dtype not in DTYPES:
            raise InputError(
                f"{self.dtype} cannot be written; use {', '.join(DTYPES)}", field="dtype"
            )
        if self.bands < 1 or len(self.band_descriptions) not in (0, self.bands):
            raise ValueError(f"{len(self.band_descriptions)} descriptions for {self.bands} bands")
        if self.compression in ("jpeg", "webp"):
            self._check_lossy()
        elif self.compression in _LEVELS:
            most = _LEVELS[self.compression]
            if self.level is not None and not 1 <= self.level <= most:
                raise InputError(f"level {self.level} is not in 1 to {most}", field="level")
        else:
            raise InputError(
                f"{self.compression} is unknown; use jpeg, deflate, zstd or webp",
                field="compression",
            )
        if (self.validity == "nodata") != (self.nodata is not None):
            raise InputError(
                f"validity {self.validity} does not go with nodata {self.nodata}; "
                "give nodata exactly when missing pixels are told by it",
                field="nodata",
            )
        # GDAL takes alpha for a mask in files of two or four bands only
        if self.alpha and (self.dtype not in ("uint8", "uint16") or self.bands not in (1, 3)):
            raise InputError(
                f"alpha goes with 1 or 3 bands of uint8 or uint16, not {self.bands} of "
                f"{self.dtype}; use validity mask or nodata",
                field="validity",
            )

    def _check_lossy(self) -> None:
        name = self.compression.upper()
        fits = self.bands in ((1, 3) if self.compression == "jpeg" else (3,))
        if not fits or self.dtype != "uint8":
            takes = "1 or 3 bands" if self.compression == "jpeg" else "3 bands"
            raise InputError(
                f"{name} holds {takes} of uint8, not {self.bands} of {self.dtype}; "
                "use deflate or zstd",
                field="compression",
            )
        if self.validity == "nodata":
            raise InputError(
                f"{name} is lossy and cannot keep a nodata value; "
                "leave nodata out or use deflate or zstd",
                field="nodata",
            )
        if self.compression == "jpeg" and self.alpha:
            raise InputError(
                "JPEG cannot hold alpha; use validity mask, or webp, deflate or zstd",
                field="validity",
            )
        if self.compression == "webp" and self.validity == "mask":
            raise InputError("WEBP comes with alpha, not with a mask; use alpha", field="validity")
        if not 1 <= self.quality <= 100:
            raise InputError(f"quality {self.quality} is not in 1 to 100", field="quality")
