"""COLMAP's own structure from motion on a folder of photos, in this process and on the CPU.

Usage: ``python benchmarks/colmap_sfm.py PHOTO_FOLDER OUT [--size 1600] [--match exhaustive]``.

Prints one JSON object: CPU seconds (user and system, start-up included, and by step), the peak of
the process in MB, photos placed, mean reprojection error. OUT gets the database, the model as
COLMAP text (`model/`), and `poses.json`: camera and poses over the GPS of the tags by a robust
similarity, so that orthos may be made of them. Imports nothing of this project.

`poses.json`: `origin` lat, lon (deg) and height (m, of the kind the tags state) of an enu frame;
`camera` with (0, 0) at the centre of the first pixel, at full size; `photos` by file name:
`origin_enu`, `R_enu_from_cam` (rows), `gps_enu`.
"""

from __future__ import annotations

import argparse
import csv
import json
import resource
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

Steps = dict[str, dict[str, float]]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", type=int, default=1600, help="longest side for features, px")
    parser.add_argument("--match", choices=("exhaustive", "spatial"), default="exhaustive")
    parser.add_argument("--distance", type=float, default=100.0, help="spatial matching, m")
    parser.add_argument("--model", default="OPENCV", help="camera model of COLMAP")
    parser.add_argument("--params", default="", help="its first parameters; default from EXIF")
    parser.add_argument("--fix-focal", action="store_true", help="keep the focal length")
    parser.add_argument("--gps", type=Path, help="CSV name,lat,lon,height instead of EXIF")
    parser.add_argument("--gps-error", type=float, default=5.0, help="inlier of the similarity, m")
    parser.add_argument("--threads", type=int, default=2)
    return parser.parse_args()


def cpu_seconds() -> float:
    """User and system seconds of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


class Clock:
    """CPU and wall seconds by step."""

    def __init__(self) -> None:
        self.steps: Steps = {"start": {"cpu_s": round(cpu_seconds(), 2), "wall_s": 0.0}}
        self._mark()

    def _mark(self) -> None:
        self.cpu, self.wall = cpu_seconds(), time.perf_counter()

    def took(self, step: str) -> None:
        """Close a step."""
        self.steps[step] = {
            "cpu_s": round(cpu_seconds() - self.cpu, 2),
            "wall_s": round(time.perf_counter() - self.wall, 2),
        }
        self._mark()


def sparse_model(job: argparse.Namespace, clock: Clock) -> dict[int, pycolmap.Reconstruction]:
    """Features, matches, and the models of the incremental mapper."""
    database = job.out / "database.db"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = job.size
    extraction.num_threads = job.threads
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = job.model
    reader.camera_params = job.params
    pycolmap.extract_features(
        database, job.photos, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
        extraction_options=extraction, device=pycolmap.Device.cpu,
    )  # fmt: skip
    clock.took("features")
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = job.threads
    if job.match == "spatial":
        pairing = pycolmap.SpatialPairingOptions()
        pairing.max_distance = job.distance
        pycolmap.match_spatial(
            database, matching_options=matching, pairing_options=pairing, device=pycolmap.Device.cpu
        )
    else:
        pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
    clock.took("matching")
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = job.threads
    options.ba_refine_focal_length = not job.fix_focal
    options.mapper.abs_pose_refine_focal_length = not job.fix_focal
    options.extract_colors = False
    models = pycolmap.incremental_mapping(database, job.photos, job.out, options)
    clock.took("mapping")
    return dict(models)


def positions(job: argparse.Namespace) -> dict[str, np.ndarray]:
    """Latitude, longitude (deg) and height (m) by file name: of EXIF, or of the given table."""
    if job.gps:
        with job.gps.open(newline="") as stream:
            return {
                row["name"]: np.array([float(row[k]) for k in ("lat", "lon", "height")])
                for row in csv.DictReader(stream)
            }
    out = {}
    with pycolmap.Database.open(job.out / "database.db") as database:
        names = {image.image_id: image.name for image in database.read_all_images()}
        for prior in database.read_all_pose_priors():
            if prior.coordinate_system != pycolmap.PosePriorCoordinateSystem.WGS84:
                continue
            place = np.array(prior.position, dtype=float).ravel()
            if np.all(np.isfinite(place)):
                out[names[prior.corr_data_id.id]] = place
    return out


def georeference(
    model: pycolmap.Reconstruction, gps: dict[str, np.ndarray], max_error: float
) -> dict[str, Any]:
    """Move the model onto the GPS by a robust similarity; the frame and what was left over."""
    names = [model.images[i].name for i in model.reg_image_ids()]
    names = sorted(n for n in names if n in gps)
    if len(names) < 3:
        return {"georeferenced": False, "why": f"{len(names)} placed photos have a GPS position"}
    origin = np.median([gps[n] for n in names], axis=0)
    enu = np.asarray(
        pycolmap.GPSTransform().ellipsoid_to_enu([gps[n] for n in names], *origin)
    ).reshape(-1, 3)
    ransac = pycolmap.RANSACOptions()
    ransac.max_error = max_error
    ransac.random_seed = 0
    moved = pycolmap.align_reconstruction_to_locations(model, names, enu, 3, ransac)
    if moved is None:
        return {"georeferenced": False, "why": f"no similarity within {max_error} m"}
    model.transform(moved)
    by_name = {model.images[i].name: model.images[i] for i in model.reg_image_ids()}
    left = np.array([by_name[n].projection_center() for n in names]) - enu
    axes = np.array([by_name[n].cam_from_world().rotation.matrix()[2] for n in names])
    heights = np.array([p.xyz[2] for p in model.points3D.values()])
    centres = np.array([image.projection_center()[2] for image in by_name.values()])
    return {
        "georeferenced": True,
        "origin": [float(x) for x in origin],
        "gps_enu": {n: [float(x) for x in p] for n, p in zip(names, enu, strict=True)},
        "gps_rms_m": [round(float(x), 2) for x in np.sqrt(np.mean(left**2, axis=0))],
        "tilt_of_mean_axis_deg": round(tilt(axes.mean(axis=0)), 2),
        "height_above_ground_m": round(float(np.median(centres) - np.median(heights)), 2),
    }


def tilt(axis: np.ndarray) -> float:
    """Angle of a view axis from the vertical, deg."""
    return float(np.degrees(np.arccos(np.clip(-axis[2] / np.linalg.norm(axis), -1.0, 1.0))))


def poses(model: pycolmap.Reconstruction, place: dict[str, Any]) -> dict[str, Any]:
    """Camera and poses in the enu frame of `place`."""
    camera = next(iter(model.cameras.values()))
    names = [n.strip() for n in camera.params_info.split(",")]
    values = dict(zip(names, (float(v) for v in camera.params), strict=True))
    values.update({k: values[k] - 0.5 for k in ("cx", "cy")})
    photos = {}
    for i in model.reg_image_ids():
        image = model.images[i]
        photos[image.name] = {
            "origin_enu": [float(x) for x in image.projection_center()],
            "R_enu_from_cam": image.cam_from_world().rotation.matrix().T.tolist(),
            "gps_enu": place["gps_enu"].get(image.name),
        }
    size = {"width": int(camera.width), "height": int(camera.height)}
    return {
        "origin": place["origin"],
        "camera": {"model": camera.model_name, **size, **values},
        "photos": dict(sorted(photos.items())),
    }


def main() -> None:
    job = arguments()
    if job.out.exists() and not (job.out / "database.db").exists() and any(job.out.iterdir()):
        raise SystemExit(f"{job.out} is not empty and not of this benchmark")
    shutil.rmtree(job.out, ignore_errors=True)
    job.out.mkdir(parents=True)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.WARNING
    pycolmap.set_random_seed(0)
    clock = Clock()
    models = sparse_model(job, clock)
    photos = [
        p for p in job.photos.iterdir() if p.suffix.lower() in (".jpg", ".jpeg", ".png", ".tif")
    ]
    report: dict[str, Any] = {
        "pycolmap": pycolmap.__version__,
        "photos": len(photos),
        "size_px": job.size,
        "matching": job.match,
        "camera_model": job.model,
        "threads": job.threads,
        "placed_by_model": sorted((m.num_reg_images() for m in models.values()), reverse=True),
    }
    if models:
        best = max(models.values(), key=lambda m: m.num_reg_images())
        place = georeference(best, positions(job), job.gps_error)
        (job.out / "model").mkdir()
        best.write_text(job.out / "model")
        if place["georeferenced"]:
            (job.out / "poses.json").write_text(json.dumps(poses(best, place), indent=1))
        place.pop("gps_enu", None)
        report |= {
            "placed": best.num_reg_images(),
            "points": best.num_points3D(),
            "observations": best.compute_num_observations(),
            "reprojection_px": round(best.compute_mean_reprojection_error(), 3),
            "focal_px": round(float(next(iter(best.cameras.values())).mean_focal_length()), 1),
            **place,
        }
    clock.took("georeference")
    report |= {
        "steps": clock.steps,
        "cpu_s": round(cpu_seconds(), 1),
        "wall_s": round(sum(step["wall_s"] for step in clock.steps.values()), 1),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
