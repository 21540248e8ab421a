"""How fast the page answers: clicks, tiles, and its loading in a real Chromium.

    python benchmarks/web_speed.py PROJECT [--clicks 200]
    python benchmarks/web_speed.py --make FOLDER --picture PICTURE [--photos 167]

The second form writes a simulated flight (`mosaic_scale.py`) and runs it to the mosaic, adjusted,
which takes some minutes, most of it for matching; then call the first on it. PICTURE is enlarged to
the flight's ground, with grain for the matching: a ground that is mirrored again and again looks
alike after half a turn, and its adjustment is not believed. Times are those of whole requests over
loopback, one after another; "in the browser" is from the mouse button to the drawn result.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
         "--disable-background-networking", "--disable-component-update"]  # fmt: skip
# px of ground that one more photo adds, at its overlaps
GROUND_PX = 1.15e6
# size in px, sigma in shades
GRAIN = ((1, 6.0), (3, 10.0), (9, 10.0))
STEPS = "read_photos,orient_direct,match,adjust,footprints,mosaic"


def make(folder: Path, picture: Path, photos: int) -> None:
    """A simulated flight, adjusted, with its mosaic."""
    from mosaic_scale import write_photos

    folder.mkdir(parents=True)
    ground = folder / "ground.jpg"
    write_ground(ground, picture, photos)
    write_photos(folder, ground, photos)
    georef = [sys.executable, "-m", "georef_gis.app", "run", str(folder), "--only", STEPS]
    subprocess.run(georef, check=True)


def write_ground(path: Path, picture: Path, photos: int) -> None:
    """A picture as large as the ground of a flight, rough at several sizes."""
    import cv2

    image = cv2.imread(str(picture))
    if image is None:
        raise SystemExit(f"{picture}: cannot be read as a picture")
    factor = max(1.0, (GROUND_PX * photos / (image.shape[0] * image.shape[1])) ** 0.5)
    image = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    rng, (rows, cols) = np.random.default_rng(0), image.shape[:2]
    for size, sigma in GRAIN:
        coarse = rng.normal(0.0, sigma, (rows // size + 1, cols // size + 1)).astype(np.float32)
        grain = cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_LINEAR)
        for band in range(3):
            image[..., band] = np.clip(image[..., band] + grain, 0.0, 255.0).astype(np.uint8)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 92])


@contextlib.contextmanager
def served(folder: Path) -> Iterator[str]:
    """Address of the page of a project."""
    words = [sys.executable, "-m", "georef_gis.app", "serve", str(folder), "--no-browser"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found
        try:
            yield found[0]
        finally:
            process.terminate()


def told(name: str, seconds: list[float], limit: float) -> None:
    """Median and 95th percentile, ms."""
    ordered = sorted(1e3 * one for one in seconds)
    p95 = ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))]
    mark = "ok" if p95 <= limit else "TOO SLOW"
    print(f"{name:<44} {statistics.median(ordered):7.1f} {p95:7.1f} {limit:7.0f}  {mark}")


class Asked:
    """Times requests of one client."""

    def __init__(self, client: httpx.Client, count: int) -> None:
        self.client, self.count = client, count

    def call(self, name: str, content: dict[str, Any], service: str = "measure") -> Any:
        """Answer of a call."""
        answer = self.client.post(f"/api/{service}/{name}", json=content)
        answer.raise_for_status()
        return answer.json()

    def time(self, title: str, action: Callable[[int], Any], limit: float, count: int = 0) -> None:
        """Time an action, which is given the number of its call."""
        seconds = []
        for k in range(count or self.count):
            began = time.perf_counter()
            action(k)
            seconds.append(time.perf_counter() - began)
        told(title, seconds, limit)


def clicks(asked: Asked, facts: dict[str, Any]) -> None:
    """Single calls of a user's clicks, spread over all photos."""
    rng = np.random.default_rng(0)
    photos = facts["photos_in_order"]
    sizes = asked.call("photo", {"photo": photos[0]}, "view")
    uv = rng.uniform(0.1, 0.9, (asked.count, 2)) * [sizes["width"], sizes["height"]]
    chosen = [photos[k] for k in rng.integers(0, len(photos), asked.count)]
    one = [{"photo": p, "u": float(u), "v": float(v)}
           for p, (u, v) in zip(chosen, uv, strict=True)]  # fmt: skip
    several = []
    for click in one:
        sights = asked.call("sights_of", {"clicks": [click]})["sights"]
        several.append([{k: s[k] for k in ("photo", "u", "v")} for s in sights[:4]])
    places = [asked.call("place", click) for click in one]
    good = [k for k, place in enumerate(places) if "x" in place]

    def figure(vertices: list[Any], shape: str = "point") -> Any:
        return asked.call("figure", {"shape": shape, "vertices": vertices})

    asked.time("click: one photo and the ground", lambda k: figure([{"clicks": [one[k]]}]), 150)
    asked.time("click: up to four photos", lambda k: figure([{"clicks": several[k]}]), 150)
    asked.time("click: a line of ten vertices",
               lambda k: figure([{"clicks": [one[(k + i) % len(one)]]} for i in range(10)], "line"),
               150, 50)  # fmt: skip
    asked.time("click on the mosaic: photo and pixel", lambda k: asked.call(
        "pick", {name: places[good[k % len(good)]][name] for name in ("x", "y")}), 150)  # fmt: skip
    asked.time("photos that show it", lambda k: asked.call("sights_of", {"clicks": [one[k]]}), 150)
    asked.time("guide line in another photo", lambda k: asked.call(
        "guides", {"photo": several[k][-1]["photo"], "clicks": several[k][:1]}), 150)  # fmt: skip
    asked.time("cursor in the photo", lambda k: asked.call("place", one[k]), 150)
    asked.time("cursor on the map", lambda k: asked.call(
        "at", {"photo": chosen[k], **{n: places[good[k % len(good)]][n] for n in ("x", "y")}}),
        150)  # fmt: skip
    asked.time("predictions when a photo is opened",
               lambda k: asked.call("in_photo", {"photo": chosen[k]}), 150, 60)  # fmt: skip


def tiles(asked: Asked, facts: dict[str, Any]) -> None:
    """Tiles of the mosaic, and of photos when they are opened and afterwards."""
    rng = np.random.default_rng(1)
    raster = facts["map"]
    wanted = []
    for _ in range(asked.count):
        z = int(rng.integers(0, len(raster["levels"])))
        level = raster["levels"][z]
        across, down = (-(-level[side] // raster["tile_size"]) for side in ("width", "height"))
        wanted.append({"name": "mosaic", "z": z, "x": int(rng.integers(0, across)),
                       "y": int(rng.integers(0, down))})  # fmt: skip

    def get(kind: str, asked_for: dict[str, Any]) -> None:
        answer = asked.client.get(f"/pictures/view/{kind}", params=asked_for)
        answer.raise_for_status()

    asked.time("tile of the mosaic", lambda k: get("map_tile", wanted[k]), 100)
    photos = facts["photos_in_order"]
    levels = asked.call("photo", {"photo": photos[0]}, "view")["levels"]
    first = [{"photo": p, "z": levels - 1, "x": 0, "y": 0} for p in photos[:60]]
    asked.time("tile of a photo: the first one", lambda k: get("photo_tile", first[k]), 150,
               len(first))  # fmt: skip
    last = {"photo": first[-1]["photo"], "z": 0}
    time.sleep(1.0)
    asked.time("tile of a photo: its own pixels", lambda k: get(
        "photo_tile", {**last, "x": k % 3, "y": k // 3 % 3}), 100)  # fmt: skip


def in_browser(address: str, facts: dict[str, Any], count: int) -> None:
    """Loading of the page and clicks in it, by a real Chromium."""
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        print("chromium is not there: not measured in the browser")
        return
    with sync_playwright() as playwright:
        chrome = playwright.chromium.launch(executable_path=path, args=FLAGS)
        loads = []
        for _ in range(5):
            page = chrome.new_page(viewport={"width": 1280, "height": 720})
            began = time.perf_counter()
            page.goto(address)
            page.wait_for_selector("body[data-ready=true]")
            loads.append(time.perf_counter() - began)
            page.close()
        told("in the browser: the page loads", loads, 2000)
        page = chrome.new_page(viewport={"width": 1280, "height": 720})
        page.goto(address)
        page.wait_for_selector("body[data-ready=true]")
        page.select_option("#photo-choice", facts["photos_in_order"][len(facts) // 2])
        page.wait_for_timeout(1500)
        page.evaluate("document.activeElement.blur()")
        page.keyboard.press("p")
        seconds = [page.evaluate(CLICK, k) / 1e3 for k in range(count)]
        told("in the browser: click to result", seconds, 150)
        chrome.close()


# From a click of the mouse's kind to the frame that shows its result, ms.
CLICK = """async (k) => {
  const { on } = (window.store ??= await import("/static/store.js"));
  const { draft } = (window.drafts ??= await import("/static/draft.js"));
  window.finished ??= [];
  if (!window.listens) {
    window.listens = true;
    on("draft", () => {
      if (draft.result && Object.keys(draft.result.points).length) {
        requestAnimationFrame(() => window.finished.splice(0).forEach((done) => done()));
      }
    });
  }
  const viewer = (window.photos ??= await import("/static/photoview.js")).getViewer();
  const box = document.getElementById("photo").getBoundingClientRect();
  const at = { clientX: box.left + 120 + (37 * k) % 230, clientY: box.top + 200 + (53 * k) % 180,
    bubbles: true, pointerId: 1, isPrimary: true, button: 0, pointerType: "mouse" };
  draft.result = null;
  const began = performance.now();
  const told = new Promise((done) => window.finished.push(done));
  const target = viewer.getViewport();
  target.dispatchEvent(new PointerEvent("pointerdown", { ...at, buttons: 1 }));
  document.dispatchEvent(new PointerEvent("pointerup", { ...at, buttons: 0 }));
  await told;
  return performance.now() - began;
}"""


def main() -> None:
    """Make a project, or measure the page of one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("project", type=Path, nargs="?")
    parser.add_argument("--make", type=Path)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--photos", type=int, default=167)
    parser.add_argument("--clicks", type=int, default=200)
    options = parser.parse_args()
    if options.make:
        make(options.make, options.picture, options.photos)
        return
    with served(options.project) as address:
        base = address.split("/?")[0]
        with httpx.Client(base_url=base, timeout=120.0, trust_env=False) as client:
            client.headers["origin"] = base
            began = time.perf_counter()
            client.get(address, follow_redirects=True).raise_for_status()
            asked = Asked(client, options.clicks)
            facts = asked.call("facts", {}, "view")
            asked.call("control", {})
            print(
                f"{facts['photos']} photos; ready {time.perf_counter() - began:.1f} s after start"
            )
            print(f"{'ms':<44} {'median':>7} {'95 %':>7} {'limit':>7}")
            clicks(asked, facts)
            tiles(asked, facts)
        in_browser(address, facts, min(60, options.clicks))


if __name__ == "__main__":
    main()
