"""The docs show what the code reads."""

import csv
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_docs_hold_the_table_of_dialects() -> None:
    text = (ROOT / "docs/frames.md").read_text("utf-8")
    with (ROOT / "georef_gis/data/dialects.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            assert "| " + " | ".join(row.values()) + " |" in text, row["dialect"]


def test_commands_of_the_readme_exist() -> None:
    from georef_gis.toolbox.registry import load_registry

    registry = load_registry()
    known = {registry.command(tool) for tool in registry} | {"run", "serve", "tools", "doctor"}
    # a command of two words, such as `georef sync-board record`
    known |= {tool.algorithm.command[0] for tool in registry if tool.algorithm.command}
    readme = (ROOT / "README.md").read_text("utf-8")
    named = {
        line.split("`georef ")[1].split("`")[0].split()[0]
        for line in readme.splitlines()
        if line.startswith("| `georef ")
    }
    assert {name for name in named if not name.startswith("export-")} <= known
