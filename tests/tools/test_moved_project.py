"""A project that is moved, copied or mounted elsewhere is the same project."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable

import pytest
from tool_cases import Site

from georef_gis.project import Project


@pytest.mark.usefixtures("pictures_undrawn")
def test_a_copied_project_is_up_to_date_and_reads_its_own_photos(
    make_site: Callable[..., Site],
) -> None:
    site = make_site(3)
    assert site.run("--quick").code == 0
    copy = Site(site.folder.with_name("elsewhere"))
    shutil.copytree(site.folder, copy.folder, copy_function=shutil.copy2)
    shutil.rmtree(site.folder)
    done = copy.run("--quick")
    assert done.code == 0, done.text
    done.line("steps were unchanged")
    rows = Project.open(copy.folder).database.rows("photo")
    assert {row["path"] for row in rows} == {str(photo) for photo in copy.photos}
    again = copy.run("--quick", "--only", "mosaic", "--force")
    assert again.code == 0, again.text


def test_paths_of_photos_outside_stay_absolute(make_site: Callable[..., Site]) -> None:
    site = make_site(3)
    outside = site.folder.with_name("card")
    shutil.move(site.folder / "photos", outside)
    site.set("photos", folder=str(outside))
    assert site.run("--quick", "--only", "read_photos").code == 0
    with sqlite3.connect(site.folder / "georef.gpkg") as database:
        paths = {row[0] for row in database.execute("SELECT path FROM photo")}
    assert paths == {path.as_posix() for path in outside.glob("*.JPG")}
