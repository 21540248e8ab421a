"""Map, summary and overlap: what every project has."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    BLACK,
    RED,
    area,
    extent_of,
    few,
    jpeg,
    map_figure,
    metres,
    names_at,
    outlines,
    plural,
    png,
    scale_and_north,
)
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.not_adjusted import apart
from georef_gis.measure.report.page import (
    Item,
    Lines,
    Picture,
    Section,
    Table,
    Text,
    Verdict,
    judged,
)
from georef_gis.rasters.preview import Preview

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# share of the covered ground that three photos or more must show for a well-tied block
WELL_SEEN = 0.5
_POSES = {
    "tags": "from the tags alone",
    "navigation": "from the trajectory",
    "adjusted": "adjusted to each other",
}


def facts_of(facts: Facts, made: str, versions: str) -> list[tuple[str, str]]:
    """Names and values below the title."""
    frame = facts.frame
    clocks = sorted(str(p["camera_clock"]) for p in facts.photos if p["camera_clock"])
    code = frame.crs.to_epsg()
    kinds = "; ".join(facts.height_kinds)
    flown = f"{clocks[0]} to {clocks[-1]} (camera clock)" if clocks else "not told by the photos"
    return [
        ("Flown", flown.replace("T", " ")),
        ("Page made", made),
        ("Versions", versions),
        ("Map CRS", frame.crs.name + (f" (EPSG:{code})" if code else "")),
        ("Unit of the map", "m" if facts.unit == 1.0 else f"{facts.unit:.9g} m"),
        ("Datum of positions", f"{frame.gnss_datum} (products: {frame.crs_datum})"),
        ("Heights", f"stored above the ellipsoid; of the tags or logs: {kinds}"),
        ("Ground", str(facts.ground.get("source", "of no known source"))),
    ]


# -- summary -----------------------------------------------------------------------------------


def summary_section(facts: Facts) -> Section:
    """Map picture, table, and what could not be read."""
    items: list[Item] = [_map(facts), _summary(facts)]
    if facts.quick:
        items.append(
            Text(lines=("A quick run: it stops at the poses from the tags; nothing is matched.",))
        )
    if facts.missing:
        items.append(Lines(title="Not shown here", lines=facts.missing))
    return Section(id="summary", title="The site", items=items)


def _summary(facts: Facts) -> Table:
    prints = list(facts.footprints.values())
    kinds = Counter(row["pose_kind"] for row in facts.footprint_rows)
    doubtful = [key for key in facts.doubtful if key in facts.footprints]
    without = len(facts.photos) - len(prints)
    covered = (facts.run_of("footprints") or {"summary": None})["summary"] or {}
    mosaic = (facts.run_of("mosaic") or {"summary": None})["summary"] or {}
    sigma = [f.sigma_horizontal for f in prints]
    rows = [
        ("Photos", f"{len(facts.photos)}, {len(prints)} with a place on the ground"),
        ("Poses", "; ".join(f"{n} {_POSES.get(k, k)}" for k, n in kinds.items())),
        ("Cameras", few(sorted({str(p["camera_id"]) for p in facts.photos}))),
        ("GSD of the photos", f"{metres(float(np.median([f.gsd for f in prints])))} (median)"),
        ("GSD of the mosaic", metres(mosaic.get("gsd_m")) if facts.mosaic else "no mosaic"),
        ("Height above ground", _span([f.height_above_ground for f in prints])),
        ("Tilt", f"up to {math.degrees(max(f.tilt for f in prints)):.1f} deg"),
        ("Ground covered", area(covered["covered_m2"]) if "covered_m2" in covered else "-"),
        ("Expected error of a place", f"{metres(float(np.median(sigma)))} (median, one sigma)"),
        ("Doubtful photos", few(doubtful, 8) if doubtful else "none"),
    ]
    if facts.settled:
        rows.append(("Doubtful by their tags, settled by the pixels", few(facts.settled, 8)))
    bad = without + len(doubtful)
    told = f"{len(prints)} of {plural(len(facts.photos), 'photo')} are placed"
    told += f", {len(doubtful)} of them doubtful." if doubtful else ", none doubtful."
    return Table(
        title="Summary", columns=("What", "Value"), rows=rows, words=(0, 1),
        look="Every photo should be placed and none doubtful.",
        verdict=judged(told, fine=not bad, bad=bad > 0.2 * len(facts.photos)),
    )  # fmt: skip


def _span(values: list[float]) -> str:
    at = [v for v in values if math.isfinite(v)]
    return f"{min(at):.1f} to {max(at):.1f} m" if at else "-"


# -- map ---------------------------------------------------------------------------------------


def rings_of(facts: Facts) -> dict[str, Array]:
    """Footprints in m from the corner."""
    return {key: facts.local(f.ring_map) for key, f in facts.footprints.items()}


def _map(facts: Facts) -> Picture:
    rings = rings_of(facts)
    figure, axis = map_figure(extent_of(rings.values()))
    if facts.mosaic is not None:
        rgba = picture_of(facts.mosaic)
        axis.imshow(rgba, extent=facts.local_extent(facts.mosaic), interpolation="bilinear")
    outlines(axis, [r for k, r in rings.items() if k not in facts.doubtful], width=0.6)
    doubtful = [ring for key, ring in rings.items() if key in facts.doubtful]
    outlines(axis, doubtful, color=RED, width=1.4, line="--")
    nadirs = {key: facts.local(f.nadir_map) for key, f in facts.footprints.items()}
    axis.plot(*np.array(list(nadirs.values())).T, ".", color=BLACK, ms=3, ls="none")
    names_at(axis, nadirs, most=25)
    scale_and_north(axis)
    middle = np.mean([f.ring_enu[:, :2].mean(axis=0) for f in facts.footprints.values()], axis=0)
    turn = math.degrees(facts.frame.convergence_at([*middle, 0.0]))
    side = "west" if turn > 0 else "east"
    north = f"grid north is up, true north {abs(turn):.2f} deg {side} of it"
    if facts.mosaic is None:
        told = f"no mosaic was made, the outlines stand alone; {north}."
        verdict = Verdict(level="told", text=told)
    else:
        verdict = _mosaic_verdict(facts, rings, north)
    return Picture(
        title="Map",
        data=jpeg(figure),
        alt=f"Mosaic with the outlines of {plural(len(rings), 'photo')}, scale bar, north arrow",
        look="The mosaic should be whole within the outlines (thin orange; doubtful photos dashed "
        "red) and show roads and roofs without breaks.",
        verdict=verdict,
    )


def picture_of(preview: Preview) -> Array:
    """Red, green, blue and opacity of a preview, 0 to 255; other depths are stretched."""
    bands = preview.values[..., :3] if preview.values.shape[2] >= 3 else preview.values[..., :1]
    bands = np.repeat(bands, 3, axis=2) if bands.shape[2] == 1 else bands
    if bands.dtype != np.uint8:
        seen = bands[preview.valid]
        low, high = np.percentile(seen, (1, 99)) if len(seen) else (0.0, 1.0)
        share = (bands.astype(np.float64) - low) / max(float(high - low), 1e-12)
        bands = np.clip(255 * share, 0, 255).astype(np.uint8)
    opaque = np.where(preview.valid, 255, 0).astype(np.uint8)
    return np.dstack([bands, opaque])


def _mosaic_verdict(facts: Facts, rings: dict[str, Array], north: str) -> Verdict:
    """Whether the mosaic fills what the overlap map says the photos show."""
    assert facts.mosaic is not None
    cell = abs(facts.mosaic.transform[0] * facts.mosaic.transform[4]) * facts.unit**2
    shown = float(facts.mosaic.valid.sum()) * cell
    covered = ((facts.run_of("footprints") or {"summary": None})["summary"] or {}).get("covered_m2")
    if not covered:
        return Verdict(level="told", text=f"The mosaic shows {area(shown)}; {north}.")
    share = shown / covered
    told = f"the mosaic fills {min(share, 1.0):.0%} of the ground that the photos cover"
    joined = facts.adjustment is not None or len(facts.footprints) < 2
    if not joined:
        told += "; its photos are placed one by one, not adjusted to each other: expect breaks of "
        told += f"some {metres(apart(facts))} at the seams"
    return judged(f"{told}; {north}.", fine=share > 0.97 and joined, bad=share < 0.9)


# -- overlap -----------------------------------------------------------------------------------


def overlap_item(facts: Facts) -> Item:
    """How many photos show each place."""
    if facts.overlap is None:
        return Text(lines=("There is no overlap map (products/overlap.tif).",))
    from matplotlib.colors import BoundaryNorm, ListedColormap

    counts = facts.overlap.values[..., 0].astype(np.float64)
    seen = counts[counts > 0]
    steps = [1, 2, 3, 5, 8, 13]
    colours = ["#D55E00", "#E69F00", "#F0E442", "#7BC8A4", "#009E73", "#00503A"]
    figure, axis = map_figure(facts.local_extent(facts.overlap))
    axis.imshow(
        np.ma.masked_equal(counts, 0), extent=facts.local_extent(facts.overlap),
        cmap=ListedColormap(colours), norm=BoundaryNorm([*steps, 1e6], len(colours)),
        interpolation="nearest",
    )  # fmt: skip
    _overlap_legend(axis, colours, seen)
    scale_and_north(axis)
    return Picture(
        title="Overlap map",
        data=png(figure, dpi=100),
        alt="Map coloured by the number of photos that show each place",
        look="Yellow and green ground (3 photos or more) can be tied and checked; red ground is "
        "seen once and stands only at the rim of a good flight.",
        verdict=_overlap_verdict(facts, seen),
    )


def _overlap_legend(axis: Axes, colours: list[str], seen: Array) -> None:
    from matplotlib.patches import Patch

    spans = [(1, 1), (2, 2), (3, 4), (5, 7), (8, 12), (13, 10**6)]
    handles = []
    for colour, (low, high) in zip(colours, spans, strict=True):
        share = float(np.mean((seen >= low) & (seen <= high))) if len(seen) else 0.0
        told = "<1%" if 0 < share < 0.005 else f"{share:.0%}"
        name = f"{low}" if low == high else f"{low}+" if high > 1000 else f"{low}-{high}"
        handles.append(Patch(color=colour, label=f"{name} ({told})"))
    axis.legend(
        handles=handles, title="photos (share of the ground)", fontsize=8.5, title_fontsize=8.5,
        loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=6, frameon=False,
    )  # fmt: skip


def _overlap_verdict(facts: Facts, seen: Array) -> Verdict:
    if not len(seen):
        return Verdict(level="bad", text="no photo shows any ground.")
    thrice, once = float(np.mean(seen >= 3)), float(np.mean(seen == 1))
    holes = ((facts.run_of("footprints") or {"summary": None})["summary"] or {}).get("holes") or 0
    told = f"{thrice:.0%} of the covered ground is seen by 3 photos or more, {once:.0%} by one only"
    told += f"; {plural(int(holes), 'hole')} amid the flown area." if holes else "; no holes."
    told += f" Most often seen: {int(seen.max())} times."
    return judged(told, fine=thrice >= WELL_SEEN and not holes)
