"""The site is built without a warning, leads nowhere wrong, and asks no other host."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from georef_gis.toolbox.registry import Tool, load_registry

for name in ("sphinx", "furo", "myst_parser"):
    pytest.importorskip(name, reason='the site needs pip install "georef-gis[docs]"')

# MyST-Parser calls what Sphinx 11 will take away.
pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::PendingDeprecationWarning"
)
ROOT = Path(__file__).resolve().parents[2]
TOOLS = list(load_registry())
# Furo's line at the foot of a page; whoever adds a link to another host adds it here.
OUTSIDE = {"https://github.com/pradyunsg/furo"}
# Chapters that are placed before they are written; the build leaves them out and says so.
AWAITED: set[str] = set()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished site; any warning of the build is an error."""
    from build_site import build

    target = tmp_path_factory.mktemp("docs") / "site"
    build(target)
    return target / "html"


def page_of(site: Path, tool: Tool) -> str:
    from site_builder.tool_pages import page_name

    from georef_gis.app.cli import command_words

    return (site / f"tools/{page_name(command_words(tool))}.html").read_text("utf-8")


@pytest.mark.slow
def test_links_anchors_and_pictures_of_the_site_are_there(site: Path) -> None:
    from site_builder.checks import broken_links, read_site

    assert len(read_site(site)) > len(TOOLS) + 25
    assert broken_links(site) == []


def test_no_page_makes_a_browser_fetch_from_another_host(site: Path) -> None:
    from site_builder.checks import fetched_from_outside, outside_links

    assert fetched_from_outside(site) == []
    assert outside_links(site) <= OUTSIDE


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.id)
def test_a_tool_has_a_page_with_all_of_its_parameters(site: Path, tool: Tool) -> None:
    page = page_of(site, tool)
    told = tool.algorithm.manifest()
    index = (site / "tools/index.html").read_text("utf-8")
    for given in told["parameters"]:
        name = given["name"].upper() if given.get("positional") else f"--{given['name']}"
        assert f">{name.replace('_', '-') if name.startswith('--') else name}<" in page, name
    assert all(f">{output['name']}<" in page for output in told["outputs"])
    assert ">Example" in page
    assert "Explained in" in page
    assert tool.id.replace("_", "-") in index or tool.algorithm.command[1] in index


def test_examples_of_all_tool_pages_can_be_typed(site: Path) -> None:
    from site_builder.command_lines import command_lines, problem

    pages = sorted((site.parent / "source/tools").glob("*.md"))
    tried = 0
    for path in pages:
        for line in command_lines(path.read_text("utf-8")):
            tried += line.whole
            assert problem(line) == "", (path.name, line.text)
    assert tried >= len(TOOLS)


def test_every_example_of_ours_is_shown(site: Path) -> None:
    """One that a chapter's own example has taken the place of is to be removed."""
    from site_builder.examples import LINES

    pages = "".join(path.read_text("utf-8") for path in (site.parent / "source/tools").glob("*.md"))
    pages = pages.replace(" \\\n   ", "")
    assert [line for line in LINES if line not in pages] == []


def test_a_page_tells_limits_choices_defaults_and_units() -> None:
    from site_builder.tool_pages import parameter_row

    row = parameter_row(
        {
            "name": "largest_tilt", "type": "Angle", "title": "Largest tilt",
            "help": "Of a <photo>.", "required": False, "default": 30.0, "unit": "deg",
            "minimum": 0, "maximum": 80,
            "multiple": True,
        }
    )  # fmt: skip
    assert row == (
        "| `--largest-tilt` | [angle](../values.md#angle) in deg, 0 to 80, may be given again "
        "| `30` deg | Largest tilt. Of a \\<photo\\>. |"
    )
    row = parameter_row(
        {"name": "of", "type": "Choice", "title": "Which", "required": True, "positional": True,
         "choices": ["a", "b|c"], "default": None}
    )  # fmt: skip
    assert row == "| `OF` | [choice](../values.md#choice), `a`, `b\\|c` | required | Which. |"


def test_chapters_named_in_help_texts_become_links(site: Path) -> None:
    from site_builder.texts import markdown

    assert markdown("see docs/frames.md, <b>") == "see `frames.md`, \\<b\\>"
    assert markdown("see `docs/frames.md`") == "see `docs/frames.md`"
    told = re.findall(r"<td>[^<]*docs/\w+\.md", (site / "settings.html").read_text("utf-8"))
    assert told == []


def test_every_kind_of_value_is_explained() -> None:
    from site_builder.tool_pages import TYPES

    from georef_gis.toolbox.specs import KINDS

    headings = (ROOT / "docs/values.md").read_text("utf-8").lower().splitlines()
    assert set(TYPES) == set(KINDS)
    assert [kind for kind in KINDS if f"## {TYPES[kind].lower()}" not in headings] == []


def test_the_order_of_reading_names_no_chapter_that_is_not_written() -> None:
    from site_builder.chapters import MADE, ordered, written

    assert set(ordered()) - {*MADE, *written(ROOT)} <= AWAITED


def test_every_chapter_has_a_place_in_the_order_of_reading() -> None:
    """A new chapter goes into docs/site_builder/chapters.py."""
    from site_builder.chapters import ordered

    chapters = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert chapters - set(ordered()) == set()
    assert len(ordered()) == len(set(ordered()))


def test_every_chapter_that_a_text_names_as_code_is_there() -> None:
    """Such names become links; one that is no chapter any more would stay as plain code."""
    from site_builder.chapters import written
    from site_builder.links import chapter_of

    chapters = written(ROOT)
    assert chapter_of("benchmarks/README.md") == "benchmarks"
    assert chapter_of("docs/measure.md") == "measure"
    assert chapter_of("tools.json") == ""
    named = [
        (path.name, name)
        for path in chapters.values()
        for name in re.findall(r"`([\w/.-]+\.md)`", path.read_text("utf-8"))
    ]
    assert len(named) > 50
    assert [one for one in named if chapter_of(one[1]) not in chapters] == []


def test_every_picture_is_shown_and_small() -> None:
    texts = "".join(
        path.read_text("utf-8")
        for path in [*(ROOT / "docs").glob("*.md"), ROOT / "benchmarks/README.md"]
    )
    folder = ROOT / "docs"
    for picture in (path for path in (folder / "pictures").rglob("*") if path.is_file()):
        name = picture.relative_to(folder).as_posix()
        assert f"{name})" in texts, f"{name} is on no page"
        assert picture.stat().st_size < 500_000, name


def test_a_link_that_leads_nowhere_is_noticed(tmp_path: Path) -> None:
    from site_builder.checks import broken_links, fetched_from_outside, outside_links

    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html#there">x</a><a href="#here">x</a><a href="c.html">x</a>'
        '<a href="b.html#not">x</a><img src="no.png" alt="no"><img src="b.html">'
        '<a href="https://example.org/">x</a><script src="//cdn.example.org/x.js"></script>'
        '<p style="background: url(https://example.org/x.png)">',
        encoding="utf-8",
    )
    (tmp_path / "b.html").write_text('<p id="there">', encoding="utf-8")
    (tmp_path / "s.css").write_text('@import "https://fonts.example.org/x";', encoding="utf-8")
    assert broken_links(tmp_path) == [
        "a.html: a picture without words: b.html",
        "a.html: c.html is not there",
        "a.html: b.html#not has no such place",
        "a.html: no.png is not there",
    ]
    assert outside_links(tmp_path) == {"https://example.org/"}
    assert fetched_from_outside(tmp_path) == [
        "a.html: //cdn.example.org/x.js",
        "a.html: https://example.org/x.png",
        "s.css: https://fonts.example.org/x",
    ]


def test_a_folder_that_holds_other_things_is_not_emptied(tmp_path: Path) -> None:
    from build_site import build

    (tmp_path / "thesis.txt").write_text("ten years", encoding="utf-8")
    with pytest.raises(SystemExit, match="holds other things"):
        build(tmp_path)
    assert (tmp_path / "thesis.txt").read_text("utf-8") == "ten years"


@pytest.fixture(scope="module")
def chrome() -> Iterator[Any]:
    """A Chromium; skipped where there is none."""
    sync = pytest.importorskip("playwright.sync_api", reason="the site is opened with playwright")
    binary = shutil.which("chromium") or shutil.which("google-chrome")
    if binary is None:
        pytest.skip("there is no Chromium")
    with sync.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=binary, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_pages_opened_from_the_disk_without_a_network_are_whole(
    site: Path, chrome: Any, scheme: str, width: int
) -> None:
    context = chrome.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True
    )
    tab, asked, wrong = context.new_page(), [], []
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("console", lambda told: wrong.append(told.text) if told.type == "error" else None)
    for name in ("index", "tools/index", "tools/measure-lines", "frames", "settings", "page"):
        tab.goto((site / f"{name}.html").as_uri())
        # wide tables scroll by themselves
        assert tab.evaluate("document.documentElement.scrollWidth") <= width, name
        assert tab.evaluate("[...document.images].every(i => i.complete && i.naturalWidth)"), name
    assert {url.partition(":")[0] for url in asked} <= {"file", "data"}
    assert wrong == []
    context.close()


@pytest.mark.slow
def test_the_search_finds_a_chapter_from_the_disk(site: Path, chrome: Any) -> None:
    context = chrome.new_context(offline=True)
    tab, wrong = context.new_page(), []
    tab.on("console", lambda told: wrong.append(told.text) if told.type == "error" else None)
    tab.goto((site / "search.html").as_uri() + "?q=undulation+geoid")
    tab.goto((site / "search.html").as_uri() + "?q=orthometric")
    # results are listed one after the other
    tab.get_by_role("link", name="Heights", exact=True).first.wait_for()
    assert tab.locator("#search-results li a").count() > 0
    assert wrong == []
    context.close()


def test_the_command_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import build_site

    monkeypatch.setitem(sys.modules, "sphinx.application", None)
    monkeypatch.setattr(sys, "argv", ["build_site.py", str(tmp_path / "site")])
    with pytest.raises(SystemExit, match=r'needs sphinx.application.*pip install -e "\.\[docs\]"'):
        build_site.main()
