"""Tools `export_metadata` and `check_metadata`: what a product is, beside the product."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import ExportError
from georef_gis.toolbox import Algorithm, Context, Feedback, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.metadata.facts import ProductFacts
    from exports.metadata.products import Product

KEPT = {
    "edited": "was changed by hand or by another program and is left as it is; delete it to have "
    "it written anew",
    "foreign": "is not of georef and is left as it is; move it away to have ours written",
    "too long": "is too long a name for a file; give the product a shorter one",
    "folder": "is a folder, so that no metadata can be written there; move it away",
}


class MetadataParameters(p.Parameters):
    """Parameters of both."""

    standard: p.Choice = p.choice(
        "iso",
        title="Standard",
        help="iso: ISO 19115 as ISO 19139 XML, beside the product as NAME.xml. fgdc: FGDC CSDGM "
        "as NAME.fgdc.xml. both: the two. With iso also a .qmd beside each GeoTIFF, for QGIS.",
        choices=("iso", "fgdc", "both"),
    )


class Metadata(Algorithm[MetadataParameters]):
    """Metadata of all products, each beside its product, with the accuracy statement.

    Each file tells title, dates, extent, CRS, resolution, lineage with the versions and parameters
    of every step, the accuracy that was tested at check points, terms of use, and the checksum of
    the product that it is of. What is not known is said to be unknown. Who made it and under which
    terms comes from [metadata] of project.toml. docs/metadata.md tells each field's source.
    """

    id, name, group = "export_metadata", "Export metadata beside the products", "export"
    needs = ("photos",)
    wants = ("poses", "adjusted", "footprints", "orthos", "mosaic", "control", "accuracy", "report")
    in_run = True
    # folders of features, .qmd files, valid FGDC
    version = "2"

    def inputs(self, context: Context, parameters: MetadataParameters) -> Sequence[Path]:
        """Products, which exports by hand change outside of any run."""
        from exports.metadata.products import read_products

        return [product.path for product in read_products(context.require_project())]

    def run(self, context: Context, parameters: MetadataParameters, feedback: Feedback) -> Result:
        """Write the files; remove ours of products that are gone."""
        from exports.metadata.files import metadata_path, remove_orphans
        from exports.metadata.products import read_products
        from exports.metadata.qmd import qgis_path

        project = context.require_project()
        products = read_products(project)
        written: list[Path] = []
        if products:
            written = self._write(context, products, parameters, feedback)
        kept = {metadata_path(one.path) for one in products} | set(written)
        kept |= {path for one in products if (path := qgis_path(one.path)) is not None}
        for path in remove_orphans(project.products, kept):
            feedback.info(f"{path.name}: removed, for what it was of is gone")
        # one name each: a file that is deleted is written again by the next run
        return Result(
            outputs={path.name: path for path in written},
            summary={"files": len(written), "of": len(products)},
        )

    def _write(
        self, context: Context, products: Sequence[Product], parameters: MetadataParameters,
        feedback: Feedback,
    ) -> list[Path]:  # fmt: skip
        from exports.metadata.facts import SiteFacts
        from exports.metadata.files import write_metadata
        from exports.site.site import SiteLayers

        project = context.require_project()
        site = SiteLayers.from_project(project)
        for warning in site.warnings:
            feedback.warn(warning)
        facts = SiteFacts.of(project, site)
        written = []
        for number, product in enumerate(products):
            check_cancelled(feedback)
            feedback.progress(number / len(products), product.path.name)
            targets = _free(product, parameters, feedback)
            one = facts.product(product) if targets else None
            for path, write in targets.items():
                assert one is not None
                write_metadata(path, write(one), one.checksum)
                written.append(path)
            if product.older_than and targets:
                feedback.warn(
                    f"{product.path.name}: older than the {product.older_than} of the project, "
                    "which its metadata say; export it again"
                )
        return written


def _targets(product: Path, parameters: MetadataParameters) -> list[Path]:
    """Files that are asked for beside a product."""
    from exports.metadata.files import FGDC, ISO, metadata_path

    endings = {"iso": (ISO,), "fgdc": (FGDC,), "both": (ISO, FGDC)}[parameters.standard]
    return [metadata_path(product, ending) for ending in endings]


def _writers() -> Mapping[str, Callable[[ProductFacts], str]]:
    """What makes the text of a file, by the ending of its name."""
    from exports.metadata.fgdc import fgdc_metadata
    from exports.metadata.files import FGDC, ISO, QMD
    from exports.metadata.iso import iso_metadata
    from exports.metadata.qmd import qgis_metadata

    return {FGDC: fgdc_metadata, ISO: iso_metadata, QMD: qgis_metadata}


def _free(
    product: Product, parameters: MetadataParameters, feedback: Feedback
) -> dict[Path, Callable[[ProductFacts], str]]:
    """Files to write of a product: those in whose place nothing lies that is not ours."""
    from exports.metadata.files import state_of
    from exports.metadata.qmd import qgis_path

    targets = _targets(product.path, parameters)
    if parameters.standard != "fgdc" and (path := qgis_path(product.path)) is not None:
        targets.append(path)
    out: dict[Path, Callable[[ProductFacts], str]] = {}
    for path in targets:
        state = state_of(path)
        if state in KEPT:
            feedback.warn(f"{path.name}: {KEPT[state]}")
        else:
            # the first that fits: an FGDC file's name ends as an ISO file's does, too
            out[path] = next(w for end, w in _writers().items() if path.name.endswith(end))
    return out


class CheckMetadata(Algorithm[MetadataParameters]):
    """Whether every product has metadata of its present state; fails if one has not.

    The checksum that each file states is compared with that of the product as it is now.
    """

    id, name, group = "check_metadata", "Check the metadata beside the products", "export"
    needs = ("photos",)

    def run(self, context: Context, parameters: MetadataParameters, feedback: Feedback) -> Result:
        """Compare; nothing is written.

        Raises
        ------
        ExportError
            If a product's metadata are missing or of an older state; names the first.
        """
        from exports.metadata.checksums import checksum
        from exports.metadata.files import checksum_in
        from exports.metadata.products import read_products

        wrong: list[str] = []
        products = read_products(context.require_project())
        for number, product in enumerate(products):
            check_cancelled(feedback)
            feedback.progress(number / len(products), product.path.name)
            now = checksum(product.path)[0]
            for path in _targets(product.path, parameters):
                found = checksum_in(path)
                if found != now:
                    wrong.append(f"{path.name} {'is of an older state' if found else 'is missing'}")
        if wrong:
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            raise ExportError(f"metadata: {wrong[0]}{more}; run `georef export-metadata`")
        return Result(summary={"products_checked": len(products)})
