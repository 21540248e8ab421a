"""Features kept on disk, so that a second search does not read the photos again."""

from __future__ import annotations

import hashlib
import logging
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.orient.ties.features import Features

logger = logging.getLogger(__name__)

# raised with every change of the features themselves
VERSION = 1
_ARRAYS = ("uv", "size", "angle", "descriptors")


@dataclass(frozen=True, slots=True)
class FeatureCache:
    """Features of photos in a folder; without one nothing is kept.

    A file's key is the photo's path, size and time of change with the parameters; a file of the
    cache that is damaged counts as none.
    """

    folder: Path | None
    # what features depend on
    parameters: tuple[int, ...]

    def load(self, photo: Path) -> Features | None:
        """Features kept of a photo file."""
        kept = self._file(photo)
        return None if kept is None else _load(kept)

    def save(self, photo: Path, features: Features) -> None:
        """Keep features of a photo file."""
        kept = self._file(photo)
        if kept is not None:
            _save(kept, features)

    def _file(self, photo: Path) -> Path | None:
        if self.folder is None:
            return None
        try:
            status = photo.stat()
        except OSError:
            return None
        words = (VERSION, os.path.abspath(photo), status.st_size, status.st_mtime_ns)
        name = hashlib.blake2b(repr((words, self.parameters)).encode(), digest_size=12).hexdigest()
        return self.folder / f"features-{name}.npz"


def _load(path: Path) -> Features | None:
    try:
        # Opened here, as numpy leaves a damaged file open.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in _ARRAYS}
            scale, width, height = kept["numbers"].tolist()
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        logger.warning("cache %s is damaged (%s): made anew", path.name, error)
        return None
    n = len(arrays["uv"])
    shapes = {"uv": (n, 2), "size": (n,), "angle": (n,), "descriptors": (n, 128)}
    if any(arrays[name].shape != shape for name, shape in shapes.items()):
        logger.warning("cache %s is damaged (shapes): made anew", path.name)
        return None
    return Features(**arrays, scale=scale, width=int(width), height=int(height))


def _save(path: Path, features: Features) -> None:
    """Write beside, then rename: a run that is stopped leaves no half file under the name."""
    beside = path.with_suffix(f".{os.getpid()}.part")
    arrays = {name: getattr(features, name) for name in _ARRAYS}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside.open("wb") as stream:
            numbers = np.array([features.scale, features.width, features.height], dtype=float)
            np.savez(stream, numbers=numbers, **arrays)
        beside.replace(path)
    except OSError as error:
        # The features are there all the same: a full disk costs but the next run's time.
        logger.warning("cache %s cannot be written (%s)", path.name, error)
        beside.unlink(missing_ok=True)
