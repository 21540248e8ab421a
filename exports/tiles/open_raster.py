"""A raster file and its overviews, open together."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self


class OpenRaster:
    """A raster and its overviews, open until the end of a `with` statement.

    Parameters
    ----------
    cache_mb
        Size of GDAL's cache of decoded tiles meanwhile.
    """

    def __init__(self, path: Path, cache_mb: int) -> None:
        import rasterio

        with ExitStack() as files:
            files.enter_context(rasterio.Env(GDAL_CACHEMAX=cache_mb))
            self.full: Any = files.enter_context(rasterio.open(path))
            self.levels: dict[int, Any] = {1: self.full}
            """The raster and its overviews, by their pixel as a multiple of the raster's."""
            for k, factor in enumerate(self.full.overviews(1)):
                level = files.enter_context(rasterio.open(path, overview_level=k))
                self.levels[factor] = level
            self._files = files.pop_all()

    def __enter__(self) -> Self:
        """Give the open raster."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._files.close()

    @property
    def coarsest(self) -> Any:
        """The coarsest overview, or the raster itself."""
        return self.levels[max(self.levels)]

    def factor_for(self, wanted: float) -> int:
        """Of the coarsest level that is at least as fine as `wanted` pixels of the raster."""
        return max(factor for factor in self.levels if factor <= max(wanted * 1.001, 1.0))
