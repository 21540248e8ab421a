"""An asset: what it is, where it is, and how far to trust that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from georef_gis.errors import InputError
from georef_gis.measure.assets.domain import Shape

# Easting and northing in CRS units, height in m above the ellipsoid (NaN = not known)
Vertex = tuple[float, float, float]
FEWEST: Mapping[Shape, int] = {"point": 1, "line": 2, "polygon": 3}
MOST_VERTICES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Click:
    """A pixel that shows a vertex of an asset; (0, 0) = centre of the first pixel.

    Parameters
    ----------
    vertex
        Counted from 0.
    sigma_px
        One sigma of the click, px; None = as the tool that measures takes it.
    shared_px
        What clicks that were matched from one another err by alike, see `Mark`, px.
    on_ground
        Whether the spot is said to lie on the ground.
    """

    photo_id: str
    u: float
    v: float
    vertex: int = 0
    sigma_px: float | None = None
    shared_px: float = 0.0
    on_ground: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """How far to trust a measured place; of a line or an area at its worst vertex.

    Parameters
    ----------
    sigma_e, sigma_n, sigma_u
        One sigma along grid east, grid north and up, m.
    corr_en
        Correlation of the first two.
    semi_major, semi_minor, azimuth
        Error ellipse that holds the place with probability `conf`; m, m, degrees clockwise from
        grid north.
    dof
        Degrees of freedom of the adjustment of the point; 0 from one photo.
    method
        "locate", "intersect", "intersect_ground" (rays and the ground), or "edited" where a place
        was drawn or moved by hand.
    """

    sigma_e: float | None = None
    sigma_n: float | None = None
    sigma_u: float | None = None
    corr_en: float | None = None
    semi_major: float | None = None
    semi_minor: float | None = None
    azimuth: float | None = None
    conf: float | None = None
    dof: int | None = None
    n_rays: int | None = None
    method: str = ""
    clicks: tuple[Click, ...] = ()

    def __post_init__(self) -> None:
        """Check what a false statement of accuracy would come from."""
        sigmas = (self.sigma_e, self.sigma_n, self.sigma_u, self.semi_major, self.semi_minor)
        if any(s is not None and not (math.isfinite(s) and s >= 0) for s in sigmas):
            raise ValueError(f"sigmas and semi axes {sigmas} m: must be finite and not negative")
        if self.corr_en is not None and not -1.0 <= self.corr_en <= 1.0:
            raise ValueError(f"corr_en {self.corr_en}: must lie between -1 and 1")
        if self.conf is not None and not 0.0 < self.conf < 1.0:
            raise ValueError(f"conf {self.conf}: must lie between 0 and 1")

    @property
    def photo_ids(self) -> tuple[str, ...]:
        """Photos of the clicks, each once, in their order."""
        return tuple(dict.fromkeys(click.photo_id for click in self.clicks))


# Of a place that was drawn or moved by hand: what was measured does not hold for it.
EDITED = Quality(method="edited")


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """What is asked to be stored as an asset.

    Parameters
    ----------
    kind
        Name of its class.
    vertices : (easting, northing in CRS units, ellipsoidal height m or NaN)
        One for a point; of a polygon the ring, open or closed.
    attributes
        By name, as the class has them.
    """

    kind: str
    vertices: tuple[Vertex, ...]
    name: str = ""
    note: str = ""
    attributes: Mapping[str, object] = field(default_factory=dict)
    quality: Quality | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Asset:
    """An asset as the store holds it.

    Parameters
    ----------
    revision
        Rises with every change; a change must name the one it was made from.
    created, changed
        UTC, ISO 8601.
    problems
        What does not fit its class, a line each; of rows that were edited in a GIS.
    """

    id: str
    kind: str
    shape: Shape
    vertices: tuple[Vertex, ...]
    name: str = ""
    note: str = ""
    attributes: Mapping[str, object] = field(default_factory=dict)
    quality: Quality | None = None
    revision: int = 1
    created: str = ""
    changed: str = ""
    problems: tuple[str, ...] = ()


class StaleAssetError(InputError):
    """A change was made from an older state of the asset.

    Parameters
    ----------
    current
        The asset as it is now; None if it was deleted.
    """

    def __init__(self, message: str, *, source: str, current: Asset | None) -> None:
        super().__init__(message, source=source, field="revision")
        self.current = current


def checked_vertices(shape: Shape, vertices: object, *, source: str) -> tuple[Vertex, ...]:
    """Vertices as numbers, a ring open, enough of them for the shape.

    Raises
    ------
    InputError
        If they are not.
    """
    try:
        out = tuple(_vertex(one) for one in vertices)  # type: ignore[attr-defined]
    except (TypeError, ValueError) as error:
        raise InputError(f"a vertex is no (easting, northing[, height]) of finite numbers: {error}",
                         source=source, field="vertices") from error  # fmt: skip
    if shape == "polygon" and len(out) > 1 and out[0][:2] == out[-1][:2]:
        out = out[:-1]
    fewest = FEWEST[shape]
    if len(out) < fewest or (shape == "point" and len(out) > 1):
        wanted = "1" if shape == "point" else f"{fewest} or more"
        raise InputError(f"{len(out)} vertices; a {shape} has {wanted}", source=source,
                         field="vertices")  # fmt: skip
    if len(out) > MOST_VERTICES:
        raise InputError(f"{len(out)} vertices, more than {MOST_VERTICES}; simplify it",
                         source=source, field="vertices")  # fmt: skip
    return out


def _vertex(given: object) -> Vertex:
    numbers = [float(x) for x in given]  # type: ignore[attr-defined]
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers[:2])):
        raise ValueError(f"{numbers}")
    height = numbers[2] if len(numbers) == 3 else math.nan
    if math.isinf(height):
        raise ValueError(f"{numbers}")
    return numbers[0], numbers[1], height
