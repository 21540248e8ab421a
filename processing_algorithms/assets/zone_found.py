"""The assets that a work zone's settings name, with their places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from georef_gis.measure.assets.asset import Asset
from georef_gis.measure.workzone.geometry import Measured
from processing_algorithms.assets.asset_places import JointPlaces

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoneAssets:
    """Assets of a zone with their places.

    Parameters
    ----------
    lines
        Devices by line, in the order of the row.
    directed
        Lines whose first device is known to be the first that drivers meet.
    by_order
        Those of them that the attribute `order` of their devices tells.
    signs
        By line.
    edges
        Lines by the name of their asset.
    """

    frame: MapFrame
    places: JointPlaces
    measured: Measured
    lines: dict[str, tuple[Asset, ...]]
    directed: frozenset[str]
    by_order: frozenset[str]
    signs: dict[str, tuple[Asset, ...]]
    edges: dict[str, Asset]

    def devices(self, line: str) -> tuple[int, ...]:
        """Indices of the devices of a line."""
        return tuple(self.places.indices[asset.id][0] for asset in self.lines[line])

    def edge(self, name: str) -> tuple[int, ...]:
        """Indices of the vertices of an edge; none for no name."""
        return self.places.indices[self.edges[name].id] if name else ()
