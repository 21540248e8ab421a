# SPDX-License-Identifier: GPL-2.0-or-later
# mypy: disable-error-code="import-not-found, misc"
"""Layers shown at the end of a run: styled, rasters below, points above."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsProcessingContext,
    QgsProcessingLayerPostProcessorInterface,
    QgsProviderRegistry,
)

from . import compat
from .products import HIDDEN, PACKS, LayerFile, layers_in

STYLES = Path(__file__).parent / "styles"
RANK = "georef/rank"
# QGIS takes no part in owning them, and calls them when the algorithm is gone.
_KEPT: dict[str, LayerDresser] = {}


class LayerDresser(QgsProcessingLayerPostProcessorInterface):
    """Gives a layer its style and its place among the others when QGIS has loaded it."""

    def __init__(self, layer_file: LayerFile) -> None:
        super().__init__()
        self.file = layer_file

    def postProcessLayer(self, layer: Any, context: Any, feedback: Any) -> None:
        """Style the layer and put it into its place."""
        layer.setName(self.file.title)
        layer.setCustomProperty(RANK, self.file.rank)
        if self.file.crs:
            layer.setCrs(QgsCoordinateReferenceSystem(self.file.crs))
        style = STYLES / f"{self.file.style}.qml"
        if _brings_style(layer):
            layer.loadDefaultStyle()
        elif self.file.style and style.is_file():
            layer.loadNamedStyle(str(style))
        layer.triggerRepaint()
        project = context.project()
        if project is not None:
            _place(project.layerTreeRoot(), layer, self.file.source.endswith(HIDDEN))


def show_on_completion(
    files: Iterable[Path], project: Path | None, context: Any, titles: Mapping[Path, str]
) -> None:
    """Let QGIS load the layers of files when the algorithm is done; some files have a title."""
    for path in files:
        for found in _parts(path, layers_in(path, project)):
            if found.title == path.stem:
                found = replace(found, title=titles.get(path, found.title))
            hint = compat.RASTER_HINT if found.raster else compat.VECTOR_HINT
            details = QgsProcessingContext.LayerDetails(
                found.title, context.project(), found.title, hint
            )
            details.forceName = True
            _KEPT[found.source] = LayerDresser(found)
            details.setPostProcessor(_KEPT[found.source])
            context.addLayerToLoadOnCompletion(found.source, details)


def _parts(path: Path, layers: list[LayerFile]) -> list[LayerFile]:
    """Layers of a file; those of a KML and its like only QGIS itself can tell."""
    if path.suffix.lower() not in PACKS or not layers:
        return layers
    parts = QgsProviderRegistry.instance().querySublayers(str(path))
    return [
        replace(layers[0], source=part.uri(), title=f"{path.stem} {part.name()}") for part in parts
    ] or layers


def _brings_style(layer: Any) -> bool:
    """Whether the file holds a style of this layer, which QGIS has taken already."""
    if ".gpkg|" not in layer.source():
        return Path(layer.source().partition("|")[0]).with_suffix(".qml").is_file()
    found = layer.listStylesInDatabase()
    return bool(found and found[0] and found[0] > 0)


def _place(root: Any, layer: Any, hidden: bool) -> None:
    """Move a new layer below those of ours that belong above it."""
    node = root.findLayer(layer.id())
    if node is None:
        return
    # The legend of the assets has a line for every class there is.
    node.setExpanded(False)
    if hidden:
        node.setItemVisibilityChecked(False)
    parent = node.parent()
    others = [child for child in parent.children() if child is not node]
    rank, index = _rank(layer), 0
    for number, other in enumerate(others):
        own = getattr(other, "layer", lambda: None)()
        if own is not None and _rank(own) > rank:
            index = number + 1
    here = parent.children().index(node)
    if here == index:
        return
    parent.insertChildNode(index + 1 if here < index else index, node.clone())
    parent.removeChildNode(node)


def _rank(layer: Any) -> int:
    rank = layer.customProperty(RANK)
    return -1 if rank is None else int(rank)
