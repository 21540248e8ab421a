"""What was mapped: assets by class, one by one with their sigmas, and pictures of them."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from georef_gis.measure.assets.asset import Asset, Quality
from georef_gis.measure.report.draw import few, metres, number, plural
from georef_gis.measure.report.page import Gallery, Item, Table, Text, Thumbnail, judged

# rows of the table of assets; products/assets.csv has all
MOST_ROWS = 300
# pictures shown; they are what makes the page large
MOST_PICTURES = 60
# times the median sigma of its class from which an asset is named
FAR = 3.0
# photos of an asset that are named
_MOST_PHOTOS = 2
_LONGEST = 80
# marks that turn the direction of writing, by which a name may show as another
_TURNING = re.compile("[\u202a-\u202e\u2066-\u2069\u200e\u200f]")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssetFacts:
    """Assets of a project.

    Parameters
    ----------
    titles
        Of the classes, by name.
    unit
        m per CRS unit.
    photos
        Ids of the photos of the project.
    pictures
        JPEG by asset id, of those that have one that is not older than they are.
    """

    assets: Sequence[Asset]
    titles: Mapping[str, str]
    unit: float = 1.0
    photos: frozenset[str] = frozenset()
    pictures: Mapping[str, bytes] = field(default_factory=dict)


def asset_items(found: AssetFacts | None, why: str = "") -> list[Item]:
    """Tables and pictures; or why there are none, which asks for a look."""
    if why:
        return [Text(title="Assets", lines=(), verdict=judged(why, fine=False))]
    if found is None or not found.assets:
        told = (
            "Nothing was mapped yet: `georef assets` and `georef serve` measure assets by clicks."
        )
        return [Text(lines=(told,))]
    far = far_assets(found.assets)
    return [_by_class(found), _table(found, far), _gallery(found)]


def sigma_in_plan(asset: Asset) -> float:
    """One sigma per axis in plan, m; NaN where it is not known."""
    q = asset.quality
    if q is None or q.sigma_e is None or q.sigma_n is None:
        return math.nan
    return math.hypot(q.sigma_e, q.sigma_n) / math.sqrt(2.0)


def far_assets(assets: Sequence[Asset]) -> list[Asset]:
    """Assets that are far less certain than those of their class."""
    by_class: dict[str, list[float]] = {}
    for asset in assets:
        sigma = sigma_in_plan(asset)
        if math.isfinite(sigma):
            by_class.setdefault(asset.kind, []).append(sigma)
    middle = {kind: float(np.median(values)) for kind, values in by_class.items()}
    return [a for a in assets if sigma_in_plan(a) > FAR * middle.get(a.kind, math.inf)]


def called(asset: Asset, titles: Mapping[str, str] | None = None) -> str:
    """Class and name of an asset, or the beginning of its id, in a line."""
    name = shortened(asset.name) or asset.id[:8]
    return f"{(titles or {}).get(asset.kind, asset.kind)} {name}"


def shortened(text: str) -> str:
    """A text in one line that fits a cell."""
    line = " ".join(_TURNING.sub("", text).split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "..."


# -- tables ------------------------------------------------------------------------------------


def _by_class(found: AssetFacts) -> Table:
    groups: dict[str, list[Asset]] = {}
    for asset in found.assets:
        groups.setdefault(asset.kind, []).append(asset)
    rows = []
    for kind, some in sorted(groups.items()):
        sigma = np.array([s for a in some if math.isfinite(s := sigma_in_plan(a))])
        methods = Counter((a.quality or Quality()).method or "not told" for a in some)
        photos = {photo for a in some for photo in (a.quality or Quality()).photo_ids}
        rows.append(
            (
                found.titles.get(kind, kind), some[0].shape, str(len(some)),
                metres(float(np.median(sigma))) if len(sigma) else "-",
                metres(float(sigma.max())) if len(sigma) else "-",
                ", ".join(f"{n} {name}" for name, n in methods.most_common()), str(len(photos)),
            )
        )  # fmt: skip
    without = [a for a in found.assets if not math.isfinite(sigma_in_plan(a))]
    wrong = [a for a in found.assets if a.problems]
    told = f"{plural(len(found.assets), 'asset')} of {len(groups)} classes"
    told += f"; {len(without)} without sigmas, as moved or drawn by hand" if without else ""
    told += f"; {len(wrong)} do not fit their class" if wrong else ""
    return Table(
        title="Assets by class", rows=rows, words=(0, 1, 5),
        columns=("Class", "Shape", "Count", "σ in plan", "Largest σ", "Method", "Photos"),
        look="σ in plan is one sigma per axis, the median of the class; `intersect` is of several "
        "photos, `locate` of one photo and the ground.",
        verdict=judged(told + ".", fine=not without and not wrong),
    )  # fmt: skip


def _table(found: AssetFacts, far: Sequence[Asset]) -> Table:
    def certain(asset: Asset) -> float:
        sigma = sigma_in_plan(asset)
        return sigma if math.isfinite(sigma) else math.inf

    shown: Sequence[Asset] = found.assets
    more = len(found.assets) - MOST_ROWS
    if more > 0:
        shown = sorted(found.assets, key=certain, reverse=True)[:MOST_ROWS]
    shown = sorted(shown, key=lambda a: (a.kind, a.name))
    rows = [_row(asset, found) for asset in shown]
    told = f"{plural(len(far), 'asset')} beyond {FAR:g} times the sigma that is usual in the class"
    told += f": {few([called(a, found.titles) for a in far])}" if far else ""
    if more > 0:
        told += f"; the {MOST_ROWS} least certain of {len(found.assets)} are shown, all stand in "
        told += "assets.gpkg and, by `georef assets`, in products/assets.csv"
    return Table(
        title="Assets one by one", rows=rows, words=(0, 1, 9, 10),
        columns=("Name", "Class", "East", "North", "Height (m)", "σ east", "σ north", "σ up",
                 "Ellipse", "Method", "Photos"),
        look="Place of the first vertex in units of the map, sigmas of the worst one. "
        + _probability(found.assets),
        verdict=judged(told + ".", fine=not far),
    )  # fmt: skip


def _row(asset: Asset, found: AssetFacts) -> tuple[str, ...]:
    q = asset.quality or Quality()
    east, north, height = asset.vertices[0] if asset.vertices else (math.nan,) * 3
    return (
        shortened(asset.name) or asset.id[:8], found.titles.get(asset.kind, asset.kind),
        number(east, 2), number(north, 2), number(height, 2),
        metres(q.sigma_e), metres(q.sigma_n), metres(q.sigma_u), _ellipse(q), q.method,
        few([shortened(photo) for photo in q.photo_ids], _MOST_PHOTOS),
    )  # fmt: skip


def _ellipse(q: Quality) -> str:
    if q.semi_major is None or q.semi_minor is None or q.azimuth is None:
        return "-"
    axes = metres(q.semi_major), metres(q.semi_minor)
    if axes[0][-2:] == axes[1][-2:]:
        axes = axes[0].split()[0], axes[1]
    return f"{axes[0]} / {axes[1]}, {q.azimuth:.0f}°"


def _probability(assets: Sequence[Asset]) -> str:
    """With what probability the ellipses hold the places."""
    found = {q.conf for a in assets if (q := a.quality) is not None and q.conf is not None}
    if not found:
        return ""
    low, high = min(found), max(found)
    share = f"{low:.0%}" if low == high else f"{low:.0%} to {high:.0%} (column `conf`)"
    return f"The ellipse, half axes and azimuth of the longer one, holds the place with {share}."


# -- pictures ----------------------------------------------------------------------------------


def pictured(assets: Sequence[Asset], most: int = MOST_PICTURES) -> list[Asset]:
    """Assets to show, as many of each class as there is room for."""
    groups: dict[str, list[Asset]] = {}
    for asset in assets:
        groups.setdefault(asset.kind, []).append(asset)
    chosen: list[Asset] = []
    for turn in range(max((len(some) for some in groups.values()), default=0)):
        for some in groups.values():
            if turn < len(some) and len(chosen) < most:
                chosen.append(some[turn])
        if len(chosen) >= most:
            break
    order = {asset.id: i for i, asset in enumerate(assets)}
    return sorted(chosen, key=lambda a: order[a.id])


def _gallery(found: AssetFacts) -> Item:
    shown = [a for a in pictured(found.assets) if a.id in found.pictures]
    if not shown:
        return Text(lines=("There are no pictures of the assets: `georef assets --thumbnails` cuts "
                           "them out of the photos.",))  # fmt: skip
    pictures = tuple(
        Thumbnail(data=found.pictures[asset.id], caption=called(asset, found.titles))
        for asset in shown
    )
    look = "The cross stands where the asset was clicked, the bar is the scale."
    left = len(found.assets) - len(shown)
    look += f" {left} more are not shown here; products/assets/ has what was cut." if left else ""
    return Gallery(title="Pictures of the assets", pictures=pictures, look=look)
