"""Build the documentation as a site: ``python docs/build_site.py [FOLDER]``.

The site is plain files: open ``index.html``, or put the folder on any web server. It asks no other
host for anything.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def build(target: Path) -> list[str]:
    """Build the site; a warning is an error.

    Parameters
    ----------
    target
        Folder to make anew; beside the site in ``html`` it holds the source that it was made of.

    Returns
    -------
    left_out
        Chapters that the order names and that are not written.
    """
    from site_builder.staging import stage
    from sphinx.application import Sphinx

    if target.exists():
        if any(target.iterdir()) and not (target / "source/index.md").is_file():
            raise SystemExit(f"{target} holds other things than a site; name another folder")
        shutil.rmtree(target)
    left_out = stage(ROOT, target / "source")
    site = Sphinx(
        target / "source",
        ROOT / "docs",
        target / "html",
        target / "doctrees",
        "html",
        status=None,
        warningiserror=True,
    )
    site.build()
    if site.statuscode:
        raise SystemExit(f"{site._warncount} warnings; mend the pages that are named above")
    return left_out


def main() -> None:
    """Build, and say where the site is."""
    parser = argparse.ArgumentParser(description="Build the documentation as a site.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build/docs")
    target = parser.parse_args().folder
    try:
        left_out = build(target)
    except ModuleNotFoundError as error:
        raise SystemExit(
            f'the site needs {error.name}, which is not there; pip install -e ".[docs]"'
        ) from error
    for name in left_out:
        sys.stderr.write(f"docs/{name}.md is not written yet; left out\n")
    sys.stdout.write(f"{target / 'html/index.html'}\n")


if __name__ == "__main__":
    main()
