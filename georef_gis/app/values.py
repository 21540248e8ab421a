"""Parameters of steps as they are typed: ``orthos.gsd=2cm``."""

from __future__ import annotations

from collections.abc import Sequence

from georef_gis.errors import InputError


def step_values(texts: Sequence[str]) -> dict[str, dict[str, str]]:
    """Tool id -> parameter -> value, from texts such as ``orthos.gsd=2cm``.

    Raises
    ------
    InputError
        If a text is not of that form.
    """
    values: dict[str, dict[str, str]] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        tool, dot, parameter = name.rpartition(".")
        if not (equals and dot and tool and parameter):
            raise InputError(f"{text!r} is not of the form ID.NAME=VALUE", field="--set")
        values.setdefault(tool, {})[parameter.replace("-", "_")] = value
    return values
