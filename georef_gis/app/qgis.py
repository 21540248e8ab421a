"""`georef qgis`: the plug-in for QGIS, put into a profile and taken away again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from georef_gis.app.facing import Face, face_options, facing
from georef_gis.app.feedback import JsonFeedback, PlainFeedback
from georef_gis.app.qgis_profiles import (
    PLUGIN,
    Profile,
    disable,
    enable,
    find_profiles,
    is_enabled,
)
from georef_gis.errors import InputError

BY_HAND = "in QGIS: Plugins > Manage and Install Plugins > Installed, tick georef"


@click.group(
    invoke_without_command=True, short_help="The plug-in for QGIS: install, remove, status."
)
@click.pass_context
def qgis(ctx: click.Context) -> None:
    """Put the tools of georef into the Processing toolbox of QGIS."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def _where(otherwise: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Give the options that say which profile is meant; `otherwise` is that of no options."""
    profile = click.option("--profile", default="", help=f"Name of the profile; else {otherwise}.")
    folder = click.option("--folder", type=click.Path(path_type=Path),
                          help="Folder of plug-ins, instead of a profile.")  # fmt: skip
    return lambda function: profile(folder(function))


def _profiles(profile: str, folder: Path | None) -> list[Profile]:
    if folder is None:
        return find_profiles(profile)
    if profile:
        raise InputError("give --profile or --folder, not both")
    return [Profile(version=0, name="", folder=folder.absolute())]


@qgis.command(short_help="Put the plug-in into a profile.")
@_where("the one that QGIS starts with")
@click.option("--force", is_flag=True, help="Also over files that were changed by hand.")
@face_options
def install(profile: str, folder: Path | None, force: bool, as_json: bool, verbose: int) -> None:
    """Copy the plug-in into the profile of every QGIS found, and switch it on.

    It runs the georef it was installed by. Repeat it after georef moved or was updated.
    """
    with facing(Face(as_json=as_json, verbose=verbose)) as feedback:
        from georef_gis.app.qgis_plugin_files import check_replaceable
        from georef_gis.app.qgis_plugin_files import install as install_plugin
        from georef_gis.toolbox.registry import load_registry

        profiles = _profiles(profile, folder)
        for found in profiles:
            check_replaceable(found, force=force)
        for found in profiles:
            count = install_plugin(found, load_registry(), force=force)
            _say(feedback, f"{found.title()}: {count} tools, in {found.plugins / PLUGIN}")
            _switch_on(found, feedback)
        others = {p.name for p in find_profiles(every=True)} - {p.name for p in profiles}
        if others and not (profile or folder):
            told = ", ".join(sorted(others))
            _say(feedback, f"Not in the other profiles: {told}; --profile NAME puts it there too.")
        _say(feedback, "Start QGIS, again if it is running: Processing > Toolbox > georef.")


def _switch_on(profile: Profile, feedback: PlainFeedback) -> None:
    settings = profile.settings
    if settings is None:
        _say(
            feedback, f"It is to be switched on {BY_HAND}; or: qgis_process plugins enable {PLUGIN}"
        )
        _say(feedback, "A folder outside of a profile is named to QGIS by QGIS_PLUGINPATH.")
        return
    if is_enabled(settings):
        return
    try:
        enable(settings)
        _say(feedback, f"switched on in {settings}")
    except OSError as error:
        feedback.warn(f"{settings}: cannot be written ({error.strerror}); switch it on {BY_HAND}")


@qgis.command(short_help="Take the plug-in away.")
@_where("every one that has it")
@face_options
def remove(profile: str, folder: Path | None, as_json: bool, verbose: int) -> None:
    """Take away what `georef qgis install` put there, and nothing else."""
    with facing(Face(as_json=as_json, verbose=verbose)) as feedback:
        from georef_gis.app.qgis_plugin_files import remove as remove_plugin

        profiles = _profiles(profile, folder) if profile or folder else _with_plug_in()
        for found in profiles:
            left = remove_plugin(found)
            if found.settings is not None:
                disable(found.settings)
            _say(feedback, f"{found.title()}: removed from {found.plugins}")
            if left:
                feedback.warn(f"{found.plugins / PLUGIN}: kept {', '.join(left)}, which georef did "
                              "not install or which was changed since")  # fmt: skip


def _with_plug_in() -> list[Profile]:
    """Profiles that have our plug-in; a foreign one of its name is an error if none has."""
    from georef_gis.app.qgis_plugin_files import find_installed

    there, foreign = [], []
    for found in find_profiles(every=True):
        try:
            if find_installed(found) is not None:
                there.append(found)
        except InputError as error:
            foreign.append(error)
    if there:
        return there
    raise foreign[0] if foreign else InputError("the plug-in is not installed in any profile")


@qgis.command(short_help="Where the plug-in is installed.")
@_where("all")
@face_options
def status(profile: str, folder: Path | None, as_json: bool, verbose: int) -> None:
    """Say where the plug-in is installed, and whether it would run."""
    with facing(Face(as_json=as_json, verbose=verbose)):
        profiles = _profiles(profile, folder) if profile or folder else find_profiles(every=True)
        states = [_state(found) for found in profiles]
        if as_json:
            click.echo(json.dumps(states, indent=1))
            return
        for found, state in zip(profiles, states, strict=True):
            click.echo(f"{found.title()}: {_words(state)}")
        if not profiles:
            click.echo("there is no profile of QGIS; see `georef qgis install --help`")


def profile_states() -> list[tuple[str, str, bool]]:
    """Profiles that have the plug-in: title, state in words, whether it would run."""
    states = [(found, _state(found)) for found in find_profiles(every=True)]
    return [
        (found.title(), _words(state), bool(state.get("works") and state.get("enabled", True)))
        for found, state in states
        if "problem" in state or state["installed"]
    ]


def _state(profile: Profile) -> dict[str, Any]:
    from georef_gis.app.qgis_plugin_files import content, find_installed

    try:
        state = content(profile, find_installed(profile))
    except InputError as error:
        return {"profile": profile.name, "qgis": profile.version, "problem": str(error)}
    if profile.settings is not None:
        state["enabled"] = is_enabled(profile.settings)
    return state


def _words(state: dict[str, Any]) -> str:
    if "problem" in state:
        return str(state["problem"])
    if not state["installed"]:
        return "not installed"
    words = [f"georef {state['version']}, run by {state['python']}"]
    if not state["works"]:
        words.append(f"{state['why_not']}: `georef qgis install` again")
    elif not state["current"]:
        words.append("other than this georef's: `georef qgis install` brings it up to date")
    if not state.get("enabled", True):
        words.append(f"not switched on; {BY_HAND}")
    return ", ".join(words)


def _say(feedback: PlainFeedback, text: str) -> None:
    """A line of the answer, on standard output."""
    if isinstance(feedback, JsonFeedback):
        feedback.info(text)
    else:
        click.echo(text)
