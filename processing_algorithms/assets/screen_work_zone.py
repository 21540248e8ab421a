"""Tool `screen_work_zone`: measured devices against the figures of the MUTCD."""

from __future__ import annotations

import json
from pathlib import Path

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p


class ScreenWorkZoneParameters(p.Parameters):
    """Parameters of `screen_work_zone`."""

    zone: p.File | None = p.file(
        None, title="What is to be screened; else work_zone.toml of the project",
        help="Where there is none, one to fill in is written.",
    )  # fmt: skip
    click: p.Number = p.number(0.5, title="One sigma of a click that states none, px", gt=0, le=100)
    target: p.Folder | None = p.folder(
        None, title="Folder for the results; else products", writes=True
    )


class ScreenWorkZone(Algorithm[ScreenWorkZoneParameters]):
    """Screen a work zone: taper lengths, device spacings, lane widths and sign spacings.

    Every answer is pass, fail, or cannot tell at this accuracy, by the joint covariance of the
    places; the last with the sigma that an answer would need. It is screening, not a statement of
    compliance.
    """

    id, name, group = "screen_work_zone", "Screen a work zone", "measure"
    about = "assets"
    needs = ("poses",)
    outputs = (
        Output(name="text", title="Account of the screening"),
        Output(name="table", title="Findings as CSV"),
        Output(name="json", title="Findings as JSON"),
        Output(name="zone", title="File to fill in, where there was none"),
    )

    def run(
        self, context: Context, parameters: ScreenWorkZoneParameters, feedback: Feedback
    ) -> Result:
        """Screen."""
        from georef_gis.errors import InputError
        from georef_gis.measure.workzone.screening import screen
        from georef_gis.measure.workzone.told import (
            DISCLAIMER,
            count_verdicts,
            finding_rows,
            screening_text,
        )
        from georef_gis.measure.workzone.zone_settings import read_zone
        from processing_algorithms.assets.zone_file import write_zone_file, zone_path
        from processing_algorithms.assets.zone_input import zone_assets, zone_checks, zone_rules
        from processing_algorithms.assets.zone_travel import travel_doubts

        project = context.require_project()
        path = zone_path(project, parameters.zone)
        if not path.is_file():
            return write_zone_file(project, path, feedback)
        zone = read_zone(path)
        zone.check_screening()
        rules = zone_rules(zone)
        found = zone_assets(project, zone, sigma_px=parameters.click)
        askew = travel_doubts(zone, found, [taper for _, taper in zone.signs])
        for doubt in (*found.places.doubts, *askew):
            feedback.warn(doubt)
        try:
            findings = screen(zone_checks(zone, found), found.measured, rules)
        except InputError as error:
            if error.source == zone.source:
                raise
            raise InputError(str(error), source=zone.source) from error
        text = screening_text(findings, rules, zone.speed_mph or 0.0, found.places.basis)
        for line in text.splitlines():
            feedback.info(line)
        account: dict[str, object] = {
            "about": DISCLAIMER,
            "rules": {"edition": rules.edition, "title": rules.title, "note": rules.note},
            "speed_mph": zone.speed_mph,
            "covariance": found.places.basis,
            "findings": finding_rows(findings),
        }
        outputs = _write(parameters.target or project.products, text, account)
        counts = {word.replace(" ", "_"): n for word, n in count_verdicts(findings).items()}
        summary = {"findings": sum(counts.values()), **counts, "about": DISCLAIMER}
        return Result(outputs=outputs, summary=summary)


def _write(folder: Path, text: str, account: dict[str, object]) -> dict[str, Path]:
    from georef_gis.measure.workzone.told import COLUMNS
    from georef_gis.rasters.files import export_errors, whole_file
    from processing_algorithms.measure.point_table import write_rows

    outputs = {
        "text": folder / "work_zone_screening.txt",
        "table": folder / "work_zone_screening.csv",
        "json": folder / "work_zone_screening.json",
    }
    told = json.dumps(account, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    with export_errors(folder, lambda: len(told)):
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in (("text", text), ("json", told)):
            with whole_file(outputs[name]) as stream:
                stream.write(content.encode())
    rows = account["findings"]
    assert isinstance(rows, list)
    # also where the table is looked at alone
    write_rows(outputs["table"], [row | {"about": account["about"]} for row in rows],
               (*COLUMNS, "about"))  # fmt: skip
    return outputs
