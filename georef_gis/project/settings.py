"""project.toml: what the user says. Every key is optional."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, Field, ValidationError

from georef_gis.errors import InputError
from georef_gis.project.sections import (
    AttitudeSection,
    CameraSection,
    ControlSection,
    GnssSection,
    GroundSection,
    ImuSection,
    LogsSection,
    MetadataSection,
    MountSection,
    PhotosSection,
    PosesSection,
    ProductsSection,
    ProjectSection,
    Section,
)


class Settings(Section):
    """All of project.toml."""

    project: ProjectSection = ProjectSection()
    photos: PhotosSection = PhotosSection()
    camera: CameraSection = CameraSection()
    cameras: dict[str, CameraSection] = Field(default_factory=dict)
    mount: MountSection = MountSection()
    gnss: GnssSection = GnssSection()
    attitude: AttitudeSection = AttitudeSection()
    ground: GroundSection = GroundSection()
    poses: PosesSection = PosesSection()
    control: ControlSection = ControlSection()
    logs: LogsSection = LogsSection()
    imu: ImuSection = ImuSection()
    products: ProductsSection = ProductsSection()
    metadata: MetadataSection = MetadataSection()
    tools: dict[str, dict[str, Any]] = Field(default_factory=dict)

    def camera_of(self, *names: str) -> CameraSection:
        """Camera settings for the first of the names that has a table of its own.

        What [cameras."NAME"] leaves out is taken from [camera].
        """
        for name in names:
            if name in self.cameras:
                own = self.cameras[name].model_dump(exclude_unset=True)
                return CameraSection(**(self.camera.model_dump(exclude_unset=True) | own))
        return self.camera

    def section(self, name: str) -> dict[str, Any]:
        """JSON-able values of one section, for fingerprints and records."""
        value = getattr(self, name)
        if isinstance(value, BaseModel):
            return value.model_dump(mode="json")
        return {key: item.model_dump(mode="json") for key, item in value.items()}


SECTIONS = tuple(name for name in Settings.model_fields if name != "tools")


def read_settings(path: Path) -> Settings:
    """Settings of a project.toml.

    Raises
    ------
    InputError
        Unreadable, not TOML, an unknown key or an unfit value; one line on the first.
    """
    try:
        with path.open("rb") as stream:
            settings = Settings.model_validate(tomllib.load(stream))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", source=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"is not valid TOML: {error}", source=str(path)) from error
    except ValidationError as error:
        raise _settings_error(error, path) from error
    if settings.project.grids is not None:
        # Before anything is transformed here or in a process that is started from here.
        from georef_gis.geodesy import use_grids

        use_grids(path.absolute().parent / settings.project.grids.expanduser())
    return settings


def _settings_error(error: ValidationError, path: Path) -> InputError:
    problems = error.errors(include_url=False)
    first = problems[0]
    location = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        message = f"unknown key{_nearest(location)}"
    else:
        field = _description(location)
        cure = f" ({field})" if field else ""
        message = f"{first['input']!r}: {first['msg'].lower()}{cure}"
    if len(problems) > 1:
        message += f" (and {len(problems) - 1} more)"
    return InputError(message, source=str(path), field=".".join(location))


def _model_at(location: list[str]) -> type[BaseModel] | None:
    """Model that holds the last key of a location."""
    if len(location) == 1:
        return Settings
    field = Settings.model_fields.get(location[0])
    for part in (field.annotation, *get_args(field.annotation)) if field else ():
        if isinstance(part, type) and issubclass(part, Section):
            return part
    return None


def _nearest(location: list[str]) -> str:
    from difflib import get_close_matches

    model = _model_at(location)
    if model is None:
        return ""
    here = {key: key for key in model.model_fields}
    everywhere = {
        key: f"{name}.{key}"
        for name in SECTIONS
        for key in (getattr(_model_at([name, ""]), "model_fields", None) or ())
    }
    for keys in (here, everywhere):
        close = get_close_matches(location[-1], list(keys), n=1, cutoff=0.6)
        if close:
            return f"; did you mean {keys[close[0]]}?"
    return f"; valid keys: {', '.join(here)}"


def _description(location: list[str]) -> str:
    model = _model_at(location[:2])
    field = model.model_fields.get(location[1]) if model and len(location) > 1 else None
    return (field.description or "") if field else ""
