"""A run that matches and adjusts: what it says of control it cannot use, and of distances."""

from __future__ import annotations

import json

import pytest
from tool_cases import SAMPLE, Done, Site, copy_site

from georef_gis.errors import InputError
from georef_gis.project import Project
from processing_algorithms.measure.accuracy_adjusted import distances
from processing_algorithms.site import load_site

STEPS = "read_photos,orient_direct,footprints,match,adjust,mosaic,control,accuracy"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Site, Done]:
    """Five adjusted photos whose control states a CRS that there is not."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("adjusted") / "site", 5, orthos=False)
    path = site.folder / "control/control.csv"
    path.write_text(path.read_text().replace("# crs: EPSG:6601", "# crs: EPSG:77"))
    done = site.run("--only", STEPS)
    assert done.code == 0, done.text
    return site, done


def test_a_run_tells_once_that_a_refused_control_file_is_left_out(
    adjusted: tuple[Site, Done],
) -> None:
    site, done = adjusted
    (line,) = [one for one in done.text.splitlines() if "EPSG:77" in one]
    assert "is not a CRS that PROJ knows" in line
    assert "no control is used" in line
    ((warnings,),) = site.row("select warnings from run where tool = 'georef:adjust'")
    # the report page shows the warnings of every tool
    assert any("EPSG:77" in warning for warning in json.loads(warnings))


def test_the_statement_says_how_well_distances_within_the_site_are_known(
    adjusted: tuple[Site, Done],
) -> None:
    site, done = adjusted
    near, far = json.loads((site.products / "accuracy.json").read_text())["distances"]
    assert (near["length_m"], far["length_m"]) == (10.0, 50.0)
    # m; pixels of 4 cm reduced to half their number, poses of 3 m
    assert 0.005 < near["sigma_m"] < far["sigma_m"] < 1.5
    assert "Distances within the site: one sigma" in (site.products / "accuracy.txt").read_text()
    line = done.line("trust  distances within the site to")
    assert "at 10 m" in line
    assert "at 50 m (one sigma)" in line


def test_poses_from_tags_say_nothing_of_distances(adjusted: tuple[Site, Done]) -> None:
    site, _ = adjusted
    project = Project.open(site.folder, read_only=True)
    assert len(distances(project, load_site(project))) == 2
    assert distances(project, load_site(project, quick=True)) == ()


def test_a_broken_account_of_the_adjustment_is_named_with_its_cure(
    adjusted: tuple[Site, Done],
) -> None:
    site, _ = adjusted
    project = Project.open(site.folder, read_only=True)
    path = project.adjustment / "report.json"
    kept = path.read_bytes()
    path.write_bytes(kept[: len(kept) // 2])
    try:
        with pytest.raises(InputError, match="adjust --force"):
            distances(project, load_site(project))
    finally:
        path.write_bytes(kept)
