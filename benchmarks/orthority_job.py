"""A project's orthos as a job for orthority: same poses, camera, flat DEM, resolution, JPEG.

orthority (AGPL) runs as a command of its own venv; nothing of it is imported.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import rasterio

from georef_gis.project import Project
from processing_algorithms.site import load_site


def orthority_command(oty: str, folder: Path, interp: str = "") -> list[str]:
    """Command that makes the project's orthos with orthority into `folder/oty`.

    `interp` is its interpolation; by default its own, cubic.
    """
    project = Project.open(folder, read_only=True)
    site = load_site(project)
    out = folder / "oty"
    out.mkdir(exist_ok=True)
    rows = {row["photo_id"]: row for row in project.database.rows("pose")}
    camera = next(iter(site.photos.values())).camera
    (out / "int.yaml").write_text(
        f"lens:\n  type: pinhole\n  im_size: [{camera.width}, {camera.height}]\n"
        f"  focal_len: {camera.fx / camera.width}\n  sensor_size: [1, "
        f"{camera.height / camera.width}]\n"
    )
    xyz = site.frame.map_from_enu(np.array([p.pose.origin_enu for p in site.photos.values()]))
    with (out / "ext.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["filename", "x", "y", "z", "omega", "phi", "kappa", "camera"])
        for photo, (x, y, z) in zip(site.photos.values(), xyz, strict=True):
            row = rows[photo.id]
            angles = [row[f"{name}_deg"] for name in ("omega", "phi", "kappa")]
            writer.writerow([photo.photo.path.name, x, y, z, *angles, "lens"])
    height = project.database.meta("ground")["height_ellipsoidal_m"]
    left, top = xyz[:, 0].min() - 400, xyz[:, 1].max() + 400
    cells = int((np.ptp(xyz[:, :2], axis=0).max() + 800) / 5)
    with rasterio.open(
        out / "dem.tif", "w", driver="GTiff", width=cells, height=cells, count=1, dtype="float32",
        crs=site.frame.horizontal.to_wkt(), transform=rasterio.Affine(5, 0, left, 0, -5, top),
    ) as dem:  # fmt: skip
        dem.write(np.full((1, cells, cells), height, np.float32))
    # ours take the median GSD of each photo, rounded down to two digits
    with rasterio.open(sorted((folder / "products" / "orthos").glob("*.tif"))[0]) as first:
        pixel = first.res[0]
    return [
        oty, "frame", "--dem", str(out / "dem.tif"), "--int-param", str(out / "int.yaml"),
        "--ext-param", str(out / "ext.csv"), "--crs", f"EPSG:{site.frame.horizontal.to_epsg()}",
        "--res", str(pixel), *(["--interp", interp] if interp else []),
        "--compress", "jpeg", "--build-ovw",
        "--out-dir", str(out), "--overwrite",
        *[str(photo.photo.path) for photo in site.photos.values()],
    ]  # fmt: skip
