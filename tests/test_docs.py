"""The docs show what the code reads."""

import csv
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_docs_hold_the_table_of_dialects() -> None:
    text = (ROOT / "docs/frames.md").read_text("utf-8")
    with (ROOT / "georef_gis/data/dialects.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            assert "| " + " | ".join(row.values()) + " |" in text, row["dialect"]


def commands() -> set[str]:
    from georef_gis.app.cli import BUILT_IN
    from georef_gis.toolbox.registry import load_registry

    registry = load_registry()
    known = {registry.command(tool) for tool in registry} | set(BUILT_IN)
    # a command of two words, such as `georef sync-board record`
    return known | {tool.algorithm.command[0] for tool in registry if tool.algorithm.command}


def test_commands_of_the_readme_exist() -> None:
    known = commands()
    readme = (ROOT / "README.md").read_text("utf-8")
    named = {
        line.split("`georef ")[1].split("`")[0].split()[0]
        for line in readme.splitlines()
        if line.startswith("| `georef ")
    }
    assert {name for name in named if not name.startswith("export-")} <= known


def test_commands_of_the_first_hour_exist_and_its_clicks_can_be_read(tmp_path: Path) -> None:
    from georef_gis.measure.assets.domain import load_domain
    from processing_algorithms.assets.asset_clicks import read_clicks

    text = (ROOT / "docs/start.md").read_text("utf-8")
    lines = [line.removeprefix("    ") for line in text.splitlines() if line.startswith("    ")]
    called = [line.rpartition("georef ")[2].split()[0] for line in lines if "georef " in line]
    assert len(called) > 8
    assert set(called) <= commands() | {"init"}
    table = tmp_path / "clicks.csv"
    start, end = lines.index("cat > clicks.csv <<'END'"), lines.index("END")
    table.write_text("\n".join(lines[start + 1 : end]), encoding="utf-8")
    clicked = read_clicks(table, load_domain())
    assert len(clicked) == 10
    photos = {click.photo_id for one in clicked for click in one.clicks}
    assert all((ROOT / "sample_project/photos" / name).is_file() for name in photos)


def test_every_page_that_the_readme_or_a_page_names_is_there() -> None:
    import re

    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for name in re.findall(r"`(?:docs/)?([a-z_0-9]+\.md)`", page.read_text("utf-8")):
            assert (ROOT / "docs" / name).is_file(), (page.name, name)
