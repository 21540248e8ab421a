"""All that a project has to export, gathered once as plain values; files come from these alone."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

from exports.schemas import Layer
from exports.site_values import SitePhoto, SiteValues
from georef_gis.errors import ExportError

if TYPE_CHECKING:
    from georef_gis.project import Project

__all__ = ["HEIGHTS", "LAYERS", "SiteLayers", "SitePhoto"]

LAYERS = ("photos", "footprints", "track", "cameras")
HEIGHTS = "ellipsoidal and orthometric (EGM96)"


class SiteLayers(SiteValues):
    """A site's values, and the layers made of them."""

    @classmethod
    def from_project(cls, project: Project) -> SiteLayers:
        """What a project's database and products hold.

        Raises
        ------
        ExportError
            If it has no photos yet.
        """
        from exports.site_reader import read_site

        return cls(**read_site(project))

    @cached_property
    def layers(self) -> Mapping[str, Layer]:
        """Layers by name, those of `LAYERS`."""
        from exports.site_layers import build_layers

        return build_layers(self)

    def layer(self, name: str) -> Layer:
        """One layer by its name here or in the toolbox (`poses` are the photos').

        Raises
        ------
        ExportError
            If it is none of `LAYERS`.
        """
        name = "photos" if name == "poses" else name
        if name not in self.layers:
            raise ExportError(
                f"layer {name!r} cannot be exported to this format; use one of {', '.join(LAYERS)}"
            )
        return self.layers[name]
