"""Metadata of a product as ISO 19115 in the XML of ISO 19139 (gmd), and no more than is known."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TYPE_CHECKING
from urllib.parse import quote

from exports.kml.elements import Element, element

if TYPE_CHECKING:
    from exports.metadata.facts import Accuracy, ProductFacts, Tested

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
NAMESPACES = {
    "xmlns:gmd": "http://www.isotc211.org/2005/gmd",
    "xmlns:gco": "http://www.isotc211.org/2005/gco",
    "xmlns:gml": "http://www.opengis.net/gml/3.2",
    "xmlns:xlink": "http://www.w3.org/1999/xlink",
    "xmlns:xs": "http://www.w3.org/2001/XMLSchema",
    "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
}
STANDARD = "ISO 19115:2003/19139"
CODELISTS = "http://standards.iso.org/iso/19139/resources/gmxCodelists.xml"
UNKNOWN = {"gco:nilReason": "unknown"}
METRE = {"xlink:href": "http://www.opengis.net/def/uom/EPSG/0/9001"}
# Name of the measure in ISO 19157 and what it is of
_MEASURES = {
    "H": ("root mean square error of planimetry", "horizontal, radial"),
    "V": ("root mean square error", "vertical"),
    "3D": ("root mean square error of the place in space", "three-dimensional"),
}


def iso_metadata(facts: ProductFacts, now: datetime | None = None) -> str:
    """Metadata of a product as the text of an XML file.

    Parameters
    ----------
    now
        When the metadata are made, UTC.
    """
    made = now or datetime.now(UTC)
    return (
        HEAD
        + element(
            "gmd:MD_Metadata",
            _text("gmd:fileIdentifier", identifier(facts)),
            _text("gmd:language", "eng"),
            _code("gmd:characterSet", "MD_CharacterSetCode", "utf8"),
            _code("gmd:hierarchyLevel", "MD_ScopeCode", "dataset"),
            element("gmd:contact", _party(facts)),
            element("gmd:dateStamp", element("gco:DateTime", text=_seconds(made))),
            _text("gmd:metadataStandardName", STANDARD),
            _text("gmd:metadataStandardVersion", "2003/2007"),
            _text("gmd:dataSetURI", quote(_encodable(facts.product.path.name))),
            _grid(facts),
            *_reference_systems(facts),
            element("gmd:identificationInfo", _identification(facts)),
            element("gmd:distributionInfo", _distribution(facts)),
            element("gmd:dataQualityInfo", _quality(facts)),
            **NAMESPACES,
        )
        + "\n"
    )


def identifier(facts: ProductFacts) -> str:
    """Name of the metadata that stays when a product is made again: of its site and its path."""
    project = facts.site.project
    place = facts.product.path.relative_to(project.folder).as_posix()
    origin = facts.site.layers.frame.origin
    site = f"{origin.lat:.9f} {origin.lon:.9f} {facts.site.layers.name}"
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"georef:{_encodable(f'{site} {place}')}"))


def _encodable(text: str) -> str:
    """Text without halves of surrogates, which names of files may hold."""
    return text.encode("utf-8", "replace").decode("utf-8")


# -- pieces ------------------------------------------------------------------------------------


def _text(tag: str, value: str) -> Element:
    """Element of a character string, or of the reason why it is empty."""
    if not value.strip():
        return element(tag, **UNKNOWN)
    return element(tag, element("gco:CharacterString", text=value))


def _code(tag: str, name: str, value: str) -> Element:
    coded = element(f"gmd:{name}", text=value, codeList=f"{CODELISTS}#{name}", codeListValue=value)
    return element(tag, coded)


def _seconds(when: datetime) -> str:
    return when.strftime("%Y-%m-%dT%H:%M:%SZ")


def _party(facts: ProductFacts) -> Element:
    """Who answers for it, as project.toml says."""
    who = facts.site.project.settings.metadata
    address = element(
        "gmd:contactInfo",
        element("gmd:CI_Contact", element(
            "gmd:address", element("gmd:CI_Address", _text("gmd:electronicMailAddress", who.email))
        )),
    )  # fmt: skip
    return element(
        "gmd:CI_ResponsibleParty",
        _text("gmd:individualName", who.contact) if who.contact.strip() else None,
        _text("gmd:organisationName", who.organisation),
        address if who.email.strip() else None,
        _code("gmd:role", "CI_RoleCode", "pointOfContact"),
    )


def _grid(facts: ProductFacts) -> Element | None:
    if facts.grid is None:
        return None
    length = None if facts.gsd is None else element(
        "gmd:resolution", element("gco:Length", text=f"{facts.gsd:.9g}", uom="m")
    )  # fmt: skip
    axes = [
        element("gmd:axisDimensionProperties", element(
            "gmd:MD_Dimension",
            _code("gmd:dimensionName", "MD_DimensionNameTypeCode", name),
            element("gmd:dimensionSize", element("gco:Integer", text=str(count))),
            length,
        ))
        for name, count in zip(("row", "column"), facts.grid[::-1], strict=True)
    ]  # fmt: skip
    return element("gmd:spatialRepresentationInfo", element(
        "gmd:MD_GridSpatialRepresentation",
        element("gmd:numberOfDimensions", element("gco:Integer", text="2")),
        *axes,
        _code("gmd:cellGeometry", "MD_CellGeometryCode", "area"),
        element("gmd:transformationParameterAvailability", element("gco:Boolean", text="true")),
    ))  # fmt: skip


def _reference_systems(facts: ProductFacts) -> Iterable[Element]:
    """CRS by its code and in full, and what heights are."""
    if not facts.crs_wkt:
        yield element("gmd:referenceSystemInfo", **UNKNOWN)
        return
    space, _, code = facts.crs_code.partition(":")
    if code:
        yield _reference_system(code, space)
    yield _reference_system(facts.crs_wkt, "WKT2:2019")
    if facts.height_kind and not facts.height_kind.startswith("none ("):
        yield _reference_system(f"heights: {facts.height_kind}", "georef_gis")


def _reference_system(code: str, space: str) -> Element:
    return element("gmd:referenceSystemInfo", element(
        "gmd:MD_ReferenceSystem", element(
            "gmd:referenceSystemIdentifier", element(
                "gmd:RS_Identifier", _text("gmd:code", code), _text("gmd:codeSpace", space)
            ),
        ),
    ))  # fmt: skip


# -- identification ----------------------------------------------------------------------------


def abstract(facts: ProductFacts) -> str:
    """What a product is, in a few sentences."""
    site, product = facts.site, facts.product
    count = len(site.layers.photos)
    parts = [
        f"{product.path.name} ({product.format}) of the site {site.layers.name}, made of "
        f"{count} aerial photo{'s' * (count != 1)} by georef_gis (tool {product.tool})."
    ]
    if site.flown and site.timed < count:
        parts.append(f"The time of exposure is known of {site.timed} of {count} photos.")
    if site.flown is None:
        parts.append("The times of exposure are not known in UTC.")
    if facts.height_kind:
        parts.append(f"Heights: {facts.height_kind}.")
    return " ".join([*parts, *(f"Doubt: {doubt}." for doubt in facts.doubts)])


def _identification(facts: ProductFacts) -> Element:
    return element(
        "gmd:MD_DataIdentification",
        element("gmd:citation", _citation(facts)),
        _text("gmd:abstract", abstract(facts)),
        element("gmd:pointOfContact", _party(facts)),
        element("gmd:resourceConstraints", _constraints(facts)),
        _code("gmd:spatialRepresentationType", "MD_SpatialRepresentationTypeCode",
              facts.product.representation),
        _resolution(facts),
        _text("gmd:language", "eng"),
        _code("gmd:characterSet", "MD_CharacterSetCode", "utf8"),
        element("gmd:topicCategory",
                element("gmd:MD_TopicCategoryCode", text="imageryBaseMapsEarthCover")),
        element("gmd:extent", _extent(facts)),
    )  # fmt: skip


def _citation(facts: ProductFacts) -> Element:
    date = element("gmd:date", element("gco:DateTime", text=_seconds(facts.product.made)))
    checksum = f"{facts.checksum_of}:{facts.checksum}"
    return element(
        "gmd:CI_Citation",
        _text("gmd:title", facts.title),
        element("gmd:date", element(
            "gmd:CI_Date", date, _code("gmd:dateType", "CI_DateTypeCode", "creation")
        )),
        element("gmd:identifier", element("gmd:MD_Identifier", _text("gmd:code", checksum))),
    )  # fmt: skip


def _constraints(facts: ProductFacts) -> Element:
    licence = facts.site.project.settings.metadata.licence
    return element(
        "gmd:MD_LegalConstraints",
        *(_text("gmd:useLimitation", doubt) for doubt in facts.doubts),
        _code("gmd:useConstraints", "MD_RestrictionCode", "otherRestrictions"),
        _text("gmd:otherConstraints", licence),
    )


def _resolution(facts: ProductFacts) -> Element:
    if facts.gsd is None:
        return element("gmd:spatialResolution", **UNKNOWN)
    return element("gmd:spatialResolution", element("gmd:MD_Resolution", element(
        "gmd:distance", element("gco:Distance", text=f"{facts.gsd:.9g}", uom="m")
    )))  # fmt: skip


def _extent(facts: ProductFacts) -> Element:
    place = element("gmd:geographicElement", **UNKNOWN)
    if facts.box is not None:
        west, south, east, north = facts.box
        sides = (("westBoundLongitude", west), ("eastBoundLongitude", east),
                 ("southBoundLatitude", south), ("northBoundLatitude", north))  # fmt: skip
        place = element("gmd:geographicElement", element(
            "gmd:EX_GeographicBoundingBox",
            *(element(f"gmd:{name}", element("gco:Decimal", text=f"{side:.9f}"))
              for name, side in sides),
        ))  # fmt: skip
    return element("gmd:EX_Extent", place, element("gmd:temporalElement", element(
        "gmd:EX_TemporalExtent", element("gmd:extent", _period(facts))
    )))  # fmt: skip


def _period(facts: ProductFacts) -> Element:
    """First to last exposure."""
    flown = facts.site.flown
    ends = ("gml:beginPosition", "gml:endPosition")
    if flown is None:
        inside = [element(tag, indeterminatePosition="unknown") for tag in ends]
    else:
        inside = [element(tag, text=_seconds(t)) for tag, t in zip(ends, flown, strict=True)]
    return element("gml:TimePeriod", *inside, **{"gml:id": "exposures"})


def _distribution(facts: ProductFacts) -> Element:
    name = _encodable(facts.product.path.name)
    return element(
        "gmd:MD_Distribution",
        element("gmd:distributionFormat", element(
            "gmd:MD_Format", _text("gmd:name", facts.product.format),
            element("gmd:version", **UNKNOWN),
        )),
        element("gmd:transferOptions", element(
            "gmd:MD_DigitalTransferOptions",
            element("gmd:transferSize", element("gco:Real", text=f"{facts.size / 1e6:.6f}")),
            element("gmd:onLine", element(
                "gmd:CI_OnlineResource",
                element("gmd:linkage", element("gmd:URL", text=quote(name))),
                _text("gmd:name", name),
            )),
        )),
    )  # fmt: skip


# -- quality -----------------------------------------------------------------------------------


def _quality(facts: ProductFacts) -> Element:
    scope = element("gmd:scope", element(
        "gmd:DQ_Scope", _code("gmd:level", "MD_ScopeCode", "dataset")
    ))  # fmt: skip
    return element("gmd:DQ_DataQuality", scope, *_reports(facts), _lineage(facts))


def _reports(facts: ProductFacts) -> Iterable[Element]:
    """What was tested, then what is only expected."""
    accuracy = facts.accuracy
    tested = accuracy.tested if accuracy else ()
    for one in tested:
        yield _report(
            *_MEASURES.get(one.component, (f"RMSE {one.component}", one.component)),
            method="directExternal", told=how_tested(accuracy, one),
            results=[_value(one.rmse), _conformance(accuracy, one)],
        )  # fmt: skip
    if not tested:
        why = " ".join(accuracy.statements) if accuracy else "The accuracy was not tested."
        yield _report(*_MEASURES["H"], method="", told=why, results=[])
    if facts.expected is not None:
        yield _report(
            "standard deviation", "horizontal, per axis", method="directInternal",
            told="Expected of the place of a photo's middle from the covariances of poses and "
            "ground; not tested by this figure.",
            results=[_value(facts.expected)],
        )  # fmt: skip


def how_tested(accuracy: Accuracy | None, one: Tested) -> str:
    """Number of points, on what and with which words."""
    on = f", measured on {accuracy.measured_on}" if accuracy and accuracy.measured_on else ""
    cover = ", vegetated ground" if one.vegetated else ""
    return f"{one.points} check points{cover}{on}. {one.statement}"


def _report(
    measure: str, of: str, *, method: str, told: str, results: list[Element | None]
) -> Element:
    filled = [element("gmd:result", one) for one in results if one is not None]
    return element("gmd:report", element(
        "gmd:DQ_AbsoluteExternalPositionalAccuracy",
        _text("gmd:nameOfMeasure", measure),
        _text("gmd:measureDescription", of),
        _code("gmd:evaluationMethodType", "DQ_EvaluationMethodTypeCode", method)
        if method else None,
        _text("gmd:evaluationMethodDescription", told),
        *(filled or [element("gmd:result", **UNKNOWN)]),
    ))  # fmt: skip


def _value(metres: float) -> Element:
    record = element("gco:Record", text=f"{metres:.6g}", **{"xsi:type": "xs:double"})
    return element(
        "gmd:DQ_QuantitativeResult",
        element("gmd:valueUnit", **METRE),
        element("gmd:value", record),
    )


def _conformance(accuracy: Accuracy | None, one: Tested) -> Element | None:
    """Whether a class that was declared before the test is met."""
    if accuracy is None or not one.declared or one.meets is None:
        return None
    title = element(
        "gmd:CI_Citation", _text("gmd:title", accuracy.standard), element("gmd:date", **UNKNOWN)
    )
    return element(
        "gmd:DQ_ConformanceResult",
        element("gmd:specification", title),
        _text("gmd:explanation", f"declared class {100.0 * one.accuracy_class:.10g} cm"),
        element("gmd:pass", element("gco:Boolean", text="true" if one.meets else "false")),
    )


def lineage_statement(facts: ProductFacts) -> str:
    """From what, how the poses were found and what the ground is."""
    site = facts.site.layers
    kinds = sorted({p.pose.kind for p in site.photos if p.pose})
    parts = [f"Photos: {len(site.photos)}. Poses: {', '.join(kinds) or 'none'}."]
    if "ground" in site.facts:
        parts.append(f"Ground: {site.facts['ground']}.")
    parts.append(f"Datum of the positions: {site.frame.gnss_datum}; of the CRS: "
                 f"{site.frame.crs_datum}.")  # fmt: skip
    return " ".join([*parts, *(f"Doubt: {doubt}." for doubt in facts.doubts)])


def _lineage(facts: ProductFacts) -> Element:
    steps = [
        element("gmd:processStep", element(
            "gmd:LI_ProcessStep",
            _text("gmd:description", step.text),
            element("gmd:dateTime", element("gco:DateTime", text=_seconds(step.when))),
        ))
        for step in facts.steps
    ]  # fmt: skip
    return element("gmd:lineage", element(
        "gmd:LI_Lineage", _text("gmd:statement", lineage_statement(facts)), *steps
    ))  # fmt: skip
