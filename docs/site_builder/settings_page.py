"""The page of ``project.toml``, made from the settings that the program reads."""

from __future__ import annotations

import inspect
from typing import Any

from georef_gis.project.sections import Section
from georef_gis.project.settings import Settings
from site_builder.texts import cells, markdown, table

INTRODUCTION = (
    "# project.toml\n\nWhat you say of a project; `georef init` writes it with every key. All keys "
    "may be left out, an unknown one is refused. Paths are relative to the file. Sigmas are one "
    "standard deviation. A change makes those steps stale that read its section, and no others."
)


def settings_page() -> str:
    """Markdown of all sections with their keys."""
    parts = [INTRODUCTION]
    for name, field in Settings.model_fields.items():
        model = field.annotation
        if isinstance(model, type) and issubclass(model, Section):
            parts.append(_section(name, model))
    parts.append(
        '## [cameras."MODEL"]\n\nThe keys of `[camera]`, for one camera only: by the model\'s name '
        "in the photos' tags.\n\n## [tools.TOOL]\n\nParameters of one step; the page of the tool "
        "names them, with `_` for `-`. How values are written: [](values.md)."
    )
    return "\n\n".join(parts) + "\n"


def _section(name: str, model: type[Section]) -> str:
    rows = [
        cells(f"`{key}`", _shown(field.get_default(call_default_factory=True)),
              markdown(field.description or ""))
        for key, field in model.model_fields.items()
    ]  # fmt: skip
    told = markdown(inspect.cleandoc(model.__doc__ or ""))
    return f"## [{name}]\n\n{told}\n\n{table(('Key', 'Default', 'Meaning'), rows)}"


def _shown(value: Any) -> str:
    """Default as it is written in TOML; empty for none."""
    if value is None or value == {}:
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple | list):
        return "`[" + ", ".join(_shown(item).strip("`") for item in value) + "]`"
    return f"`{value}`" if isinstance(value, int | float) else f'`"{value}"`'
