"""A project opened for measuring: what the tools of the command line and the page share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from georef_gis.errors import InputError

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.measure.clicks import OnFail
    from georef_gis.measure.epipolar import Guide
    from georef_gis.measure.lengths import Lengths
    from georef_gis.measure.measured import MeasuredPoints
    from georef_gis.measure.scene import Scene
    from georef_gis.measure.who_sees import Sighting
    from georef_gis.model.control import Mark
    from georef_gis.project import Project
    from georef_gis.rasters.warp import Image, ImageCache
    from processing_algorithms.site import Site


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoWindow:
    """Part of a photo: pixels (rows, cols, bands), and the pixel (u, v) of its first one."""

    pixels: Image
    u: int
    v: int


class MeasureSession:
    """Photos, ground and errors of a project, read once; decoded photos kept within a budget.

    Parameters
    ----------
    site
        Photos with the poses to use, over the ground that goes with them.
    """

    def __init__(self, project: Project, site: Site) -> None:
        self.project, self.site = project, site
        self.scene = scene_of(project, site)

    @classmethod
    def open(cls, project: Project, *, quick: bool = False) -> MeasureSession:
        """Session with the best pose of every photo; with `quick` the tags' own.

        Raises
        ------
        InputError
            If no photo has a pose yet.
        """
        from processing_algorithms.site import load_site

        return cls(project, load_site(project, quick=quick))

    @property
    def frame(self) -> MapFrame:
        """Frame of the map."""
        return self.scene.frame

    @property
    def unit(self) -> float:
        """Metres per unit of the map."""
        return self.site.gsd_unit

    # -- photos --------------------------------------------------------------------------------

    @cached_property
    def _find(self) -> Callable[[str], tuple[str, ...]]:
        from georef_gis.ingest.control_photos import photo_finder

        return photo_finder(self.site.photos)

    def photo_id(self, written: str) -> str:
        """Id of the photo that a person means, by its id, file name or path.

        Raises
        ------
        InputError
            If no photo with a pose is called so, or several are.
        """
        found = self._find(written)
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(
                f"'{written}' may be {' or '.join(found[:3])}; write its folder too", field="photo"
            )
        raise InputError(
            f"no photo with a pose is called '{written}'; the table of photos in "
            "products/report.html lists those that have one",
            field="photo",
        )

    def marks(self, written: Sequence[Mark]) -> list[Mark]:
        """Marks with the ids of the photos that people named.

        Raises
        ------
        InputError
            If a photo is not known.
        """
        found, unknown = self._known(written)
        for error in unknown.values():
            raise error
        return found

    def _known(self, written: Sequence[Mark]) -> tuple[list[Mark], dict[str, InputError]]:
        """Marks with the ids of their photos; of the others one error for each name of a point."""
        ids: dict[str, str | InputError] = {}
        marks: list[Mark] = []
        unknown: dict[str, InputError] = {}
        for mark in written:
            if mark.photo not in ids:
                try:
                    ids[mark.photo] = self.photo_id(mark.photo)
                except InputError as error:
                    ids[mark.photo] = error
            found = ids[mark.photo]
            if isinstance(found, str):
                marks.append(replace(mark, photo=found))
            else:
                unknown.setdefault(mark.name, _at(found, mark.source))
        return marks, unknown

    def _measured(
        self, how: Callable[..., MeasuredPoints], written: Sequence[Mark], on_fail: OnFail
    ) -> MeasuredPoints:
        """Points of marks as people write them; with "skip" also without those of no photo."""
        if on_fail == "raise":
            return how(self.scene, self.marks(written), on_fail=on_fail)
        marks, unknown = self._known(written)
        points = how(self.scene, marks, on_fail=on_fail)
        lost = {name: str(error) for name, error in unknown.items() if name not in points.names}
        doubts = tuple(
            (*lines, f"left out: {unknown[name]}") if name in unknown else lines
            for name, lines in zip(points.names, points.doubts, strict=True)
        )
        return points.with_doubts(doubts).with_refused(points.refused | lost)

    @cached_property
    def _images(self) -> ImageCache:
        from georef_gis.rasters.warp import ImageCache

        return ImageCache()

    def image(self, photo_id: str, *, reduce: int = 1) -> Image:
        """Pixels of a photo as stored, (rows, cols, bands), reduced by 1, 2, 4 or 8; kept.

        Raises
        ------
        GeometryError
            If the photo has no pose.
        InputError
            If its file cannot be read.
        """
        return self._images.get(self.scene.photo(photo_id).photo.path, reduce)

    def window(self, photo_id: str, uv: tuple[float, float], *, half: int) -> PhotoWindow:
        """Square of 2 `half` + 1 pixels about a pixel, cut where the photo ends."""
        image = self.image(photo_id)
        u, v = (round(value) for value in uv)
        left, top = max(u - half, 0), max(v - half, 0)
        pixels = image[top : max(v + half + 1, 0), left : max(u + half + 1, 0)]
        return PhotoWindow(pixels=pixels, u=left, v=top)

    # -- measuring -----------------------------------------------------------------------------

    def locate(self, marks: Sequence[Mark], *, on_fail: OnFail = "raise") -> MeasuredPoints:
        """Ground points that clicks show; `Mark.photo` as people write it."""
        from georef_gis.measure.points import locate_points

        return self._measured(locate_points, marks, on_fail)

    def intersect(self, marks: Sequence[Mark], *, on_fail: OnFail = "raise") -> MeasuredPoints:
        """Points that marks of one name show in several photos."""
        from georef_gis.measure.points import intersect_points

        return self._measured(intersect_points, marks, on_fail)

    def measure(self, marks: Sequence[Mark], *, on_fail: OnFail = "raise") -> MeasuredPoints:
        """Points by all their marks: those in one photo by the ground, the others by their rays.

        The points stand in the order in which their names first appear.
        """
        from georef_gis.measure.points import MeasuredPoints

        named = [replace(m, name=m.name or f"#{i + 1}") for i, m in enumerate(marks)]
        counts: dict[str, int] = {}
        for mark in named:
            counts[mark.name] = counts.get(mark.name, 0) + 1
        alone = [mark for mark in named if counts[mark.name] == 1]
        several = [mark for mark in named if counts[mark.name] > 1]
        parts = []
        if alone or not several:
            parts.append(self.locate(alone, on_fail=on_fail))
        if several:
            parts.append(self.intersect(several, on_fail=on_fail))
        points = MeasuredPoints.joined(*parts)
        order = {name: i for i, name in enumerate(counts)}
        return points.subset(sorted(range(len(points)), key=lambda i: order[points.names[i]]))

    def lines(self, points: MeasuredPoints, *, closed: bool = False) -> Lengths:
        """Lengths along points; with `closed` a ring and its area."""
        from georef_gis.measure.lengths import measure_lines

        return measure_lines(points, closed=closed)

    def who_sees(
        self,
        x: float,
        y: float,
        height: float | None = None,
        *,
        surveyed: bool = False,
        sigma_h: float = 0.0,
        sigma_v: float = 0.0,
        best: int | None = None,
    ) -> list[Sighting]:
        """Photos that show a position of the map, best first.

        Parameters
        ----------
        x, y
            In units of the map.
        height : m
            Above the ellipsoid; without it that of the ground.
        surveyed
            The place knows nothing of the photos' errors; else it was read off the mosaic or
            another product of this project, which errs as they do.
        sigma_h, sigma_v : m
            One sigma of a surveyed place.
        """
        from georef_gis.measure.who_sees import place_on_map, who_sees, who_sees_on_mosaic

        if not surveyed and height is None:
            return who_sees_on_mosaic(self.scene, [x, y], best=best)
        place = place_on_map(self.scene, [x, y], height=height, sigma_h=sigma_h, sigma_v=sigma_v)
        return who_sees(self.scene, *place, best=best)

    def guide(self, mark: Mark, photo_ids: Sequence[str] | None = None) -> list[Guide]:
        """Lines in other photos on which what was clicked lies."""
        from georef_gis.measure.epipolar import guide_lines

        others = None if photo_ids is None else [self.photo_id(key) for key in photo_ids]
        (own,) = self.marks([mark])
        return guide_lines(self.scene, own, others)

    # -- results -------------------------------------------------------------------------------

    def rows(self, points: MeasuredPoints, *, conf: float | None = None) -> list[dict[str, Any]]:
        """Table of points, see `point_table.point_rows`."""
        from processing_algorithms.measure.point_table import point_rows

        return point_rows(points, conf=conf)


def _at(error: InputError, source: str) -> InputError:
    """Error of a place in a file, where there is one."""
    return InputError(str(error), source=source) if source else error


def scene_of(project: Project, site: Site) -> Scene:
    """What is measured in, of a project's photos and ground."""
    import numpy as np

    from georef_gis.measure.scene import Scene
    from georef_gis.model.ground_errors import GroundErrors
    from georef_gis.model.photo_stack import PhotoStack
    from georef_gis.model.tin import TinTerrain
    from georef_gis.project.shared_errors import ADJUSTED, load_errors

    stack = PhotoStack.of(site.photos.values())
    over = stack.origin_enu[:, 2] - site.terrain.z_at(stack.origin_enu[:, :2])
    known = over[np.isfinite(over)]
    errors = load_errors(
        project,
        stack,
        site.pose_kinds,
        height=max(float(np.median(known)), 1.0) if len(known) else 100.0,
        sigma_datum=site.frame.datum_sigma,
    )
    made = np.zeros(0, dtype=np.int64)
    if isinstance(site.terrain, TinTerrain):
        made = np.concatenate([made, *(s.photos for s in errors.sources if s.kind == ADJUSTED)])
    return Scene(
        frame=site.frame,
        terrain=site.terrain,
        errors=errors,
        ground=GroundErrors.of(site.terrain, tied=len(made) > 0),
        ground_photos=made,
        doubts=site.doubts,
    )
