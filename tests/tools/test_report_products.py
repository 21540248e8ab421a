"""Tool `report` on projects with a trajectory and assets, and its PDF: whole or not at all."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
from pypdf import PdfReader
from tool_cases import SAMPLE, Site, copy_site, georef

import georef_gis.measure.report.pdf as pdf_module
from georef_gis.measure.report.flight_facts import Flown
from georef_gis.project import Project
from processing_algorithms.measure.report import PDF, REPORT
from processing_algorithms.measure.report_flight import flown

STEPS = "read_photos,navigate,orient_direct,orient_navigation,footprints"
EVIL = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def navigated(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Five photos with the trajectory of their logs, four assets and their pictures."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("report") / "site", 5, orthos=False)
    done = site.run("--only", STEPS)
    assert done.code == 0, done.text
    clicks = ["asset,class,photo,u,v"]
    clicks += [f"C{k},cone,IMG_0002.JPG,{300 + 150 * k},400" for k in range(3)]
    clicks.append(f"{EVIL},drum,IMG_0003.JPG,600,300")
    (site.folder / "clicks.csv").write_text("\n".join(clicks) + "\n", encoding="utf-8")
    words = ("--project", site.folder, "--clicks", site.folder / "clicks.csv", "--thumbnails")
    done = georef("assets", *words)
    assert done.code == 0, done.text
    return site


def facts_and_flight(site: Site, *, quick: bool = False) -> Flown:
    from georef_gis.measure.report.facts import read_facts

    project = Project.open(site.folder)
    try:
        found = flown(project, read_facts(project, quick=quick), quick=quick)
    finally:
        project.close()
    assert found is not None
    return found


def test_the_page_shows_flight_budget_assets_and_settings(navigated: Site) -> None:
    done = georef("report", "--project", navigated.folder)
    assert done.code == 0, done.text
    text = (navigated.products / REPORT).read_text("utf-8")
    for title in (
        "Flight from above", "Position over time", "GNSS fixes less smoothed path",
        "Attitude over time", "Error budget by source", "What to fix first", "Assets one by one",
        "Pictures of the assets", "All doubts", "Versions", "project.toml",
    ):  # fmt: skip
        assert f">{title}<" in text, title
    assert EVIL not in text
    assert "&lt;script&gt;" in text
    assert text.count('alt="Photo of ') == 4
    # of project.toml what is stated, without its comments
    assert "max_side = 650" in text
    assert "# Settings of a georef project" not in text


def test_the_fixes_lie_about_the_path_as_far_as_the_receiver_errs(navigated: Site) -> None:
    found = facts_and_flight(navigated)
    assert not found.of_photos
    assert len(found.exposures) == 5
    assert set(found.series) == {"raw fixes", "filter", "smoothed"}
    assert found.fixes is not None
    # m; the simulated receiver errs by 2.1 m, slow and white together
    rms = (found.fixes.apart**2).mean(axis=0) ** 0.5
    assert rms.max() < 2.5
    assert found.notes == ()


def test_a_quick_page_flies_by_the_tags(navigated: Site) -> None:
    found = facts_and_flight(navigated, quick=True)
    assert found.of_photos
    assert len(found.exposures) == 5


def test_logs_that_are_gone_cost_the_fixes_only(navigated: Site) -> None:
    path = navigated.folder / "logs" / "gnss.csv"
    kept = path.read_bytes()
    try:
        path.write_bytes(b"nothing")
        found = facts_and_flight(navigated)
    finally:
        path.write_bytes(kept)
    assert found.fixes is None
    (note,) = found.notes
    assert "the fixes are not shown" in note
    assert "gnss.csv" in note


@pytest.mark.usefixtures("pictures_undrawn")
def test_settings_that_changed_after_a_run_are_told(navigated: Site) -> None:
    navigated.set("ground", sigma_m=0.7)
    try:
        assert georef("report", "--force", "--project", navigated.folder).code == 0
        text = (navigated.products / REPORT).read_text("utf-8")
    finally:
        navigated.set("ground", sigma_m=None)
    assert "settings changed after the last run of" in text
    assert "footprints (ground)" in text


@pytest.mark.usefixtures("pictures_undrawn")
def test_pictures_older_than_their_asset_are_not_shown(navigated: Site) -> None:
    from os import utime

    pictures = sorted((navigated.products / "assets").glob("*.jpg"))
    assert len(pictures) == 4
    utime(pictures[0], (0, 0))
    pictures[1].write_bytes(b"no picture")
    assert georef("report", "--force", "--project", navigated.folder).code == 0
    assert (navigated.products / REPORT).read_text("utf-8").count('alt="Photo of ') == 2


@pytest.mark.usefixtures("pictures_undrawn")
def test_the_report_makes_no_file_of_assets(tmp_path: Path) -> None:
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path / "site", 2, orthos=False)
    assert site.run("--only", "read_photos,orient_direct,footprints").code == 0
    assert georef("report", "--project", site.folder).code == 0
    assert not (site.folder / "assets.gpkg").exists()
    assert "Nothing was mapped yet" in (site.products / REPORT).read_text("utf-8")


@pytest.mark.usefixtures("pictures_undrawn")
def test_assets_that_cannot_be_read_cost_their_part_only(navigated: Site) -> None:
    path = navigated.folder / "assets.gpkg"
    kept = path.read_bytes()
    try:
        path.write_bytes(b"no database" * 1000)
        done = georef("report", "--force", "--project", navigated.folder)
    finally:
        path.write_bytes(kept)
    assert done.code == 0, done.text
    done.line("The assets cannot be read", "assets.gpkg")
    text = (navigated.products / REPORT).read_text("utf-8")
    assert ">Error budget by source<" in text
    findings = text.split('id="findings"')[1].split("</section>")[0]
    assert "The assets cannot be read" in findings


# -- PDF -------------------------------------------------------------------------------------------


def test_the_pdf_holds_what_the_page_holds(navigated: Site) -> None:
    done = georef("report", "--pdf", "--force", "--project", navigated.folder)
    assert done.code == 0, done.text
    done.line("wrote", PDF)
    reader = PdfReader(io.BytesIO((navigated.products / PDF).read_bytes()))
    text = "".join(page.extract_text() for page in reader.pages)
    for said in ("Flight from above", "Error budget by source", EVIL, "max_side = 650"):
        # long words of a cell are broken
        assert said.replace(" ", "") in "".join(text.split()), said
    assert navigated.litter() == []


@pytest.mark.usefixtures("pictures_undrawn")
def test_a_pdf_that_fails_leaves_the_one_before(
    navigated: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = navigated.products / PDF
    target.write_bytes(b"the one before")

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pdf_module, "render_pdf", fail)
    done = georef("report", "--pdf", "--force", "--project", navigated.folder)
    assert done.code != 0
    assert "No space left" in done.text
    assert target.read_bytes() == b"the one before"
    assert navigated.litter() == []


@pytest.mark.usefixtures("pictures_undrawn")
def test_without_the_library_one_line_says_what_to_install_and_the_page_is_written(
    navigated: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    (navigated.products / REPORT).unlink(missing_ok=True)
    monkeypatch.setitem(sys.modules, "reportlab", None)
    done = georef("report", "--pdf", "--force", "--project", navigated.folder)
    assert done.code == 2
    done.line(
        "reportlab", "not installed", 'pip install "georef-gis[pdf]"', "report.html is written"
    )
    assert "Traceback" not in done.text
    assert (navigated.products / REPORT).read_text("utf-8").endswith("</html>\n")


@pytest.mark.usefixtures("pictures_undrawn")
@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("__init__.py", "ImportError: libfreetype.so.6: cannot open shared object file"),
        ("__init__.py", "RuntimeError: half installed"),
        ("rl_config.py", "SyntaxError: null bytes"),
    ],
)
def test_with_a_broken_library_one_line_says_so_and_the_page_is_written(
    navigated: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str, said: str
) -> None:
    package = tmp_path / "reportlab"
    package.mkdir()
    (package / "__init__.py").touch()
    kind, _, text = said.partition(": ")
    (package / broken).write_text(f"raise {kind}({text!r})\n", encoding="utf-8")
    for name in [name for name in sys.modules if name.partition(".")[0] == "reportlab"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    (navigated.products / REPORT).unlink(missing_ok=True)
    (navigated.products / PDF).unlink(missing_ok=True)
    done = georef("report", "--pdf", "--force", "--project", navigated.folder)
    # not put back at the end, as `delitem` would
    sys.modules.pop("reportlab", None)
    assert done.code == 2, done.text
    done.line("pdf: a PDF needs reportlab", said, "--force-reinstall", "report.html is written")
    assert "bug in georef" not in done.text
    assert (navigated.products / REPORT).is_file()
    assert not (navigated.products / PDF).exists()
    assert navigated.litter() == []
