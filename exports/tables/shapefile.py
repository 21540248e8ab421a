"""Exporter to Esri Shapefile: a folder with one shapefile for each layer."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from exports.tables.table_export import (
    FIELDS_FILE,
    SpatialOptions,
    TableExporter,
    files_of,
    report_of,
    write_fields,
)
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport

if TYPE_CHECKING:
    from exports.site.columns import Column, Layer
    from exports.site.site import SiteLayers

# Columns whose names are longer than the 10 characters of a DBF. The table is fixed, so that a
# project of a GIS finds its columns again: names may be added, never changed.
SHORT_NAMES = {
    "camera_clock": "cam_clock",
    "height_ellipsoidal_m": "h_ell_m",
    "height_orthometric_m": "h_orth_m",
    "height_above_ground_m": "h_agl_m",
    "height_kind": "h_kind",
    "sigma_above_ground_m": "sig_agl_m",
    "sigma_major_m": "sig_maj_m",
    "sigma_minor_m": "sig_min_m",
    "sigma_azimuth_deg": "sig_az_deg",
    "sigma_roll_deg": "sig_roll_d",
    "sigma_pitch_deg": "sig_ptch_d",
    "sigma_yaw_deg": "sig_yaw_d",
    "sigma_omega_deg": "sig_omg_d",
    "sigma_phi_deg": "sig_phi_d",
    "sigma_kappa_deg": "sig_kap_d",
    "residual_px": "resid_px",
    "sigma_horizontal_m": "sig_hor_m",
    "first_photo": "frst_photo",
    "survey_sigma_h_m": "svy_sig_h",
    "survey_sigma_v_m": "svy_sig_v",
    "off_north_m": "off_nrth_m",
    "sigma_u_block_m": "sig_u_blk",
    "semi_major_m": "semi_maj_m",
    "semi_minor_m": "semi_min_m",
    "azimuth_deg": "azim_deg",
}
# bytes of a text in a DBF
TEXT_BYTES = 254
CUT_FILE = "cut_texts.csv"


class Shapefile(TableExporter[SpatialOptions]):
    """Layers as Esri Shapefiles in one folder, in the project CRS.

    Names of columns have 10 characters at most: `fields.csv` tells which is which. A text is cut
    at 254 bytes; cut ones stand whole in `cut_texts.csv`. Flags are 0 or 1. Cameras, which have
    no place, are a DBF alone.
    """

    id = "shapefile"
    name = "Shapefile"
    suffix = ""
    target = "site_shp"

    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: SpatialOptions
    ) -> ExportReport:
        """Write the folder."""
        from exports.tables.vector_file import flat_warnings

        if target.suffix.lower() == ".shp":
            raise ExportError("a shapefile is several files; give the name of a folder for them")
        files = files_of(layers, target, ".shp", site=site)
        write_fields(layers, target / FIELDS_FILE, SHORT_NAMES)
        cut: list[tuple[str, int, str, str]] = []
        for layer in layers:
            _write_layer(site, layer, files[layer.name], options, cut)
        warnings = flat_warnings(layers, options.heights)
        if cut:
            _write_cut(cut, target / CUT_FILE)
            what = ", ".join(sorted({f"{layer}.{field}" for layer, _, field, _ in cut}))
            warnings.append(
                f"{len(cut)} texts of {what} are cut at {TEXT_BYTES} bytes, all that a shapefile "
                f"holds; they stand whole in {CUT_FILE}"
            )
        return report_of(site, layers, options.heights, warnings)


def _write_layer(
    site: SiteLayers,
    layer: Layer,
    path: Path,
    options: SpatialOptions,
    cut: list[tuple[str, int, str, str]],
) -> None:
    from exports.tables.vector_file import crs_text, geometries, write_table

    wkb, kind = geometries(layer, options.heights)
    columns = []
    for field in layer.fields:
        column = layer.columns[field.name]
        if field.kind == "text":
            column, rows = _fitting(column)
            cut += [(layer.name, row, field.name, text) for row, text in rows]
        elif field.kind == "flag":
            # the logical type of a DBF is read as a text by many
            column = replace(column, values=column.values.astype("int32"))
        columns.append(column)
    # GDAL writes a table without geometry as a DBF
    write_table(
        path if wkb is not None else path.with_suffix(".dbf"),
        [SHORT_NAMES.get(field.name, field.name) for field in layer.fields],
        columns,
        wkb,
        driver="ESRI Shapefile",
        geometry_type=kind,
        crs=None if wkb is None else crs_text(site),
        encoding="UTF-8",
    )


def _fitting(column: Column) -> tuple[Column, list[tuple[int, str]]]:
    """Texts that a DBF holds, and rows with whole texts of those that were cut."""
    import numpy as np

    values = column.values
    long = [
        (i, text)
        for i, text in enumerate(values.tolist())
        # a character has 4 bytes at most
        if text is not None and 4 * len(text) > TEXT_BYTES and len(text.encode()) > TEXT_BYTES
    ]
    if long:
        values = np.array(values, dtype=object)
        for i, text in long:
            values[i] = text.encode()[:TEXT_BYTES].decode(errors="ignore")
    return replace(column, values=values), long


def _write_cut(cut: Sequence[tuple[str, int, str, str]], path: Path) -> None:
    with path.open("w", encoding="utf-8-sig", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(("layer", "row", "name", "text"))
        writer.writerows(cut)
