"""Every command that a text names is one that the program takes."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from site_builder.command_lines import CommandLine, command_lines, problem

from georef_gis.project.settings import Settings
from georef_gis.toolbox.registry import load_registry

ROOT = Path(__file__).resolve().parents[2]
# The changelog tells of commands as they were.
TEXTS = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("README.md"), *ROOT.glob("*/README.md")])
PACKAGES = ("georef_gis", "processing_algorithms", "exports")


def in_block(line: str) -> CommandLine:
    found = command_lines(f"Text.\n\n    {line}\n")
    assert len(found) == 1, line
    return found[0]


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_commands_of_a_text_can_be_typed(path: Path) -> None:
    lines = command_lines(path.read_text("utf-8"))
    wrong = [f"line {line.line}: {line.text}: {told}" for line in lines if (told := problem(line))]
    assert not wrong, "\n".join(wrong)


def test_the_texts_hold_commands_that_are_tried_whole() -> None:
    """Else the test above would pass on texts it cannot read."""
    lines = [line for path in TEXTS for line in command_lines(path.read_text("utf-8"))]
    assert sum(line.whole for line in lines) > 25
    assert len({line.words[0] for line in lines if line.words}) > 40


@pytest.mark.parametrize("tool", list(load_registry()), ids=lambda tool: tool.id)
def test_commands_that_the_help_of_a_tool_names_exist(tool: object) -> None:
    told = tool.algorithm.manifest()  # type: ignore[attr-defined]
    texts = [told["help"], *(given.get("help", "") for given in told["parameters"])]
    wrong = [f"{line.text}: {problem(line)}" for t in texts for line in command_lines(t)
             if problem(line)]  # fmt: skip
    assert not wrong, "\n".join(wrong)


def messages(path: Path) -> Iterator[tuple[int, str]]:
    """Texts of a Python file with their line; what is put in is written ``{}``."""
    tree = ast.parse(path.read_text("utf-8"))
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)
             for part in node.values}  # fmt: skip
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [str(p.value) if isinstance(p, ast.Constant) else "{}" for p in node.values]
            yield node.lineno, "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in inner:
                yield node.lineno, node.value


@pytest.mark.parametrize("package", PACKAGES)
def test_commands_that_messages_of_the_program_name_exist(package: str) -> None:
    wrong, seen = [], 0
    for path in sorted((ROOT / package).rglob("*.py")):
        for line, text in messages(path):
            for found in re.findall(r"`georef ([^`]+)`", text):
                seen += 1
                mention = CommandLine(
                    line=line, words=tuple(found.split()), whole=False, text=found
                )
                if told := problem(mention):
                    wrong.append(f"{path.relative_to(ROOT)}:{line}: georef {found}: {told}")
    assert seen > 0
    assert not wrong, "\n".join(wrong)


def test_keys_of_the_settings_that_a_text_names_exist() -> None:
    wrong, seen = [], 0
    for path in TEXTS:
        for section, key in re.findall(r"`\[([a-z]+)\] (\w+)", path.read_text("utf-8")):
            if section == "tools":
                continue
            seen += 1
            model = Settings.model_fields.get(section)
            keys = getattr(model.annotation, "model_fields", {}) if model else {}
            if key not in keys:
                wrong.append(f"{path.relative_to(ROOT)}: [{section}] {key}")
    assert seen > 20
    assert not wrong, wrong


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("georef measure-lins --pixel 1,2", "no tool 'measure-lins'"),
        ("georef sync-board listen", "no command 'sync-board listen'"),
        ("georef measure-lines --pixels 1,2", "no option --pixels"),
        ("georef run . --resume", "no option --resume"),
        ("georef mosaic --seams best", "'best' is no choice"),
        ("georef mosaic --gsd 5kg", "no length unit 'kg'"),
        ("georef mosaic --gsd 2km", "not allowed"),
        ("georef intersect --click 1", "Missing option '--marks'"),
        ("georef check", "Missing argument 'FOLDER'"),
        ("georef mosaic here.tif", "unexpected extra argument"),
        ("georef run . --only mosaick", "no tool 'mosaick'"),
        ("georef run . --set mosaic.size=2", "has no parameter 'size'"),
        ("georef serve . --port 80", "not in the range"),
        ("cd site && PATH=x .venv/bin/georef run . --nothing | less", "no option --nothing"),
    ],
)
def test_an_outdated_command_is_noticed(line: str, why: str) -> None:
    assert why in problem(in_block(line))


@pytest.mark.parametrize(
    "line",
    [
        "georef run .                 # makes everything that changed",
        "georef run . --set mosaic.gsd=2cm --only mosaic,orthos",
        "georef serve [PROJECT] [--port N] [--no-browser]",
        r".venv\Scripts\georef run sample_project",
        "$ georef mosaic --project . --seams optimised > log.txt",
        "georef TOOL --help",
    ],
)
def test_a_command_that_holds_is_let_through(line: str) -> None:
    assert problem(in_block(line)) == ""


def test_an_outdated_option_in_a_sentence_or_a_synopsis_is_noticed() -> None:
    table = "| a |\n|---|\n| `georef surface [--off ground\\|points]` |\n"
    text = f"Use `georef adjust --fast`.\n\n{table}"
    told = [problem(line) for line in command_lines(text)]
    assert [words.split(" has ")[-1] for words in told] == ["no option --fast", "no option --off"]


def test_a_command_over_several_lines_is_read_as_one() -> None:
    text = "    georef plan-flight --height 90m \\\n      --speed 12\n"
    assert command_lines(text)[0].words == ("plan-flight", "--height", "90m", "--speed", "12")
