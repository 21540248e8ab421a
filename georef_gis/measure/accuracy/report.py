"""What the accuracy statement tells of: assessments of a site, its survey, its mosaic's seams."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.accuracy.checks import (
    Distribution,
    Extent,
    Flag,
    distance_to_control,
    distribution,
    flags_of,
    placement_flags,
)
from georef_gis.measure.accuracy.product import Assessment

# px per RMSE_H that seams of a mosaic may mismatch (7.3)
SEAM = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """What is known of the check points' survey and of the site.

    Parameters
    ----------
    datum, product_datum
        Realisation and epoch, as `NAD83(2011)@2010.0` or "unknown".
    heights
        Kind of the surveyed heights and geoid, in words.
    crs
        CRS in which residuals are east and north, in words.
    control_map : shape (k, 2), m
        Places of the control points used in processing.
    extent
        Of the site on the map, m; None = not known.
    """

    datum: str = "unknown"
    product_datum: str = "unknown"
    heights: str = "unknown"
    crs: str = "unknown"
    control_names: tuple[str, ...] = ()
    control_map: Array = field(default_factory=lambda: np.zeros((0, 2)))
    extent: Extent | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamFinding:
    """How far photos lie apart at the mosaic's seams, m, at places where that could be told."""

    places: int
    accepted: int
    median: float
    p90: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccuracyReport:
    """Assessments of one site with what the statement has to tell of their making.

    `untested` names check points that could not be read, with the reason. `distances` are lengths
    on the map and one sigma of a distance of that length by the adjustment, m. `seams` is what was
    measured of the mosaic's.
    """

    title: str
    assessments: tuple[Assessment, ...]
    survey: Survey = field(default_factory=Survey)
    untested: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    distances: tuple[tuple[float, float], ...] = ()
    seams: SeamFinding | None = None

    @property
    def main(self) -> Assessment:
        """Assessment that the statement is about: of the products, else of a table."""
        return next((a for a in self.assessments if a.kind != "intersections"), self.assessments[0])

    @property
    def places(self) -> Array:
        """Places of the check points on the map, m; (n, 2), nan where one is not known."""
        return np.array([[r.x, r.y] for r in self.main.residuals]).reshape(-1, 2)

    @property
    def spread(self) -> Distribution | None:
        """How the check points lie in the site; None where that is not known."""
        return distribution(self.places, self.survey.extent)

    @property
    def nearest_control(self) -> float:
        """Least distance of a check point to a control point, m; inf where there is none."""
        xy = self.places
        away = distance_to_control(xy[np.all(np.isfinite(xy), axis=1)], self.survey.control_map)
        return float(np.min(away, initial=math.inf))

    @property
    def seam_limit(self) -> float | None:
        """Twice the horizontal class, m; None where there is none."""
        class_m = self.main.component("H").class_m
        return None if class_m is None else SEAM * class_m

    @property
    def seams_meet(self) -> bool | None:
        """Whether nine of ten places lie within the limit; None where one is not known."""
        limit = self.seam_limit
        return None if limit is None or self.seams is None else self.seams.p90 <= limit


def report_flags(report: AccuracyReport) -> dict[str, list[Flag]]:
    """What is to be investigated or known, by kind of assessment and of the survey."""
    out: dict[str, list[Flag]] = {a.kind: flags_of(a) for a in report.assessments}
    survey = report.survey
    general = placement_flags(report.main.residuals, survey.control_map, survey.extent)
    if report.main.residuals:
        for name, datum in (("check points", survey.datum), ("products", survey.product_datum)):
            if datum == "unknown":
                text = f"datum and epoch of the {name} are not stated, which may hide metres"
                general.append(Flag(code="datum_unknown", text=text))
    if report.untested:
        told = "; ".join(f"{name} ({why})" for name, why in report.untested.items())
        general.append(Flag(code="untested", text=f"check points not read are {told}"))
    return {**out, "survey": general}
