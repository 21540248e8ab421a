"""Tool `orient_navigation`: when every photo was exposed, and its pose by the trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame
    from georef_gis.model.logs import EventLog
    from georef_gis.model.photo import Photo
    from georef_gis.model.pose import Mount, Pose
    from georef_gis.model.trajectory import Trajectory
    from georef_gis.navigate.exposure_poses import ExposurePoses
    from georef_gis.navigate.exposures import ExposureTimes
    from georef_gis.project import Project

# a photo whose event is less sure than this is doubtful
SURE = 0.99
# and an event that is less likely than this is worse than the photo's own tags
UNLIKELY = 0.8
# and a time by a clock as unlikely as this is a guess
GUESSED = 0.5
# of a height above ground that somebody states: its one sigma
ABOVE_SHARE = 0.1


class OrientNavigation(Algorithm[p.Parameters]):
    """Pose of every photo from the trajectory.

    Photos and noted events (sync board, camera messages, time marks) are matched as sequences;
    without events the camera's clock is laid on the trajectory by the tagged positions. Lever
    arms and boresight carry the trajectory to the camera. A photo outside of the log keeps the
    pose of its tags.
    """

    id, name, group = "orient_navigation", "Orient photos from the trajectory", "navigate"
    needs, gives = ("photos", "trajectory", "poses"), ("poses",)
    in_run = True
    in_quick = False
    uses_settings = ("logs", "gnss", "mount", "ground")

    def inputs(self, context: Context, parameters: p.Parameters) -> Sequence[Path]:
        """The logs, which hold events, and the trajectory."""
        from processing_algorithms.navigate.flight import TRAJECTORY, log_files

        project = context.require_project()
        files = [*log_files(project), project.navigation / TRAJECTORY]
        return [path for path in files if path.exists()]

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Match and orient."""
        from processing_algorithms.navigate.flight import (
            EXPOSURES,
            TRAJECTORY,
            load_trajectory,
        )

        project = context.require_project()
        if not (project.navigation / TRAJECTORY).exists():
            _forget(project)
            (project.navigation / EXPOSURES).unlink(missing_ok=True)
            return Result(summary={})
        work = _Work.of(project, load_trajectory(project))
        doubts = [line for flight in work.flights() for line in work.orient(flight)]
        doubts += work.save(context.run_id)
        for doubt in doubts:
            feedback.warn(doubt)
        for note in work.notes:
            feedback.info(note)
        return Result(
            outputs={},
            summary={
                "oriented": len(work.poses),
                "left_to_tags": len(work.photos) - len(work.poses),
                "notes": work.notes,
                "doubts": doubts,
            },
        )


def _forget(project: Project) -> None:
    """Drop what an earlier trajectory left, and give photos the time of their tags back."""
    database = project.database
    with database.transaction():
        database.delete_rows("pose", {"kind": "navigation"})
        for row in database.rows("photo"):
            before = (row["tags"] or {}).get("tag_time")
            if before is not None:
                tags = {key: value for key, value in row["tags"].items() if key != "tag_time"}
                database.update("photo", row["fid"], tags=tags, match_confidence=None, **before)


@dataclass(slots=True)
class _Work:
    """One run: what it works on, and what it found."""

    project: Project
    frame: MapFrame
    trajectory: Trajectory
    photos: list[Photo]
    tags: dict[str, Pose]
    turned: dict[str, int]
    epoch: float
    events: EventLog | None
    times: dict[str, dict[str, Any]]
    poses: dict[str, Pose]
    doubts: dict[str, list[str]]
    flights_found: dict[str, dict[str, Any]]
    joint: list[ExposurePoses]
    notes: list[str]

    @classmethod
    def of(cls, project: Project, trajectory: Trajectory) -> _Work:
        """Read what is needed."""
        from georef_gis.project.records import load_frame, photo_of, pose_of
        from processing_algorithms.navigate.exposure_inputs import events_to_match, with_tag_time

        database = project.database
        rows = database.rows("photo")
        photos = [with_tag_time(photo_of(row), row) for row in rows]
        poses = database.rows("pose", {"kind": "tags"})
        epoch = database.meta("epoch")
        return cls(
            project=project,
            frame=load_frame(database),
            trajectory=trajectory,
            photos=photos,
            tags={row["photo_id"]: pose_of(row) for row in poses},
            turned={r["photo_id"]: int((r["extra"] or {}).get("turned_deg", 0)) for r in poses},
            epoch=float(epoch) if epoch is not None else float(int(trajectory.span[0])),
            events=events_to_match(project, len(photos)),
            times={}, poses={}, doubts={}, flights_found={}, joint=[], notes=[],
        )  # fmt: skip

    def flights(self) -> list[list[Photo]]:
        """Photos of each flight in the order of exposure."""
        from processing_algorithms.navigate.exposure_inputs import order_of_exposure

        by_id: dict[str, list[Photo]] = {}
        for photo in self.photos:
            by_id.setdefault(photo.flight_id, []).append(photo)
        return [sorted(group, key=order_of_exposure) for _, group in sorted(by_id.items())]

    def orient(self, photos: list[Photo]) -> list[str]:
        """Times and poses of one flight; what is doubtful, in words."""
        from processing_algorithms.navigate.matching import Scene, match_flight

        scene = Scene(
            settings=self.project.settings.logs, frame=self.frame, trajectory=self.trajectory,
            epoch=self.epoch, events=self.events,
        )  # fmt: skip
        found, said = match_flight(scene, photos)
        self.notes += said.notes
        self.flights_found[photos[0].flight_id] = said.flight
        usable = []
        for i, photo in enumerate(photos):
            time = float(found.time[i])
            self._note_time(photo, found, i)
            why = self.trajectory.why_not(time) or self._unlikely(photo, found, i)
            if why:
                self.doubts.setdefault(photo.id, []).append(f"{why}: keeps the pose of its tags")
            else:
                usable.append(i)
        lines = list(said.doubts)
        if usable:
            lines += self._pose(photos, found, usable)
        left = [photo for photo in photos if photo.id not in self.poses]
        if left:
            whys = [f"{q.id}: {self.doubts[q.id][-1]}" for q in left if q.id in self.doubts]
            lines += whys[:3]
            if len(left) > 3:
                lines.append(f"{len(left)} of {len(photos)} photos keep the poses of their tags")
        return lines

    def _unlikely(self, photo: Photo, found: ExposureTimes, i: int) -> str:
        """Why a time is not to be believed; empty where it is.

        A doubtful event is better than nothing for a photo without tags: its sigma covers the
        neighbouring ones. A clock whose offset is a guess may be off by anything.
        """
        confidence = float(found.confidence[i])
        if found.event[i] < 0:
            if found.source[i] != "clock" or confidence >= GUESSED:
                return ""
            return (
                f"the offset of its camera's clock is found with a confidence of "
                f"{100 * confidence:.0f} % only"
            )
        if confidence >= UNLIKELY or photo.id not in self.tags:
            return ""
        return f"its exposure is matched with a confidence of {100 * confidence:.0f} % only"

    def _note_time(self, photo: Photo, found: ExposureTimes, i: int) -> None:
        time, sigma = float(found.time[i]), float(found.sigma[i])
        if self._unlikely(photo, found, i):
            # an event that is not believed tells no time; its confidence still tells why
            time = math.nan
        self.times[photo.id] = {
            "time_gps": time - self.epoch if math.isfinite(time) else None,
            "time_sigma_s": sigma if math.isfinite(sigma) else None,
            "time_source": found.source[i],
            "match_confidence": float(found.confidence[i]),
        }

    def _pose(self, photos: list[Photo], found: ExposureTimes, usable: list[int]) -> list[str]:
        from georef_gis.navigate.exposure_poses import exposure_poses
        from processing_algorithms.navigate.exposure_inputs import time_variance
        from processing_algorithms.navigate.flight import project_mount
        from processing_algorithms.navigate.pose_checks import (
            astray,
            height_shift,
            mount_difference,
        )

        order = sorted(usable, key=lambda i: float(found.time[i]))
        times = found.time[order]
        ids = [photos[i].id for i in order]
        mount = project_mount(self.project)
        held = self._held(ids, times, mount)
        result = exposure_poses(
            self.trajectory, ids, times, time_variance(found, order), mount, self.frame.origin,
            sigma_datum=self.frame.datum_sigma, held=held,
        )  # fmt: skip
        if line := astray(result, self.tags):
            return [line]
        self.joint.append(result)
        lines = []
        kept = sum(pose is not None for pose in held)
        if kept and not self.project.settings.mount.gimbal:
            self.notes.append(
                f"{kept} of {len(ids)} photos keep the angles of their tags, which are surer than "
                "those of the trajectory"
            )
        shift, line = height_shift(result, self.tags, self.project.settings.ground)
        if line:
            lines.append(line)
        self._keep(result, held, found.confidence[order], shift)
        unsure = sum(float(found.confidence[i]) < SURE for i in order)
        if unsure:
            lines.append(f"{unsure} of {len(order)} exposure times are less than 99 % sure")
        if not self.project.settings.mount.gimbal:
            said = {photo.id for photo in self.photos if photo.attitude is not None}
            lines += mount_difference(self.poses, self.tags, said)
        return lines

    def _keep(
        self, result: ExposurePoses, held: Sequence[Pose | None], confidence: Array, shift: float
    ) -> None:
        """Take poses over, on the level of the ground and for the pixels as they are read."""
        from processing_algorithms.navigate.pose_checks import levelled

        for name, pose, tagged, sure in zip(
            result.ids, result.poses, held, confidence, strict=True
        ):
            # the angles of the tags hold the turn of the pixels already
            turned = math.radians(self.turned.get(name, 0)) if tagged is None else 0.0
            level = levelled(pose, shift, self.tags.get(name))
            self.poses[name] = replace(level, R_enu_from_cam=_spun(level.R_enu_from_cam, -turned))
            if sure < SURE:
                self.doubts.setdefault(name, []).append(
                    f"its exposure is matched with a confidence of {100 * float(sure):.0f} % only"
                )

    def _held(self, ids: Sequence[str], times: Array, mount: Mount) -> list[Pose | None]:
        """Poses of the tags whose angles are to be kept: a gimbal's, or surer ones."""
        import numpy as np

        if self.project.settings.mount.gimbal:
            return [self.tags.get(name) for name in ids]
        own = self.trajectory.at(times).covariance
        spread = np.trace(own[:, 3:, 3:], axis1=1, axis2=2) + 3.0 * mount.sigma_boresight**2
        out: list[Pose | None] = []
        for name, variance in zip(ids, spread, strict=True):
            tag = self.tags.get(name)
            better = tag is not None and np.trace(tag.covariance[3:, 3:]) < variance
            out.append(tag if better else None)
        return out

    def save(self, run_id: int | None) -> list[str]:
        """Write poses, times and clocks; what is doubtful, in words."""
        from processing_algorithms.navigate.flight import EXPOSURES
        from processing_algorithms.site import load_ground

        database = self.project.database
        self._settle_ground()
        terrain = load_ground(self.project, self.frame)
        rows, refused = [], []
        for name, pose in self.poses.items():
            agl = float(pose.origin_enu[2] - terrain.z_at(pose.origin_enu[:2]))
            if math.isnan(agl):
                refused.append(f"{name}: the trajectory puts it where the DEM has no height")
                continue
            if agl <= 0.0:
                refused.append(f"{name}: the trajectory puts it {-agl:.0f} m below the ground")
                continue
            rows.append(self._row(name, pose, agl, run_id))
        with database.transaction():
            database.replace_rows("pose", rows, where={"kind": "navigation"})
            self._save_times()
            for flight_id, columns in self.flights_found.items():
                for row in database.rows("flight", {"flight_id": flight_id}):
                    database.update("flight", row["fid"], **columns)
            database.set_meta(epoch=self.epoch)
        path = self.project.navigation / EXPOSURES
        path.unlink(missing_ok=True)
        if len(self.joint) == 1:
            self.joint[0].save(path)
        if refused and not rows:
            refused.append("no pose of the trajectory is used: check the heights of log and ground")
        return refused

    def _settle_ground(self) -> None:
        """Lay flat ground under the cameras where only their height above it is stated."""
        import numpy as np

        from georef_gis.model.terrain import FlatTerrain
        from processing_algorithms.site import ground_facts

        above = self.project.settings.ground.height_above_ground_m
        if self.tags or above is None or not self.poses:
            return
        origin = self.frame.origin
        z = float(np.median([pose.origin_enu[2] for pose in self.poses.values()]))
        terrain = FlatTerrain(
            origin=origin,
            height_ellipsoidal=origin.height_ellipsoidal + z - above,
            sigma=self.project.settings.ground.sigma_m or ABOVE_SHARE * above,
        )
        facts = ground_facts(terrain, "[ground] height_above_ground_m below the logs", None)
        self.project.database.set_meta(ground=facts)

    def _row(self, name: str, pose: Pose, agl: float, run_id: int | None) -> dict[str, Any]:
        from georef_gis.project.records import pose_row

        row = pose_row(
            name, pose, self.frame, height_above_ground=agl, dialect="trajectory",
            doubts=self.doubts.get(name, []), turned_deg=self.turned.get(name, 0),
        )  # fmt: skip
        return {**row, "time_gps": self.times[name]["time_gps"], "run_id": run_id}

    def _save_times(self) -> None:
        database = self.project.database
        for row in database.rows("photo"):
            columns = self.times.get(row["photo_id"])
            if columns is None:
                continue
            if columns["time_gps"] is None:
                columns = {"match_confidence": columns["match_confidence"]}
            tags = dict(row["tags"] or {})
            keys = ("time_gps", "time_sigma_s", "time_source")
            tags.setdefault("tag_time", {key: row[key] for key in keys})
            database.update("photo", row["fid"], tags=tags, **columns)


def _spun(R_enu_from_cam: Array, angle: float) -> Array:
    """Rotation of a camera whose pixels were turned after the exposure."""
    import numpy as np

    from georef_gis.frames import exp_so3

    return np.asarray(R_enu_from_cam @ exp_so3([0.0, 0.0, angle]))
