"""Assets by the thousand for the tests of KMZ: points, lines, areas and ellipses."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from georef_gis.geodesy import MapFrame
from georef_gis.project.asset_layers import AssetTable

CLASSES = ("cone", "drum", "sign", "barrier", "arrow board")


def table_of(layer: str, columns: dict[str, object], parts: Sequence[np.ndarray]) -> AssetTable:
    offsets = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
    points = np.vstack(parts) if parts else np.zeros((0, 3))
    return AssetTable(
        layer=layer, columns=columns, offsets=offsets, xy=points[:, :2], height=points[:, 2],
        holes=np.zeros(len(parts), np.int64),
    )  # fmt: skip


def _objects(values: Sequence[object]) -> np.ndarray:
    out = np.empty(len(values), object)
    out[:] = values
    return out


def asset_columns(
    count: int, *, names: Sequence[str] | None = None, start: int = 0
) -> dict[str, object]:
    """Columns of `assets.gpkg` for some assets."""
    number = range(start, start + count)
    real = {name: np.full(count, 0.03) for name in ("sigma_e", "sigma_n", "sigma_u", "corr_en")}
    return {
        "asset_id": _objects([f"A{i:06d}" for i in number]),
        "class": _objects([CLASSES[i % len(CLASSES)] for i in number]),
        "name": _objects(list(names) if names else [f"asset {i}" for i in number]),
        "note": _objects(["seen twice"] * count),
        "attributes": _objects(
            [json.dumps({"line": f"taper {i % 7}", "order": i, "upright": True}) for i in number]
        ),
        **real,
        "semi_major": np.full(count, 0.08), "semi_minor": np.full(count, 0.05),
        "azimuth": np.full(count, 30.0), "conf": np.full(count, 0.95),
        "dof": _objects([3] * count), "n_rays": _objects([4] * count),
        "method": _objects(["intersect"] * count),
        "photo_ids": _objects(['["p1.jpg", "p2.jpg"]'] * count),
        "pixels": _objects(['[{"photo": "p1.jpg", "u": 100.5, "v": 200.25}]'] * count),
        "created": _objects(["2026-05-01T12:00:00Z"] * count),
        "changed": _objects(["2026-05-01T12:00:00Z"] * count),
    }  # fmt: skip


def asset_tables(
    frame: MapFrame, count: int, *, ellipses: bool = False, names: Sequence[str] | None = None
) -> tuple[AssetTable, ...]:
    """Points over some hundred metres, a line and an area, and ellipses of the points."""
    rng = np.random.default_rng(2)
    enu = np.column_stack([rng.uniform(-300, 300, (count, 2)), np.zeros(count)])
    p_map = frame.map_from_enu(enu)
    line = frame.map_from_enu(np.array([[0.0, 0, 0], [30, 5, 0], [60, 0, 0]]))
    ring = np.array([[0.0, 0, 0], [20, 0, 0], [20, 10, 0], [0, 10, 0], [0, 0, 0]])
    tables = [
        table_of("asset_points", asset_columns(count, names=names), list(p_map[:, None])),
        table_of("asset_lines", asset_columns(1, start=count), [line]),
        table_of("asset_polygons", asset_columns(1, start=count + 1), [frame.map_from_enu(ring)]),
    ]
    if ellipses:
        angle = np.linspace(0.0, 2.0 * np.pi, 25)
        around = np.column_stack([0.08 * np.cos(angle), 0.05 * np.sin(angle), 0.0 * angle])
        parts = list(p_map[:, None, :] + around)
        tables.append(table_of("asset_ellipses", asset_columns(count, names=names), parts))
    return tuple(tables)
