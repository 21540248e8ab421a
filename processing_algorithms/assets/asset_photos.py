"""Assets whose photos are no longer there: which they are, and how that is told."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.measure.assets.asset import Asset
    from georef_gis.project import Project

# names that stand in one line
_MOST_NAMES = 5
# s; a look must not wait for a program that holds the file
_WAIT = 0.5


def lost_photos(asset: Asset, known: Set[str]) -> tuple[str, ...]:
    """Ids of the photos that an asset was clicked in and that are not among the known ones."""
    clicked = () if asset.quality is None else asset.quality.photo_ids
    return tuple(photo for photo in clicked if photo not in known)


def lost_words(photos: Sequence[str]) -> str:
    """What is said of an asset that was clicked in photos which are not there."""
    return f"was clicked in {named(photos)}, no longer in the project"


def lost_lines(assets: Sequence[Asset], known: Set[str]) -> list[str]:
    """One line on all assets that were clicked in photos which are not among the known ones."""
    lost = [(asset, gone) for asset in assets if (gone := lost_photos(asset, known))]
    if not lost:
        return []
    photos = sorted({photo for _, gone in lost for photo in gone})
    names = [f"{asset.kind} {asset.name[:40] or asset.id[:8]}" for asset, _ in lost]
    many = len(lost) > 1
    return [
        f"{len(lost)} {'assets were' if many else 'asset was'} clicked in photos that the project "
        f"no longer has ({named(photos)}): {named(names)}; {'they stay' if many else 'it stays'} "
        "as stored, to be measured anew when the photos are back"
    ]


def lost_doubts(project: Project, known: Set[str]) -> list[str]:
    """The same of the stored assets of a project; or why it is not known."""
    from georef_gis.errors import GeorefError
    from georef_gis.measure.assets.file import ASSETS_FILE
    from georef_gis.measure.assets.store import AssetStore

    # a look must not make the file
    if not (project.folder / ASSETS_FILE).is_file():
        return []
    try:
        with AssetStore.of_project(project, wait=_WAIT) as store:
            return lost_lines(store.assets(), known)
    except GeorefError as error:
        return [f"whether assets were clicked in photos that are gone is not known: {error}"]


def named(names: Sequence[str]) -> str:
    """The first names of many, and how many more there are."""
    more = len(names) - _MOST_NAMES
    told = ", ".join(names[:_MOST_NAMES])
    return f"{told} and {more} more" if more > 0 else told
