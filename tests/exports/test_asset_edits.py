"""What a GIS wrote into the layers of assets: taken as far as a column holds it, and told else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import format_cases as cases
import numpy as np
import pyogrio
import pytest

from exports.site.assets import what_is_lost
from exports.site.columns import Layer
from exports.site.site import SiteLayers
from exports.tables.geopackage import write_geopackage
from georef_gis.errors import ExportError

ENDINGS = {"geopackage": "gpkg", "geoparquet": "parquet", "flatgeobuf": "fgb"}
# n_rays as SQLite keeps what a GIS user wrote; a double is exact up to 2**53
WHOLE = (2**53 + 1, 2**63, 1e300, "many", "3", None, 4.0)


def edited(tmp_path: Path) -> tuple[SiteLayers, Layer]:
    """A site whose points have these numbers of rays."""
    site = cases.format_site(tmp_path)
    rows = [cases.asset(i, f"n{i}", n_rays=value) for i, value in enumerate(WHOLE)]
    places = np.tile([*site.assets[0].xy[0], 0.0], (len(rows), 1))
    site = replace(site, assets=(cases.table("asset_points", places, rows),))
    return site, site.layers["asset_points"]


def test_cells_that_hold_no_number_of_64_bits_are_empty(tmp_path) -> None:
    _, layer = edited(tmp_path)
    assert layer.columns["n_rays"].tolist() == [2**53 + 1, None, None, None, 3, None, 4]


@pytest.mark.parametrize("name", ["geopackage", "geoparquet", "flatgeobuf"])
def test_numbers_of_64_bits_come_back_to_the_last_digit(tmp_path, name) -> None:
    site, layer = edited(tmp_path)
    target = tmp_path / f"out.{ENDINGS[name]}"
    cases.write(name, site, [layer], target)
    if name == "geoparquet":
        parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
        assert parquet.read_table(target)["n_rays"].to_pylist()[0] == 2**53 + 1
    else:
        where = f"n_rays = {2**53 + 1}"
        assert len(pyogrio.raw.read(target, where=where, layer="asset_points")[2]) == 1


def test_number_that_a_dbf_cannot_hold_is_refused_and_not_left_out(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    layer = site.layers["asset_points"]
    layer.columns["sigma_n_m"].values[3] = 1e300
    with pytest.raises(ExportError, match=r"asset_points: .* of field sigma_n_m of feature 3 is"):
        cases.write("shapefile", site, [layer], tmp_path / "out")


def test_what_a_gis_wrote_into_the_assets_and_is_not_exported_is_told() -> None:
    rows = [
        cases.asset(i, f"line\nof {i}", n_rays=value, inspected="2026-05-01", sigma_e=9e999)
        for i, value in enumerate(WHOLE)
    ]
    points = cases.table("asset_points", [[[0, 0, 0]]] * len(rows), rows)
    places = replace(points, columns={**points.columns, "sigma_e": np.full(len(rows), np.inf)})
    assert what_is_lost((places,)) == (
        "cells left empty, as they hold no number of 64 bits: asset_points.sigma_e_m (7), "
        "asset_points.n_rays (3)",
        "columns that a GIS added are left out; make them attributes in asset_classes.toml: "
        "asset_points.inspected",
    )
    empty = cases.table("asset_lines", [np.zeros((0, 3))], [cases.asset(1, "a\r\nb" + "x" * 300)])
    (told,) = what_is_lost((empty,))
    # one line, and no longer than can be read
    assert told.endswith(f"of their kind: a b{'x' * 57}")


def test_bytes_in_a_text_are_read_as_utf_8(tmp_path) -> None:
    site = cases.format_site(tmp_path, names=("路".encode(), b"A\xc3"))
    assert site.layers["asset_points"].columns["name"].tolist() == ["路", "A\ufffd"]


def test_area_with_a_hole_is_told(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    pierced = replace(site.assets[2], holes=np.array([1, 0]))
    (told,) = what_is_lost((pierced,))
    assert told == "areas written without their holes, which assets cannot have: area"
    assert write_geopackage(replace(site, assets=(pierced,)), tmp_path / "s.gpkg").features


def test_nul_in_a_text_does_not_end_it(tmp_path) -> None:
    site = cases.format_site(tmp_path, names=("a\0b", "c"))
    texts = site.layers["asset_points"].columns["name"].tolist()
    assert texts == ["a\ufffdb", "c"]
    write_geopackage(site, tmp_path / "s.gpkg", ("asset_points",))
    _, _, _, fields = pyogrio.raw.read(tmp_path / "s.gpkg", layer="asset_points", columns=["name"])
    assert fields[0].tolist() == texts
