"""Columns in one ``.npz``, whole or not at all: what a project keeps beside its database."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from georef_gis.errors import InputError

FORMAT = 1
_BROKEN = (OSError, ValueError, KeyError, EOFError, BadZipFile)
_CURE = "run `georef run` to make it anew"


def write_columns(path: Path, kind: str, columns: Mapping[str, Any]) -> None:
    """Write columns beside the file's kind and format.

    Parameters
    ----------
    path
        In a folder that exists; an older file is replaced.
    kind
        What the columns are, e.g. "inertial"; `read_columns` asks for the same word.
    columns
        Name -> array, text or texts; not named `kind` or `format`.
    """
    arrays = {name: np.asarray(value) for name, value in columns.items()}
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, kind=np.asarray(kind), format=FORMAT, **arrays)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def read_columns(path: Path, kind: str) -> dict[str, Any]:
    """Read what `write_columns` wrote; texts come as arrays of text.

    Raises
    ------
    InputError
        If the file is none of ours, of another kind or version, or cut off.
    """
    found = kind_of(path)
    if found != kind:
        raise InputError(f"holds {found!r}, not {kind!r}; {_CURE}", source=str(path))
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            if int(file["format"]) != FORMAT:
                raise InputError(f"is of another version; {_CURE}", source=str(path))
            return {name: file[name] for name in file.files if name not in ("kind", "format")}
    except _BROKEN as error:
        raise InputError(f"cannot be read ({error}); {_CURE}", source=str(path)) from error


@contextmanager
def columns_of(path: Path, kind: str, *, cure: str = _CURE) -> Iterator[dict[str, Any]]:
    """Columns for a `with` that makes a value of them: one that does not fit is the file's fault.

    Parameters
    ----------
    cure
        What makes the file anew.

    Raises
    ------
    InputError
        As `read_columns`; and in place of a KeyError or ValueError within the `with`.
    """
    read = read_columns(path, kind)
    try:
        yield read
    except (KeyError, ValueError) as error:
        raise InputError(f"holds no {kind} ({error}); {cure}", source=str(path)) from error


def kind_of(path: Path) -> str:
    """Kind that a file was written with.

    Raises
    ------
    InputError
        If the file is none of ours.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return str(file["kind"])
    except _BROKEN as error:
        raise InputError(
            f"holds no columns of ours ({error}); {_CURE}", source=str(path)
        ) from error
