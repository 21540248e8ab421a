"""Facts of a small project for the tests of the report page, and a reader of its HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np

from georef_gis.frames import exp_so3
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.report.facts import Adjustment, Facts, Residuals
from georef_gis.model.camera import Camera
from georef_gis.model.layers import Footprint
from georef_gis.model.pose import Pose

CAMERA = Camera(
    id="cam", width=4000, height=3000, fx=2500.0, fy=2500.0, cx=1999.5, cy=1499.5, model="brown"
)
LOOKS_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def pose(
    x: float, y: float, *, turn: Sequence[float] = (0.0, 0.0, 0.0), kind: Any = "tags"
) -> Pose:
    """Pose 50 m up, turned in enu by a rotation vector, rad; sigmas of 1 m and 1 deg."""
    return Pose(
        origin_enu=np.array([x, y, 50.0]),
        R_enu_from_cam=exp_so3(turn) @ LOOKS_DOWN,
        covariance=np.diag([1.0, 1.0, 1.0, *[np.radians(1.0) ** 2] * 3]),
        kind=kind,
    )


def project_facts(photos: int = 4, **changes: Any) -> Facts:
    """A strip of photos 20 m apart, direct poses only."""
    origin = Origin(lat=np.radians(40.0), lon=np.radians(-83.0), height_ellipsoidal=200.0)
    frame = MapFrame(origin, utm_crs(origin.lat, origin.lon))
    ids = [f"P{i:03d}" for i in range(photos)]
    poses = {key: pose(20.0 * i, 0.0) for i, key in enumerate(ids)}
    prints = {key: _footprint(key, frame, p) for key, p in poses.items()}
    corner = np.vstack([f.ring_map for f in prints.values()]).min(axis=0)
    facts = Facts(
        title="A <site> & more", frame=frame, corner=corner, unit=1.0, quick=False,
        photos=[
            {"photo_id": key, "camera_id": "cam", "camera_clock": f"2026-05-01T10:00:{i % 60:02d}",
             "time_gps": 10.0 + 2.0 * i}
            for i, key in enumerate(ids)
        ],
        flights=[], control=[], marks=[], footprints=prints,
        footprint_rows=[{"photo_id": key, "pose_kind": "tags", "doubts": []} for key in ids],
        direct=poses, adjusted={}, turned={"direct": {}, "adjusted": {}}, doubtful={}, settled=[],
        height_kinds=("ellipsoidal",), cameras={"cam": CAMERA},
        camera_rows=[
            {"camera_id": "cam", "parameters": CAMERA.parameters.tolist(), "covariance": None,
             "readout_s": 0.0, "source": "tags", "extra": {}}
        ],
        runs=[], ground={"source": "level ground", "kind": "flat", "sigma_m": 1.5}, mosaic=None,
        overlap=None, matches=None, adjustment=None, accuracy=None,
    )  # fmt: skip
    return replace(facts, **changes)


def _footprint(key: str, frame: MapFrame, at: Pose) -> Footprint:
    corners = at.origin_enu[:2] + np.array([[-40, -30], [40, -30], [40, 30], [-40, 30], [-40, -30]])
    ring_enu = np.column_stack([corners, np.zeros(5)])
    ring_map = frame.map_from_enu(ring_enu)[:, :2]
    return Footprint(
        photo_id=key, ring_map=ring_map, ring_enu=ring_enu, gsd=0.02, gsd_min=0.02, gsd_max=0.02,
        area_m2=4800.0, height_above_ground=50.0, tilt=0.01, nadir_map=ring_map.mean(axis=0),
        sigma_horizontal=1.0, clipped=False,
    )  # fmt: skip


def adjusted_facts(photos: int = 4, *, each: int = 500, **report: Any) -> Facts:
    """The same, adjusted: residuals of 0.5 px without any pattern."""
    facts = project_facts(photos)
    rng = np.random.default_rng(7)
    ids = tuple(facts.direct)
    m = each * photos
    residuals = Residuals(
        photo_ids=ids,
        photo=np.repeat(np.arange(photos), each).astype(np.int32),
        uv=rng.uniform([0, 0], [3999, 2999], (m, 2)),
        residual=rng.normal(0.0, 0.5, (m, 2)),
        sigma=np.full(m, 0.5),
    )
    rows = [
        {
            "photo": key, "observations": each, "rms_px": 0.5, "wrong_matches": 3,
            "sigma_m": [0.1, 0.1, 0.2], "sigma_deg": [0.01, 0.01, 0.02],
            "moved_m": [0.1, 0.0, 0.1], "turned_deg": 0,
        }
        for key in ids
    ]  # fmt: skip
    values = {
        "sigma0": 1.0, "converged": True, "points": 900, "observations": m,
        "wrong_matches": 3 * photos, "photos": rows,
        "checks": [{"name": "scale", "value": 1.0, "expected": 1.0, "sigma": 0.01, "unit": "",
                    "passed": True}],
        "observability": {
            "unknowns": [unknown("cam f", 5.0, 2.0, 25.0), unknown("flight clock", 0.0, 0.1, 0.1)],
            "correlation": [[1.0, 0.1], [0.1, 1.0]], "badly_separated": [], "condition": 1e5,
        },
        "control": [], "ground": None, "weighed_down": [],
    }  # fmt: skip
    points = rng.uniform([-30, -25, 0], [20.0 * photos, 25, 1], (900, 3))
    adjustment = Adjustment(
        report={**values, **report}, residuals=residuals, points_enu=points,
        points_px=np.abs(rng.normal(0.4, 0.05, 900)),
    )  # fmt: skip
    adjusted = {key: replace(p, kind="adjusted") for key, p in facts.direct.items()}
    return replace(facts, adjustment=adjustment, adjusted=adjusted, matches=matches(ids))


def unknown(name: str, value: float, sigma: float, prior: float) -> dict[str, Any]:
    """Row of the observability report."""
    return {
        "name": name, "value": value, "sigma": sigma, "prior_sigma": prior,
        "unit": "px" if name.endswith(" f") else "s", "held_by_prior": sigma > 0.7 * prior,
    }  # fmt: skip


def matches(ids: Sequence[str], broken: Sequence[str] = ()) -> dict[str, Any]:
    """Pairs of neighbours up to 2 apart; those of `broken` photos share nothing."""
    pairs = [
        {
            "ids": [a, b], "overlap": 0.6,
            "inliers": 0 if {a, b} & set(broken) else 100 + 50 * i,
        }
        for i, a in enumerate(ids)
        for b in ids[i + 1 : i + 3]
    ]  # fmt: skip
    tied = [key for key in ids if key not in broken]
    return {"pairs": pairs, "components": [tied, *([b] for b in broken)], "turns": {}}


class Page(HTMLParser):
    """What a page refers to, its headings, pictures and ids; fails on tags that do not match."""

    VOID = frozenset({"meta", "img", "br", "link", "input", "hr"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.images: list[Mapping[str, str | None]] = []
        self.headings: list[int] = []
        self.ids: list[str] = []
        self.tags: set[str] = set()
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.tags.add(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(values)
        if tag in ("h1", "h2", "h3", "h4"):
            self.headings.append(int(tag[1]))
        self.references += [v for k, v in values.items() if k in ("src", "href") and v]
        self.ids += [v for k, v in values.items() if k == "id" and v]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag
