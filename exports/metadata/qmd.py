"""Metadata of a raster as QGIS reads them: a ``.qmd`` beside it, among a layer's properties."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from exports.kml.elements import Element, element
from exports.metadata.files import QMD
from exports.metadata.iso import HEAD, abstract, identifier, lineage_statement

if TYPE_CHECKING:
    from exports.metadata.facts import ProductFacts

# QGIS looks for the name without its ending, so that of several kinds one alone can have a file
_KINDS = (".tif", ".tiff")


def qgis_path(product: Path) -> Path | None:
    """File that QGIS looks for; None beside what it would not ask for, or not for this alone."""
    is_raster = product.suffix.lower() in _KINDS and not product.is_dir()
    return product.with_suffix(QMD) if is_raster else None


def qgis_metadata(facts: ProductFacts) -> str:
    """Metadata of a product as the text of an XML file (QGIS 3, ``QgsLayerMetadata``)."""
    accuracy = facts.accuracy.statements if facts.accuracy else ("The accuracy was not tested.",)
    history = [lineage_statement(facts), *(f"{step.when:%Y-%m-%d} {step.text}"
                                           for step in facts.steps)]  # fmt: skip
    return (
        HEAD
        + element(
            "qgis",
            element("identifier", text=identifier(facts)),
            element("language", text="eng"),
            element("type", text="dataset"),
            element("title", text=facts.title),
            element("abstract", text=" ".join([abstract(facts), *accuracy])),
            _contact(facts),
            *(element("history", text=line) for line in history),
            *(element("constraints", text=doubt, type="other") for doubt in facts.doubts),
            element("license", text=facts.site.project.settings.metadata.licence or "unknown"),
            _crs(facts),
            _extent(facts),
            version="3.22.0",
        )
        + "\n"
    )


def _contact(facts: ProductFacts) -> Element | None:
    who = facts.site.project.settings.metadata
    said = {"name": who.contact, "organization": who.organisation, "email": who.email}
    if not any(text.strip() for text in said.values()):
        return None
    parts = [element(tag, text=text) for tag, text in said.items()]
    return element("contact", *parts, element("role", text="pointOfContact"))


def _crs(facts: ProductFacts) -> Element | None:
    if not facts.crs_wkt:
        return None
    return element("crs", element(
        "spatialrefsys",
        element("wkt", text=facts.crs_wkt),
        element("authid", text=facts.crs_code),
        nativeFormat="Wkt",
    ))  # fmt: skip


def _extent(facts: ProductFacts) -> Element:
    parts = []
    # QGIS has no box across the antimeridian
    if facts.box is not None and facts.box[0] <= facts.box[2]:
        names = ("minx", "miny", "maxx", "maxy")
        sides = {name: f"{side:.9f}" for name, side in zip(names, facts.box, strict=True)}
        parts.append(
            element("spatial", crs="EPSG:4326", dimensions="2", minz="0", maxz="0", **sides)
        )
    if facts.site.flown is not None:
        first, last = (f"{when:%Y-%m-%dT%H:%M:%SZ}" for when in facts.site.flown)
        period = element("period", element("start", text=first), element("end", text=last))
        parts.append(element("temporal", period))
    return element("extent", *parts)
