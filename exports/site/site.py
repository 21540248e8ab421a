"""All that a project has to export, gathered once as plain values; files come from these alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from exports.site.schemas import ASSETS
from exports.site.values import SitePhoto, SiteValues
from georef_gis.errors import ExportError

if TYPE_CHECKING:
    from exports.site.columns import Layer
    from georef_gis.model.tie_points import GroundPoints, TiePoints
    from georef_gis.project import Project

__all__ = ["HEIGHTS", "LAYERS", "SiteLayers", "SitePhoto"]

LAYERS = ("photos", "footprints", "track", "cameras", "control", "tie_points", *ASSETS)
HEIGHTS = "ellipsoidal and orthometric (EGM96)"


class SiteLayers(SiteValues):
    """A site's values, and the layers made of them."""

    @classmethod
    def from_project(cls, project: Project, *, best: bool = False) -> SiteLayers:
        """What a project's database and products hold.

        The pose of a photo is that of its footprint; with `best` the best that there is.

        Raises
        ------
        ExportError
            If it has no photos yet.
        """
        from exports.site.assets import what_is_lost
        from exports.site.reader import read_site

        site = cls(**read_site(project, best=best))
        return replace(site, warnings=(*site.warnings, *what_is_lost(site.assets)))

    @cached_property
    def layers(self) -> Mapping[str, Layer]:
        """Layers by name, those of `LAYERS` but tie points, which are many."""
        from exports.site.adjusted import control_layer
        from exports.site.assets import asset_layers
        from exports.site.build import build_layers

        return {**build_layers(self), "control": control_layer(self), **asset_layers(self)}

    @cached_property
    def tie_points(self) -> Layer:
        """Ground points of the adjustment; empty without one.

        Raises
        ------
        ExportError
            If the adjustment's file cannot be read.
        """
        from exports.site.adjusted import tie_points_layer

        return tie_points_layer(self)

    def tracks(self) -> tuple[TiePoints, GroundPoints] | tuple[None, None]:
        """Observations and points of the adjustment that most poses are from; None without one.

        Raises
        ------
        ExportError
            If its files cannot be read.
        """
        if self.adjustment is None:
            return None, None
        from exports.site.adjustment import read_tracks

        return read_tracks(self, self.adjustment)

    def why_empty(self, names: Sequence[str]) -> str:
        """What to say where none of some layers has a feature."""
        text = f"nothing to write: {', '.join(names)} have no features yet"
        if "tie_points" in names and self.adjustment is None:
            return f"{text}: the poses are not adjusted; run `georef run`"
        if "control" in names and not self.control:
            return f"{text}: the project has no control points; name a file in [control]"
        if set(names) <= set(ASSETS):
            return f"{text}: no assets are mapped; `georef assets --clicks` or `georef serve`"
        return text

    @staticmethod
    def names_of(layer: str) -> tuple[str, ...]:
        """Layers that one of the toolbox stands for: `assets` are four, others themselves."""
        return ASSETS if layer == "assets" else (layer,)

    def layer(self, name: str) -> Layer:
        """One layer by its name here or in the toolbox (`poses` are the photos').

        Raises
        ------
        ExportError
            If it is none of `LAYERS`.
        """
        name = "photos" if name == "poses" else name
        if name == "tie_points":
            return self.tie_points
        if name not in self.layers:
            raise ExportError(
                f"layer {name!r} cannot be exported: only the project's own layers are, not files "
                "of others, which QGIS or ogr2ogr convert; use one of site, photos, poses, "
                "footprints, control, tie_points, assets"
            )
        return self.layers[name]
