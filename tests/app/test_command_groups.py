"""Tools whose command has two words: `georef sync-board record`."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
from click.testing import CliRunner, Result

from georef_gis.app import cli
from georef_gis.errors import PluginError
from georef_gis.toolbox import Algorithm, Context, Feedback, parameters
from georef_gis.toolbox import Result as ToolResult
from georef_gis.toolbox.registry import Registry


class LampParameters(parameters.Parameters):
    colour: parameters.Text = parameters.text(title="Colour", positional=True)


def lamp(tool_id: str, words: tuple[str, ...]) -> type[Algorithm[LampParameters]]:
    class Made(Algorithm[LampParameters]):
        """Light the lamp.

        Long text.
        """

        id, name, group, command = tool_id, "Lamp", "ingest", words
        needs_project = False

        def run(
            self, context: Context, parameters: LampParameters, feedback: Feedback
        ) -> ToolResult:
            return ToolResult(summary={"lit": f"{tool_id} {parameters.colour}"})

    return Made


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Registry]:
    def make(*tools: tuple[str, str, tuple[str, ...]]) -> Registry:
        registry = Registry()
        for provider, tool_id, words in tools:
            registry.add(provider, (lamp(tool_id, words),), provider, "1")
        assert registry.refused == []
        monkeypatch.setattr(cli, "_registry", lambda: registry)
        return registry

    return make


def call(*words: str) -> Result:
    return CliRunner().invoke(cli.georef, list(words))


LAMPS = (
    ("georef", "lamp_light", ("lamp", "light")),
    ("georef", "lamp_dim", ("lamp", "dim")),
    ("georef", "look", ()),
)


def test_tool_is_called_by_its_two_words_and_by_its_id(register) -> None:
    register(*LAMPS)
    for words in (("lamp", "light"), ("lamp-light",)):
        done = call(*words, "red")
        assert (done.exit_code, done.stderr) == (0, "")
        assert "lamp_light red" in done.stdout
    assert "look red" in call("look", "red").stdout


def test_help_shows_the_words_of_the_group_and_of_its_tools(register) -> None:
    register(*LAMPS)
    assert "lamp light  Light the lamp" in call("--help").output
    assert "lamp dim " in call("tools").output
    page = call("lamp", "--help").output
    assert "dim    Light the lamp" in page
    assert "light  Light the lamp" in page
    bare = call("lamp")
    assert (bare.exit_code, bare.output) == (0, page)
    assert "Usage: georef lamp light [OPTIONS] COLOUR" in CliRunner().invoke(
        cli.georef, ["lamp", "light", "--help"], prog_name="georef"
    ).output  # fmt: skip


def test_wrong_word_in_a_group_is_one_line(register) -> None:
    register(*LAMPS)
    done = call("lamp", "brighten")
    assert done.exit_code == 2
    assert done.stderr.startswith("georef: No such command 'brighten'")
    assert done.stderr.endswith("; see `georef lamp --help`\n")
    assert done.stderr.count("\n") == 1


def test_words_taken_by_an_earlier_tool_or_a_command_are_not_given_again(register) -> None:
    register(
        *LAMPS,
        ("other", "lamp_too", ("lamp", "light")),
        ("other", "looker", ("look", "at")),
        ("other", "runner", ("run", "away")),
    )
    assert "lamp_light red" in call("lamp", "light", "red").stdout
    assert "lamp_too red" in call("lamp-too", "red").stdout
    assert "look red" in call("look", "red").stdout
    assert "looker red" in call("looker", "red").stdout
    assert "runner red" in call("runner", "red").stdout


def test_manifest_names_the_words(register) -> None:
    register(*LAMPS)
    tools = json.loads(call("tools", "--json").stdout)["tools"]
    assert [tool.get("command") for tool in tools] == [["lamp", "light"], ["lamp", "dim"], None]


@pytest.mark.parametrize(
    "words", [("lamp",), ("Lamp", "light"), ("lamp", "light", "red"), ("a b", "c")]
)
def test_words_that_are_no_command_are_refused_when_the_tool_is_declared(words) -> None:
    with pytest.raises(PluginError, match="give two lower-case words, or none"):
        lamp("lamp_light", words)
