"""Makes the pictures of docs/qgis.md in the QGIS of the system, from the sample project.

``python tests/qgis/make_pictures.py [PROJECT]``; PROJECT is a copy of the sample project that was
run, with the assets of docs/start.md; without it one is made, which takes a minute.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from qgis_cases import ROOT, copy_sample, drive, georef, install, write_inputs

PICTURES = ROOT / "docs/pictures"
# px of the whole picture; the site on the left, two details on the right
WIDTH, HEIGHT, DETAIL = 1180, 640, 380


def run_project(base: Path) -> Path:
    """A project with all products and assets."""
    project = copy_sample(base / "sample_project")
    write_inputs(base)
    commands = (
        ("run", project),
        ("assets", "--project", project, "--clicks", base / "clicks.csv"),
        ("export-geopackage", "--project", project),
    )
    for words in commands:
        done = georef(*words)
        assert done.returncode == 0, done.stderr
    return project


def main() -> None:
    """Draw products and a dialog."""
    base = Path(tempfile.mkdtemp())
    project = Path(sys.argv[1]).absolute() if len(sys.argv) > 1 else run_project(base)
    install(base / "home")
    half = (HEIGHT - 6) // 2
    without = ["Footprints", "Flight track", "Photos"]
    jobs: list[dict[str, Any]] = [
        {"kind": "run", "id": "georef:show_project", "keep": True,
         "parameters": {"PROJECT": str(project)}},
        {"kind": "picture", "around": "mosaic", "size": [WIDTH - DETAIL - 6, HEIGHT],
         "target": str(base / "site.png")},
        {"kind": "picture", "around": "Assets", "where": "name IN ('C03', 'C08')", "margin": 6,
         "size": [DETAIL, half], "target": str(base / "cones.png"), "without": without},
        {"kind": "picture", "around": "Error ellipses of assets", "where": "name = 'C05'",
         "margin": 0.7, "size": [DETAIL, half], "target": str(base / "one.png"),
         "without": without},
        {"kind": "dialogs", "only": ["mosaic"], "size": [1000, 620],
         "values": {"PROJECT": "/home/user/my_site", "gsd": 0.05},
         "pictures": {"mosaic": str(base / "dialog.png")}},
    ]  # fmt: skip
    for result in drive(base / "home", base, jobs):
        assert not result.get("crashed"), result["log"]
        assert not result.get("errors"), result["errors"]
    whole = Image.new("RGB", (WIDTH, HEIGHT), "white")
    whole.paste(Image.open(base / "site.png"), (0, 0))
    whole.paste(Image.open(base / "cones.png"), (WIDTH - DETAIL, 0))
    whole.paste(Image.open(base / "one.png"), (WIDTH - DETAIL, HEIGHT - half))
    # A third of the bytes; this way of choosing the colours keeps the rare ones, of signs.
    few = Image.Quantize.MAXCOVERAGE
    whole.quantize(256, method=few).save(PICTURES / "qgis_products.png", optimize=True)
    dialog = Image.open(base / "dialog.png").convert("RGB")
    dialog.quantize(64, method=few).save(PICTURES / "qgis_dialog.png", optimize=True)


if __name__ == "__main__":
    main()
