"""Metadata of a product as FGDC-STD-001-1998 (CSDGM): what that standard asks for at least."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from exports.kml.elements import Element, element
from exports.metadata.iso import HEAD, abstract, how_tested, lineage_statement

if TYPE_CHECKING:
    from exports.metadata.facts import ProductFacts

# What the standard writes where a mandatory element is not known
UNKNOWN = "Unknown"
_DATA_FORM = {"grid": "remote-sensing image", "vector": "vector digital data",
              "textTable": "tabular digital data"}  # fmt: skip


def fgdc_metadata(facts: ProductFacts, now: datetime | None = None) -> str:
    """Metadata of a product as the text of an XML file.

    Parameters
    ----------
    now
        When the metadata are made, UTC.
    """
    return (
        HEAD
        + element(
            "metadata",
            _identification(facts),
            element("dataqual", *_quality(facts)),
            element("spdoinfo", *_organisation(facts)),
            _reference(facts),
            _distribution(facts),
            _about(facts, now or datetime.now(UTC)),
        )
        + "\n"
    )


def _text(tag: str, value: str) -> Element:
    return element(tag, text=value if value.strip() else UNKNOWN)


def _date(when: datetime) -> str:
    return when.strftime("%Y%m%d")


def _identification(facts: ProductFacts) -> Element:
    who, made = facts.site.project.settings.metadata, facts.product.made
    return element(
        "idinfo",
        element("citation", element(
            "citeinfo",
            _text("origin", who.organisation),
            _text("pubdate", _date(made)),
            _text("title", facts.title),
            _text("geoform", _DATA_FORM.get(facts.product.representation, UNKNOWN)),
        )),
        element(
            "descript",
            _text("abstract", abstract(facts)),
            _text("purpose", ""),
            _text("supplinf", f"{facts.checksum_of} of the product: {facts.checksum}; CRS: "
                  f"{_crs_name(facts) or UNKNOWN}"),
        ),
        element("timeperd", _period(facts), element("current", text=_current(facts))),
        element("status", element("progress", text="Complete"), _text("update", "")),
        _bounds(facts),
        element("keywords", element(
            "theme", element("themekt", text="None"), element("themekey", text="aerial imagery")
        )),
        element("accconst", text="None stated"),
        _text("useconst", who.licence),
    )  # fmt: skip


def _current(facts: ProductFacts) -> str:
    return "ground condition" if facts.site.flown else UNKNOWN


def _period(facts: ProductFacts) -> Element:
    flown = facts.site.flown
    if flown is None:
        single = element("sngdate", element("caldate", text=UNKNOWN))
        return element("timeinfo", single)
    first, last = flown
    return element("timeinfo", element(
        "rngdates",
        element("begdate", text=_date(first)),
        element("begtime", text=first.strftime("%H%M%SZ")),
        element("enddate", text=_date(last)),
        element("endtime", text=last.strftime("%H%M%SZ")),
    ))  # fmt: skip


def _bounds(facts: ProductFacts) -> Element:
    """Box; the standard lets the west lie east of the east across the antimeridian."""
    names = ("westbc", "eastbc", "northbc", "southbc")
    if facts.box is None:
        return element("spdom", element("bounding", *(_text(name, "") for name in names)))
    west, south, east, north = facts.box
    sides = zip(names, (west, east, north, south), strict=True)
    return element("spdom", element(
        "bounding", *(element(name, text=f"{side:.9f}") for name, side in sides)
    ))  # fmt: skip


def _quality(facts: ProductFacts) -> Iterable[Element]:
    yield element("logic", text="Not tested")
    yield element("complete", text="All photos of the project that could be placed are used")
    accuracy = facts.accuracy
    tested = {one.component: one for one in accuracy.tested if not one.vegetated} \
        if accuracy else {}  # fmt: skip
    why = " ".join(accuracy.statements) if accuracy else "The accuracy was not tested."
    parts = []
    for component, tag, names in (
        ("H", "horizpa", ("horizpar", "qhorizpa", "horizpav", "horizpae")),
        ("V", "vertacc", ("vertaccr", "qvertpa", "vertaccv", "vertacce")),
    ):
        one = tested.get(component)
        said = element(names[0], text=how_tested(accuracy, one) if one else why)
        # metres, as the standard asks
        figures = None if one is None else element(
            names[1],
            element(names[2], text=f"{one.rmse:.6g}"),
            element(names[3], text=f"RMSE in m at {one.points} check points"),
        )  # fmt: skip
        parts.append(element(tag, said, figures))
    yield element("posacc", *parts)
    steps = [
        element("procstep", element("procdesc", text=step.text),
                element("procdate", text=_date(step.when)),
                element("proctime", text=step.when.strftime("%H%M%SZ")))
        for step in facts.steps
    ]  # fmt: skip
    made = element(
        "procstep", element("procdesc", text=lineage_statement(facts)),
        element("procdate", text=_date(facts.product.made)),
    )  # fmt: skip
    yield element("lineage", *steps, made)


def _organisation(facts: ProductFacts) -> Iterable[Element]:
    raster = facts.product.representation == "grid"
    yield element("direct", text="Raster" if raster else "Vector")
    if facts.grid is not None:
        columns, rows = facts.grid
        yield element("rastinfo", element("rasttype", text="Pixel"),
                      element("rowcount", text=str(rows)),
                      element("colcount", text=str(columns)))  # fmt: skip


def _reference(facts: ProductFacts) -> Element | None:
    """CRS as text: the standard's own list of projections has none of NSRS 2022 or of a county.

    None without a spacing, as the standard has no word for an unknown one; the CRS is named in
    `supplinf` as well.
    """
    if facts.spacing is None:
        return None
    spacing = f"{facts.spacing:.9g}"
    name = _crs_name(facts)
    planar = element("planar", element(
        "gridsys",
        element("gridsysn", text="other grid system"),
        _text("othergrd", f"{name}: {facts.crs_wkt}" if name else ""),
    ), element(
        "planci",
        element("plance", text="row and column" if facts.grid else "coordinate pair"),
        element("coordrep", element("absres", text=spacing), element("ordres", text=spacing)),
        element("plandu", text="metres; coordinates in the unit of the CRS"),
    ))  # fmt: skip
    return element("spref", element("horizsys", planar))


def _crs_name(facts: ProductFacts) -> str:
    return " ".join(part for part in (facts.crs_name, facts.crs_code) if part)


def _distribution(facts: ProductFacts) -> Element:
    return element(
        "distinfo",
        element("distrib", _contact(facts)),
        element("resdesc", text=facts.product.path.name),
        element("distliab", text="None stated"),
    )


def _about(facts: ProductFacts, now: datetime) -> Element:
    return element(
        "metainfo",
        element("metd", text=_date(now)),
        element("metc", _contact(facts)),
        element("metstdn", text="FGDC Content Standard for Digital Geospatial Metadata"),
        element("metstdv", text="FGDC-STD-001-1998"),
    )


def _contact(facts: ProductFacts) -> Element:
    """Contact; the standard asks for a postal address and a telephone, which are not known."""
    who = facts.site.project.settings.metadata
    person = _text("cntper", who.contact) if who.contact.strip() else None
    place = ("addrtype", "city", "state", "postal")
    return element(
        "cntinfo",
        element("cntorgp", _text("cntorg", who.organisation), person),
        element("cntaddr", *(_text(tag, "") for tag in place)),
        _text("cntvoice", ""),
        _text("cntemail", who.email) if who.email.strip() else None,
    )
