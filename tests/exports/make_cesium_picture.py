"""Makes the picture of docs/google_earth.md: the light KMZ of a project in CesiumJS.

``python tests/exports/make_cesium_picture.py PROJECT``; PROJECT is a copy of the sample project
that was run, with the assets of docs/start.md and the KMZ exported after them.
"""

from __future__ import annotations

import io
import math
import shutil
import sys
import tempfile
from pathlib import Path

from cesium_cases import globe, seen
from PIL import Image

PICTURE = Path(__file__).resolve().parents[2] / "docs/pictures/google_earth_cesium.png"
SIZE = (1100, 760)
# Width of what is shown, of the site's own
WIDTH = 1.9
# m; so far away what is drawn at its height stands where it is on the ground, to some pixels. From
# more than 12 km a dark line shows where two tiles of Cesium's own globe meet.
HEIGHT = 10_000.0
# From there the depth of a point and that of the mosaic below it are the same number.
POINTS_IN_FRONT = """for (const e of window.source.entities.values)
    if (e.billboard) e.billboard.disableDepthTestDistance = Number.POSITIVE_INFINITY;"""


def main(project: Path) -> None:
    """Load the KMZ, look at all of its mosaic, and keep what is seen."""
    with tempfile.TemporaryDirectory() as temp:
        shutil.copy(project / "products/site_light.kmz", Path(temp) / "light.kmz")
        with globe(Path(temp), SIZE) as (page, asked):
            boxes = page.evaluate("window.load('light.kmz')")["boxes"]
            west, south = (min(box[i] for box in boxes) for i in (0, 1))
            east, north = (max(box[i] for box in boxes) for i in (2, 3))
            lon, lat = (west + east) / 2, (south + north) / 2
            # m; a degree of the equator has 111 320
            width = WIDTH * 111_320.0 * (east - west) * math.cos(math.radians(lat))
            page.evaluate(f"viewer.camera.frustum.fov = {2.0 * math.atan(width / 2 / HEIGHT)}")
            page.evaluate(POINTS_IN_FRONT)
            page.evaluate(f"window.lookFrom({lon}, {lat}, {HEIGHT}, 0, -90)")
            picture = Image.open(io.BytesIO(seen(page))).convert("RGB")
        assert asked == [], asked
    # A third of the bytes; colours that are chosen so keep the rare ones, of signs.
    few = picture.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3)
    few.save(PICTURE, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
