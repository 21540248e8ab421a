"""The file of marks, edited mark by mark: what else stands in it stays as it is."""

from __future__ import annotations

import csv
import io
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from georef_gis.errors import InputError

COLUMNS = ("name", "photo", "u", "v", "sigma_px")
# what a matched mark has in common with others; one that was clicked anew has nothing
SHARED = "shared_px"
_NEEDED = COLUMNS[:4]
# What a mark is called must survive the file.
_UNFIT = re.compile(r"[\x00-\x1f\x7f]|^\s|\s$")


def set_mark(
    path: Path,
    name: str,
    photo: str,
    uv: tuple[float, float] | None,
    *,
    sigma_px: float,
    is_photo: Callable[[str], bool],
) -> None:
    """Put a mark in place of that of the same point and photo; None takes it away.

    The file appears whole or not at all; as it was before the first change it stays beside it as
    ``marks.csv.bak``.

    Parameters
    ----------
    photo
        As the file is to write it.
    is_photo
        Whether a photo, as the file writes it, is that one.

    Raises
    ------
    InputError
        If the file is no table of marks with a header of `COLUMNS`, or cannot be written.
    """
    if _UNFIT.search(name) or not name:
        raise InputError(f"{name[:40]!r} is no name of a point", field="name")
    header, rows = _read(path)
    at = {column: header.index(column) for column in (*COLUMNS, SHARED) if column in header}

    def is_same(row: Sequence[str]) -> bool:
        if len(row) < len(header) or row[0].lstrip().startswith("#"):
            return False
        return row[at["name"]].strip() == name and is_photo(row[at["photo"]].strip())

    place = next((i for i, row in enumerate(rows) if is_same(row)), len(rows))
    kept = [row for row in rows if not is_same(row)]
    if uv is not None:
        old = rows[place] if place < len(rows) else [""] * len(header)
        kept.insert(min(place, len(kept)), _row(old, at, name, photo, uv, sigma_px))
    _write(path, [header, *kept])


def _row(
    old: Sequence[str], at: dict[str, int], name: str, photo: str, uv: tuple[float, float],
    sigma_px: float,
) -> list[str]:  # fmt: skip
    values = {"name": name, "photo": old[at["photo"]] or photo, "u": f"{uv[0]:.3f}",
              "v": f"{uv[1]:.3f}", "sigma_px": f"{sigma_px:.2f}", SHARED: ""}  # fmt: skip
    new = list(old)
    for column, k in at.items():
        new[k] = values[column]
    return new


def _read(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and rows; a file that is not there yet has the header alone."""
    try:
        text = path.read_text("utf-8-sig")
    except FileNotFoundError:
        return list(COLUMNS), []
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", source=str(path)) from error
    rows = list(csv.reader(io.StringIO(text, newline="")))
    header = [cell.strip() for cell in rows[0]] if rows else list(COLUMNS)
    if any(header.count(column) != 1 for column in _NEEDED):
        raise InputError(
            f"cannot be edited here: its first line is not {','.join(COLUMNS)}; save its marks in "
            "such a table and name it in [control] marks",
            source=path.name,
        )
    return header, [row for row in rows[1:] if row]


def _write(path: Path, rows: Sequence[Sequence[str]]) -> None:
    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    stream = io.StringIO(newline="")
    csv.writer(stream, lineterminator="\n").writerows(rows)
    content = stream.getvalue().encode()
    backup = path.with_name(path.name + ".bak")
    with export_errors(path, lambda: len(content)):
        if path.exists() and not backup.exists():
            shutil.copy2(path, backup)
        with whole_file(resolve_target(path)) as file:
            file.write(content)


def has_rows(path: Path) -> bool:
    """Whether a file holds more than its first line; one that cannot be read is others' to tell."""
    try:
        lines = path.read_text("utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return sum(bool(line.strip()) and not line.startswith("#") for line in lines) > 1


def name_mark_file(settings: Path, marks: str) -> bool:
    """Name a file of marks in project.toml, where a comment waits for it; whether that was done."""
    from georef_gis.rasters.files import whole_file

    text = settings.read_text("utf-8")
    section = re.search(r"^\[control\][^\n]*\n(?:(?!\[).*\n?)*", text, re.MULTILINE)
    if section is None:
        return False
    line = re.compile(r"^#\s*marks\s*=\s*(#.*)?$", re.MULTILINE)
    new, count = line.subn(lambda found: f'marks = "{marks}"  {found[1] or ""}'.rstrip(),
                           section[0], count=1)  # fmt: skip
    if not count:
        return False
    with whole_file(settings) as file:
        file.write((text[: section.start()] + new + text[section.end() :]).encode())
    return True
