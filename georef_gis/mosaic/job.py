"""What the tiles of a mosaic are made from, as one value for other processes and machines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from georef_gis.errors import InputError
from georef_gis.model.grid import Grid
from georef_gis.model.mesh import Ground
from georef_gis.mosaic.nadir import MosaicSource, NadirMosaic
from georef_gis.mosaic.seam_mismatch import MismatchProbe
from georef_gis.mosaic.seamed import ColourField, SeamMosaic, Seams
from georef_gis.rasters.reading import decode_image, read_image
from georef_gis.rasters.warp import Image

Read = Callable[[Path, int], Image]


def checked_reader(get: Read, kind: tuple[int, str]) -> Read:
    """Reader of photos that refuses those whose bands are not the mosaic's."""

    def read(path: Path, reduce: int) -> Image:
        image = get(path, reduce)
        own = (int(image.shape[2]), str(image.dtype))
        if own != kind:
            raise InputError(
                f"has bands {own[0]} x {own[1]} where the mosaic has {kind[0]} x {kind[1]}: not in "
                "the mosaic; make it a mosaic of its own",
                source=path.name,
            )
        return image

    return read


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MosaicJob:
    """All that tiles follow from; can be pickled.

    Parameters
    ----------
    sources
        The photos, in the order that labels of the seams count.
    gsd : m
    kind
        Number and type of the bands; other photos are refused.
    seams
        Which photo has which ground; None = the photo with the nearest nadir.
    field
        What is done to grey values along seams; None leaves them.
    probe
        Where on the seams photos are compared; None = nowhere.
    """

    sources: tuple[MosaicSource, ...]
    ground: Ground
    grid: Grid
    gsd: float
    kind: tuple[int, str]
    seams: Seams | None = None
    field: ColourField | None = None
    probe: MismatchProbe | None = None

    def open(self, read: Read, broken: list[str]) -> NadirMosaic | SeamMosaic:
        """Who makes the tiles; `broken` takes the messages of photos that cannot be read."""
        read = checked_reader(read, self.kind)
        if self.seams is None:
            sources = {source.photo.id: source for source in self.sources}
            return NadirMosaic(
                sources, self.ground, self.grid, gsd=self.gsd, read=read, broken=broken
            )
        return SeamMosaic(
            self.sources, self.ground, self.grid, seams=self.seams, field=self.field, read=read,
            broken=broken,
        )  # fmt: skip


def read_photo(path: Path | str, reduce: int) -> Image:
    """Pixels of a photo of a mosaic: its alpha channel is no band.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    return read_image(path, reduce=reduce, alpha=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoRoot:
    """Where workers find the photos.

    Parameters
    ----------
    here
        Folder of all photos on the machine that knows the project.
    there
        The same folder as workers see it, or a URL that fsspec opens, such as s3://bucket/photos;
        empty = the same path.
    """

    here: Path
    there: str = ""

    def place(self, path: Path) -> str:
        """Path or URL of a photo for workers; a photo beside the folder stays where it is."""
        if not self.there or not path.is_relative_to(self.here):
            return str(path)
        return "/".join([self.there.rstrip("/\\"), *path.relative_to(self.here).parts])

    def read(self, path: Path, reduce: int) -> Image:
        """Pixels of a photo, as `read_photo` gives them.

        Raises
        ------
        InputError
            If it cannot be read; as of the photo on a local disk.
        """
        place = self.place(path)
        if "://" not in place:
            return read_photo(place, reduce)
        return decode_image(_fetched(place, path.name), path.name, reduce=reduce, alpha=False)


def _fetched(url: str, name: str) -> bytes:
    """Bytes behind a URL."""
    import fsspec

    try:
        with fsspec.open(url, "rb") as file:
            return bytes(file.read())
    except ImportError as error:
        scheme = url.partition("://")[0]
        raise InputError(
            f"{scheme}:// needs a package on the workers ({error}); install it there", source=name
        ) from error
    except Exception as error:  # every object storage has errors of its own
        told = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"cannot be read ({told}); check photos_root", source=name) from error
