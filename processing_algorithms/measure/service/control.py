"""Calls of the service `measure` about control points: where they show, and their marks."""

from __future__ import annotations

import math
import threading
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from pydantic import Field

from georef_gis.errors import InputError
from georef_gis.toolbox.services import ConflictError, Request, call
from processing_algorithms.measure.mark_file import has_rows, name_mark_file, set_mark
from processing_algorithms.measure.marks import CLICK
from processing_algorithms.measure.service.base import (
    LONGEST_ID,
    LONGEST_TEXT,
    ClickRequest,
    NothingRequest,
    SessionService,
    told_sight,
)
from processing_algorithms.state import file_state, runs_done

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.control import ControlObservations
    from georef_gis.project import Project
    from processing_algorithms.measure.control import LoadedControl

_MOST_SIGHTS = 60
MARKS_FILE = "marks.csv"


class PointRequest(Request):
    """A control point by its name."""

    name: str = Field(max_length=LONGEST_TEXT)


class MarkRequest(ClickRequest):
    """A mark of a control point; `before` is the mark that the page knows of in that photo."""

    name: str = Field(max_length=LONGEST_TEXT)
    before: tuple[float, float] | None = None


class UnmarkRequest(PointRequest):
    """A mark to take away."""

    photo: str = Field(max_length=LONGEST_ID)
    before: tuple[float, float] | None = None


class ControlCalls(SessionService):
    """Control points and their marks."""

    def __init__(self, project: Project) -> None:
        super().__init__(project)
        # as in project.toml now, which naming a file of marks changes
        self._settled = project
        self._loaded: tuple[tuple[str, str], LoadedControl | None] | None = None
        self._control_lock = threading.RLock()

    def control_revision(self) -> str:
        """Text that changes with the files of points and marks."""
        settings = self._settled.settings.control
        named = (settings.file, settings.marks)
        return "/".join(file_state(self._settled.path(file)) for file in named if file is not None)

    def _control(self) -> LoadedControl | None:
        """Points and marks as the files have them now, checked against the poses."""
        from processing_algorithms.measure.control import examine_control

        with self._control_lock:
            state = self.control_revision(), runs_done(self.project)
            if self._loaded is None or self._loaded[0] != state:
                self._loaded = state, examine_control(self._markable(), self.session().site)
            return self._loaded[1]

    def _markable(self) -> Project:
        """The project without its file of marks, where there is not one mark in it yet."""
        from georef_gis.project import Project

        settings = self._settled.settings
        marks = settings.control.marks
        if marks is None or has_rows(self._settled.path(marks)):
            return self._settled
        control = settings.control.model_copy(update={"marks": None})
        return Project(self._settled.folder, settings.model_copy(update={"control": control}))

    def _observations(self) -> ControlObservations | None:
        loaded = self._control()
        return None if loaded is None or loaded.placed is None else loaded.placed.observations

    # -- reading ---------------------------------------------------------------------------------

    @call(NothingRequest)
    def control(self, request: NothingRequest) -> dict[str, Any]:
        """Points with their marks, and what is wrong with them."""
        import numpy as np

        loaded = self._control()
        if loaded is None:
            why = "no control points are named; give a file in [control] file of project.toml"
            return {"points": [], "doubts": [], "why_not": why}
        found = self._observations()
        if found is None:
            return {"points": [], "doubts": list(loaded.doubts)}
        xyz = self.session().frame.map_from_enu(found.p_enu)
        marks = self._marks()
        points = [
            {
                "name": name, "role": found.role[i], "x": float(xyz[i, 0]), "y": float(xyz[i, 1]),
                "height_ellipsoidal_m": float(xyz[i, 2]) if found.has_height[i] else None,
                "sigma_h_m": float(np.hypot(*found.sigma[i, :2]) / math.sqrt(2.0)),
                "sigma_v_m": float(found.sigma[i, 2]) if found.has_height[i] else None,
                "marks": [{"photo": photo, **mark} for (n, photo), mark in marks.items()
                          if n == name],
            }
            for i, name in enumerate(found.names)
        ]  # fmt: skip
        return {"points": points, "doubts": list(loaded.doubts)}

    def _marks(self) -> dict[tuple[str, str], dict[str, Any]]:
        """(Point, photo id) -> pixel of the mark and what its check said."""
        import numpy as np

        loaded, found = self._control(), self._observations()
        if loaded is None or found is None or loaded.check is None:
            return {}
        check = loaded.check
        out = {}
        for k, photo in enumerate(found.photo_ids):
            residual = check.residual[k]
            out[found.names[found.point[k]], photo] = {
                "at": [float(found.uv[k, 0]), float(found.uv[k, 1])],
                "sigma_px": float(found.sigma_px[k]),
                "used": bool(check.keep[k]),
                "suspect": bool(check.suspect[k]),
                "off_px": residual.tolist() if np.all(np.isfinite(residual)) else None,
            }
        return out

    @call(PointRequest)
    def control_sights(self, request: PointRequest) -> dict[str, Any]:
        """Photos that show a point, best first, with the mark where there is one."""
        from georef_gis.measure.who_sees import who_sees

        i, found = self._point(request.name)
        sights = who_sees(
            self.session().scene, found.p_enu[i], self._spread(found, i), best=_MOST_SIGHTS
        )
        marks = self._marks()
        return {
            "sights": [
                {**told_sight(one), "mark": marks.get((request.name, one.photo_id))}
                for one in sights
            ]
        }

    def control_in(self, photo_id: str) -> list[dict[str, Any]]:
        """Predicted pixels of all points in a photo, and their marks there."""
        import numpy as np

        from georef_gis.measure.predicting import predict

        found = self._observations()
        if found is None or not len(found.names):
            return []
        scene = self.session().scene
        number = scene.number(photo_id)
        every = np.full(len(found.names), number)
        uv = scene.photos.project(every, found.p_enu)
        seen = np.flatnonzero(scene.photos.contains(every, uv))
        marks = self._marks()
        shown: dict[str, dict[str, Any]] = {}
        if len(seen):
            spread = np.stack([self._spread(found, int(i)) for i in seen])
            guess = predict(scene, every[: len(seen)], found.p_enu[seen], spread)
            for k, i in enumerate(seen):
                shown[found.names[i]] = _ellipse(guess.uv[k], guess.covariance[k])
        unseen = {"u": None, "v": None, "semi_major": 0.0, "semi_minor": 0.0, "azimuth_deg": 0.0}
        return [
            {"name": name, "role": found.role[i], "marked": marks.get((name, photo_id)),
             **shown.get(name, unseen)}
            for i, name in enumerate(found.names)
            if name in shown or (name, photo_id) in marks
        ]  # fmt: skip

    def _point(self, name: str) -> tuple[int, ControlObservations]:
        found = self._observations()
        if found is None or name not in found.names:
            raise InputError(f"no control point is called {name[:40]!r}")
        return found.names.index(name), found

    def _spread(self, found: ControlObservations, i: int) -> Array:
        """Covariance of a point, m^2: survey, datum, and the level that photos share."""
        import numpy as np

        scene = self.session().scene
        level = float(scene.errors.level_sigma(np.arange(len(scene.photos))).max(initial=0.0))
        sigma = np.array(found.sigma[i], dtype=np.float64)
        if not math.isfinite(sigma[2]):
            place = found.p_enu[i : i + 1, :2]
            sigma[2] = math.sqrt(float(scene.ground.variance(place)[0]))
        variance = sigma**2 + np.asarray(found.sigma_shared) ** 2
        variance[2] += level**2
        return np.diag(variance)

    # -- editing ---------------------------------------------------------------------------------

    @call(MarkRequest)
    def mark(self, request: MarkRequest) -> dict[str, Any]:
        """Write a mark into the file of marks."""
        camera = self.session().scene.photo(request.photo).camera
        if not (-0.5 <= request.u < camera.width - 0.5 and -0.5 <= request.v < camera.height - 0.5):
            raise InputError(f"pixel ({request.u:.1f}, {request.v:.1f}) lies outside of photo "
                             f"{request.photo} ({camera.width} x {camera.height} px)")  # fmt: skip
        sigma = CLICK if request.sigma_px is None else request.sigma_px
        self._set(request.name, request.photo, (request.u, request.v), request.before, sigma)
        return {"mark": self._marks().get((request.name, request.photo))}

    @call(UnmarkRequest)
    def unmark(self, request: UnmarkRequest) -> dict[str, Any]:
        """Take a mark out of the file of marks."""
        self._set(request.name, request.photo, None, request.before, CLICK)
        return {}

    def _set(
        self, name: str, photo_id: str, uv: tuple[float, float] | None,
        before: tuple[float, float] | None, sigma_px: float,
    ) -> None:  # fmt: skip
        with self._control_lock:
            self._point(name)
            self._check_unchanged(name, photo_id, before)
            session = self.session()
            photo = session.scene.photo(photo_id).photo

            def is_photo(written: str) -> bool:
                try:
                    return (
                        session.photo_id(PurePath(written.replace("\\", "/")).as_posix())
                        == photo_id
                    )
                except InputError:
                    return False

            own_name = photo.path.name if is_photo(photo.path.name) else photo_id
            set_mark(self._mark_file(), name, own_name, uv, sigma_px=sigma_px, is_photo=is_photo)
            self._loaded = None

    def _check_unchanged(
        self, name: str, photo_id: str, before: tuple[float, float] | None
    ) -> None:
        now = self._marks().get((name, photo_id))
        same = (now is None) == (before is None)
        if now is not None and before is not None:
            same = math.dist(now["at"], before) < 0.01
        if not same:
            raise ConflictError(
                f"the mark of {name[:40]} in photo {photo_id} was changed meanwhile; nothing was "
                "written",
                current=now,
            )

    def _mark_file(self) -> Path:
        """File of marks; where project.toml names none, one beside the points is named there."""
        from georef_gis.project import Project

        control = self._settled.settings.control
        if control.marks is not None:
            return self._settled.path(control.marks)
        assert control.file is not None
        name = (Path(control.file).parent / MARKS_FILE).as_posix()
        settings = self._settled.folder / "project.toml"
        if self._settled.path(name).exists() or not name_mark_file(settings, name):
            raise InputError(f'name the file of marks: write marks = "{name}" in its section '
                             "[control]", source="project.toml")  # fmt: skip
        self._settled = Project.open(self._settled.folder)
        return self._settled.path(name)


def _ellipse(uv: Array, covariance: Array) -> dict[str, float]:
    import numpy as np

    values, vectors = np.linalg.eigh(covariance)
    minor, major = np.sqrt(np.maximum(values, 0.0))
    right, down = vectors[:, 1]
    return {
        "u": float(uv[0]), "v": float(uv[1]), "semi_major": float(major),
        "semi_minor": float(minor), "azimuth_deg": math.degrees(math.atan2(right, -down)) % 180.0,
    }  # fmt: skip
