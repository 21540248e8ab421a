"""How much memory GDAL may keep of what it has read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def gdal_cache(megabytes: int) -> Iterator[None]:
    """Let GDAL keep so many decoded blocks; by itself it takes 5 % of the machine's memory."""
    import rasterio

    # in bytes: rasterio hands the number on as it is, and few bytes would be no cache at all
    with rasterio.Env(GDAL_CACHEMAX=megabytes << 20):
        yield
