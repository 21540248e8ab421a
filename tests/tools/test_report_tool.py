"""Tool `report`: the page of a project, with and without an adjustment, and of a broken one."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import pytest
from tool_cases import SAMPLE, Site, copy_site

from georef_gis.project import Project
from georef_gis.rasters.preview import read_preview
from georef_gis.toolbox import Result
from georef_gis.toolbox.context import CollectingFeedback, Context
from processing_algorithms.measure.report import REPORT, Report

STEPS = "read_photos,orient_direct,footprints,mosaic,control"


def report(site: Site, *, quick: bool = False) -> tuple[str, Result, list[str]]:
    feedback = CollectingFeedback()
    project = Project.open(site.folder)
    result = Report().run(Context(project=project, quick=quick), Report.Parameters(), feedback)
    project.close()
    return (site.products / REPORT).read_text("utf-8"), result, feedback.warnings


@pytest.fixture(scope="module")
def direct(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Five photos of the sample project, from tags alone."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("report") / "site", 5, orthos=False)
    done = site.run("--only", STEPS)
    assert done.code == 0, done.text
    return site


def test_the_page_of_a_direct_result_is_one_file_and_says_what_is_not_there(direct: Site) -> None:
    text, result, warnings = report(direct)
    assert result.outputs["report"] == direct.products / REPORT
    assert result.summary["products"] == [str(direct.products / REPORT)]
    assert warnings == []
    assert not re.search(r'(src|href)="(?!#|data:image/)', text)
    for said in ("5 from the tags alone", "NAD83(2011)", "0.30480061 m", "there is no tie map",
                 "There is no accuracy statement", "The ground has no relief"):  # fmt: skip
        assert said in text, said
    assert direct.litter() == []


def test_the_map_shows_the_mosaic(direct: Site) -> None:
    text, _, _ = report(direct)
    found = re.search(r'data:image/jpeg;base64,([^"]+)', text)
    assert found is not None
    image = cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert min(image.shape[:2]) > 400
    # grass: green above blue over a good part of the picture
    green = image[..., 1].astype(int) - image[..., 0]
    assert float(np.mean(green > 25)) > 0.2


@pytest.mark.usefixtures("pictures_undrawn")
def test_a_quick_page_leaves_the_adjustment_out(direct: Site) -> None:
    text, _, _ = report(direct, quick=True)
    assert "A quick run: it stops at the poses from the tags" in text
    assert "A quick run matches nothing" in text


@pytest.mark.usefixtures("pictures_undrawn")
def test_files_that_cannot_be_read_are_told_and_the_rest_is_shown(
    direct: Site, tmp_path: Path
) -> None:
    overlap = direct.products / "overlap.tif"
    kept = overlap.read_bytes()
    try:
        overlap.write_bytes(b"no raster")
        text, _, warnings = report(direct)
    finally:
        overlap.write_bytes(kept)
    (line,) = warnings
    assert "overlap.tif" in line
    assert "There is no overlap map" in text
    assert "Not shown here" in text
    assert "The mosaic should be whole" in text


def test_a_preview_has_the_place_and_the_counts_of_its_raster(direct: Site) -> None:
    path = direct.products / "overlap.tif"
    whole, small = (
        read_preview(path, most=10**6, average=False),
        read_preview(path, most=200, average=False),
    )
    assert max(small.valid.shape) == 200
    assert small.extent == pytest.approx(whole.extent, rel=1e-12)
    # nearest pixels: counts stay whole numbers of photos
    assert set(np.unique(small.values)) <= set(np.unique(whole.values))
    # 0.5 % of the site: the raggedness of 200 px
    assert small.valid.mean() == pytest.approx(whole.valid.mean(), abs=0.005)


@pytest.mark.slow
def test_an_adjusted_project_shows_ties_residuals_camera_and_accuracy(
    make_site: Callable[..., Site], undrawn: Callable[[], AbstractContextManager[None]]
) -> None:
    site = make_site(5, orthos=False)
    steps = "read_photos,orient_direct,match,adjust,footprints,mosaic,control,accuracy"
    with undrawn():
        done = site.run("--only", steps)
    assert done.code == 0, done.text
    text, result, _ = report(site)
    for title in (
        "Tie map", "Checks against what was known before", "Photos of the adjustment",
        "Adjusted less direct poses", "Residuals over the image", "Distribution of the residuals",
        "Residuals by photo", "Residuals by place", "Distortion of", "Shared unknowns",
        "Correlations of the unknowns", "Mount, boresight, receiver and clock by flight", "Relief",
        "Points: adjusted less surveyed", "Statement and account", "Last runs",
    ):  # fmt: skip
        assert f">{title}" in text, title
    assert len(re.findall("<img ", text)) >= 12
    assert result.summary["fine"] > result.summary["bad"]
    assert result.summary["size_kb"] < 8000
    damaged = site.folder / "adjustment" / "residuals.npz"
    damaged.write_bytes(damaged.read_bytes()[:500])
    with undrawn():
        text, _, warnings = report(site)
        quick, _, _ = report(site, quick=True)
    assert any("residuals.npz" in line for line in warnings)
    assert ">Photos of the adjustment" in text
    assert "The residuals of the adjustment are not there" in text
    # the adjustment is there, but a quick page does not speak of it
    assert ">Photos of the adjustment" not in quick
