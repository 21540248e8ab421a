"""The order of the chapters, for a reader who begins at the top."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# Pages that are made by the build.
MADE = ("tools/index", "settings")
# Chapters that lie elsewhere in the repository: name in the site and file.
BORROWED = {"benchmarks": "benchmarks/README.md", "changelog": "CHANGELOG.md"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A heading of the navigation and the names of its pages."""

    title: str
    pages: tuple[str, ...]


PARTS = (
    Part(title="Start", pages=("quick_start", "start")),
    Part(
        title="How to",
        pages=(
            "page", "measure", "assets", "work_zone", "surface", "control", "accuracy_statement",
            "report", "plan_flight", "batch", "change", "qgis", "google_earth", "band_index",
            "calibration",
        ),
    ),
    Part(
        title="Reference",
        pages=(
            *MADE, "values", "formats", "metadata", "frames", "heights", "crs", "accuracy",
            "error_budget", "logs", "tagged_photos", "sync_board",
        ),
    ),
    Part(title="How it works", pages=("navigation", "ppk", "ekf9", "adjustment", "mosaic")),
    Part(title="Developers", pages=("architecture", "benchmarks", "changelog")),
)  # fmt: skip

# Where a reader looks first whose command no chapter names, by group of tools.
CHAPTER_OF_GROUP = {
    "project": "start",
    "ingest": "formats",
    "navigate": "navigation",
    "orient": "adjustment",
    "rectify": "mosaic",
    "mosaic": "mosaic",
    "measure": "measure",
    "export": "formats",
}


def ordered() -> tuple[str, ...]:
    """Names of all pages, in the order of reading."""
    return tuple(page for part in PARTS for page in part.pages)


def written(root: Path) -> dict[str, Path]:
    """Chapters that are there, by name, in the order of reading; then those without a place.

    Parameters
    ----------
    root
        Folder of the repository.
    """
    files = {page.stem: page for page in sorted((root / "docs").glob("*.md"))}
    files |= {name: root / path for name, path in BORROWED.items() if (root / path).is_file()}
    known = [name for name in ("index", *ordered()) if name in files]
    return {name: files[name] for name in [*known, *sorted(set(files) - set(known))]}
