"""CesiumJS in a real Chromium, without any network: what of a KMZ it shows.

Cesium comes from npm once, pinned, into the cache of the user; without npm, network or Chromium
the tests that ask for it skip and say why.
"""

from __future__ import annotations

import contextlib
import functools
import http.server
import os
import shutil
import subprocess
import tarfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

VERSION = "1.135.0"
# Debian's build has no sandbox for root; WebGL is drawn by the processor
FLAGS = (
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
PAGE = """<!doctype html><meta charset="utf-8"><title>KMZ</title>
<link rel="stylesheet" href="Cesium/Widgets/widgets.css">
<style>html, body, #globe { margin: 0; width: 100%; height: 100%; overflow: hidden }</style>
<div id="globe"></div>
<script src="Cesium/Cesium.js"></script>
<script>
// No imagery, no terrain, no token: nothing is asked from anybody.
const viewer = new Cesium.Viewer("globe", {
  baseLayer: false, baseLayerPicker: false, geocoder: false, homeButton: false, animation: false,
  timeline: false, sceneModePicker: false, navigationHelpButton: false, fullscreenButton: false,
  infoBox: false, selectionIndicator: false, skyBox: false, skyAtmosphere: false,
  contextOptions: { webgl: { preserveDrawingBuffer: true } },
});
viewer.scene.globe.baseColor = Cesium.Color.fromCssColorString("#33403a");
viewer.scene.globe.showGroundAtmosphere = false;
viewer.scene.fog.enabled = false;
viewer.cesiumWidget.creditContainer.style.display = "none";
const screens = () => [...document.querySelectorAll("#globe img")].filter(
  (image) => !image.closest(".cesium-widget-credits"));
window.load = async (name) => {
  const source = await Cesium.KmlDataSource.load(name, {
    camera: viewer.camera, canvas: viewer.canvas, screenOverlayContainer: viewer.container,
  });
  await viewer.dataSources.add(source);
  window.source = source;
  const now = viewer.clock.currentTime, all = source.entities.values;
  const boxes = all.filter((e) => e.rectangle).map((e) => {
    const r = e.rectangle.coordinates.getValue(now);
    return [r.west, r.south, r.east, r.north].map(Cesium.Math.toDegrees);
  });
  return {
    boxes,
    points: all.filter((e) => e.billboard && e.position && !e.path).length,
    tracks: all.filter((e) => e.path).length,
    polygons: all.filter((e) => e.polygon).length,
    screens: screens().length,
    names: all.map((e) => e.name),
  };
};
window.look = (west, south, east, north) => {
  viewer.camera.setView({ destination: Cesium.Rectangle.fromDegrees(west, south, east, north) });
};
window.lookFrom = (lon, lat, height, heading, pitch) => {
  viewer.camera.setView({
    destination: Cesium.Cartesian3.fromDegrees(lon, lat, height),
    orientation: {
      heading: Cesium.Math.toRadians(heading), pitch: Cesium.Math.toRadians(pitch), roll: 0,
    },
  });
};
window.pixel = (lon, lat) => {
  const p = viewer.scene.cartesianToCanvasCoordinates(Cesium.Cartesian3.fromDegrees(lon, lat, 0));
  return [p.x, p.y];
};
window.onlyOverlays = (only) => {
  for (const e of window.source.entities.values)
    if (!e.rectangle && (e.billboard || e.polygon || e.polyline || e.path)) e.show = !only;
  for (const image of screens())
    image.style.visibility = only ? "hidden" : "visible";
};
window.placeAt = (when) => {
  const e = window.source.entities.values.find((e) => e.path);
  const p = e.position.getValue(Cesium.JulianDate.fromIso8601(when));
  const c = Cesium.Cartographic.fromCartesian(p);
  return [Cesium.Math.toDegrees(c.longitude), Cesium.Math.toDegrees(c.latitude), c.height];
};
window.settled = () => viewer.scene.globe.tilesLoaded && viewer.dataSourceDisplay.ready;
</script>
"""


def cesium() -> Path:
    """Folder of Cesium's build; skips where it cannot be had."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "georef-tests" / f"cesium-{VERSION}"
    if (folder / "ready").exists():
        return folder / "Cesium"
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed: KMZ are not opened in Cesium")
    folder.mkdir(parents=True, exist_ok=True)
    done = subprocess.run(
        ["npm", "pack", f"cesium@{VERSION}", "--silent"], cwd=folder, capture_output=True,
        text=True, timeout=300, check=False,
    )  # fmt: skip
    packed = folder / f"cesium-{VERSION}.tgz"
    if done.returncode or not packed.is_file():
        pytest.skip("npm cannot fetch cesium (no network?): KMZ are not opened in Cesium")
    start = "package/Build/Cesium/"
    with tarfile.open(packed) as archive:
        for member in archive.getmembers():
            if member.name.startswith(start) and member.isfile():
                target = folder / "Cesium" / member.name.removeprefix(start)
                target.parent.mkdir(parents=True, exist_ok=True)
                stream = archive.extractfile(member)
                assert stream is not None
                target.write_bytes(stream.read())
    packed.unlink()
    (folder / "ready").touch()
    return folder / "Cesium"


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextlib.contextmanager
def served(folder: Path) -> Iterator[str]:
    """Address of a folder with the page, Cesium and the files to be shown."""
    (folder / "index.html").write_text(PAGE)
    (folder / "Cesium").symlink_to(cesium())
    handler = functools.partial(_Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/index.html"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextlib.contextmanager
def globe(folder: Path, size: tuple[int, int] = (800, 560)) -> Iterator[tuple[Any, list[str]]]:
    """A tab that shows the globe, and the addresses outside of this machine that it asked."""
    pytest.importorskip("playwright", reason="playwright is not installed: no browser")
    path = next((p for n in ("chromium", "chromium-browser") if (p := shutil.which(n))), None)
    if path is None:
        pytest.skip("chromium is not installed: KMZ are not opened in Cesium")
    from playwright.sync_api import sync_playwright

    with served(folder) as address, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        try:
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            asked: list[str] = []
            page.on("request", lambda r: _note(asked, r.url))
            page.goto(address)
            if not page.evaluate("!!document.createElement('canvas').getContext('webgl2')"):
                pytest.skip("this Chromium has no WebGL: KMZ are not opened in Cesium")
            yield page, asked
        finally:
            browser.close()


def _note(asked: list[str], url: str) -> None:
    if not url.startswith(("http://127.0.0.1", "data:", "blob:")):
        asked.append(url)


def seen(page: Any) -> bytes:
    """PNG of what is seen once all is drawn; nothing moves afterwards."""
    page.wait_for_timeout(500)
    page.wait_for_function("window.settled()", timeout=120_000)
    page.wait_for_timeout(1000)
    # Drawn by the processor, frame after frame would leave no time for the picture.
    page.evaluate("viewer.useDefaultRenderLoop = false; viewer.scene.render();")
    return bytes(page.screenshot(timeout=120_000))
