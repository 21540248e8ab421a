"""Heights and what they are measured from: ellipsoid, geoid, ground."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from georef_gis.errors import CrsError
from georef_gis.geodesy.geoids import geoid_undulation


class HeightKind(StrEnum):
    """What a height is measured from."""

    ELLIPSOIDAL = "ellipsoidal"
    ORTHOMETRIC = "orthometric"
    ABOVE_GROUND = "above_ground"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Height:
    """A height and what it is measured from, m."""

    value: float
    kind: HeightKind
    geoid: str = "egm96"

    def ellipsoidal(self, lat: float, lon: float) -> float:
        """Height above the WGS 84 ellipsoid at a place (rad), m.

        Raises
        ------
        CrsError
            If the kind cannot be turned into an ellipsoidal height.
        """
        if self.kind is HeightKind.ELLIPSOIDAL:
            return self.value
        if self.kind is HeightKind.ORTHOMETRIC:
            return self.value + float(geoid_undulation(lat, lon, geoid=self.geoid))
        raise CrsError(
            f"a height of {self.value:.2f} m of kind '{self.kind}' has no ellipsoidal value; "
            "state its kind (ellipsoidal or orthometric)",
            field="height",
        )
