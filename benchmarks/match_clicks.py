"""How good matches of clicks are: against the truth, against themselves, and what the place says.

    python benchmarks/match_clicks.py truth SAMPLE [CLICKS]
    python benchmarks/match_clicks.py closure PROJECT [CLICKS]
    python benchmarks/match_clicks.py places [FLIGHTS]

`truth`: random pixels and corners of an adjusted copy of `sample_project`, whose photos are those
of `simulate_flight` with seed 2009; the ground beneath a click is known, pixels of objects are
left out. `closure`: a real adjusted project; a corner of photo A is matched to B and C, then B's
match to C: both pixels in C should be one. `places`: photos of a painted plane, poses and clicks
redrawn from their sigmas for each place.

Last figures (median, 99th percentile, px; wrong: more than 1 px off):

| what | matches | median | 99 % | wrong | error/sigma |
|---|---|---|---|---|---|
| truth, random pixels, 200 clicks | 973 | 0.053 | 0.21 | 0 | 1.08 |
| truth, corners, 200 clicks | 976 | 0.046 | 0.23 | 0 | 1.08 |
| closure, Seneca, 100 clicks | 29 | 0.091 | 0.41 | 0 | 0.67 |

Places of 300 flights: error/sigma 0.97 east, 0.98 north, 0.86 up; with pictures displaced by
0.4 px, as lens and readout of real photos leave, 1.03, 1.03, 0.99; the ellipses of 39.3 and 95 %
held 41.7 and 97.3 %, displaced 39.3 and 93.7 %.
A click takes 0.15 to 0.35 s of CPU, photos decoded.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "measure"))

import match_cases as cases

from georef_gis.errors import GeorefError
from georef_gis.frames import Array
from georef_gis.measure.click_match.match import Matched, match_click
from georef_gis.measure.points import Mark
from georef_gis.project import Project
from processing_algorithms.measure.session import MeasureSession

Misses = list[tuple[Array, Array]]
SEED = 2009


def told(name: str, misses: Misses, words: Counter[str], cpu: list[float]) -> None:
    away = np.array([np.linalg.norm(e) for e, _ in misses])
    chi2 = np.array([e @ np.linalg.solve(C, e) for e, C in misses])[away < 1.0]
    print(f"{name}: {len(away)} matches, median {np.median(away):.3f}, 99 % "
          f"{np.percentile(away, 99):.2f}, worst {away.max():.1f} px; "
          f"wrong {np.sum(away > 1.0)}; "
          f"error/sigma {np.sqrt(chi2.mean() / 2):.2f}; "
          f"CPU {np.median(cpu):.2f} s a click")  # fmt: skip
    for word, count in words.most_common():
        print(f"  {count:5d} {word}")


def word_of(found: Matched) -> str:
    return found.why_not.split("(")[0] or f"matched, {found.size} px"


def corners(picture: np.ndarray, quality: float) -> np.ndarray:
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return cv2.goodFeaturesToTrack(grey, 800, quality, 15)[:, 0].astype(float)


def pixels(
    session: MeasureSession, rng: np.random.Generator, at_corners: bool
) -> Iterator[tuple[str, Array]]:
    """Photos and pixels in them."""
    ids, found = list(session.scene.photos.number), {}
    while True:
        key = str(rng.choice(ids))
        camera = session.scene.photo(key).camera
        if not at_corners:
            yield key, rng.uniform([25.0, 25.0], [camera.width - 25.0, camera.height - 25.0])
            continue
        if key not in found:
            found[key] = corners(session.image(key), 0.02)
        yield key, found[key][rng.integers(len(found[key]))]


def timed(run: Callable[[], Matched], cpu: list[float]) -> Matched:
    start = time.process_time()
    found = run()
    cpu.append(time.process_time() - start)
    return found


# -- truth ---------------------------------------------------------------------------------------


def object_pixels(flight: object) -> list[np.ndarray]:
    """Where objects stand in the photos: what changes without them."""
    from georef_gis.simulate import render

    count = len(flight.names)
    whole = [render.render_photo(flight, i) for i in range(count)]
    render._draw_part = render._draw_tree = lambda *_: None
    return [np.any(a != render.render_photo(flight, i), axis=2) for i, a in enumerate(whole)]


def truth(folder: Path, count: int) -> None:
    from georef_gis.simulate import FlightSettings, optics, simulate_flight, site
    from georef_gis.simulate.render import _View

    session = MeasureSession.open(Project.open(folder, read_only=True))
    flight = simulate_flight(FlightSettings(), seed=SEED)
    hidden = object_pixels(flight)
    views = {Path(name).stem: _View(flight, i) for i, name in enumerate(flight.names)}
    number = {Path(name).stem: i for i, name in enumerate(flight.names)}
    for at_corners in (False, True):
        misses: Misses = []
        words: Counter[str] = Counter()
        cpu: list[float] = []
        source = pixels(session, np.random.default_rng(3), at_corners)
        while len(cpu) < count:
            key, uv = next(source)
            view, (u, v) = views[key], np.round(uv).astype(int)
            if hidden[number[key]][max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2].any():
                continue
            ray = optics.rays_of_pixels(uv[None], view.camera) @ view.R_enu_from_cam.T
            place = site.intersect_ground(view.origin, ray)[0]
            mark = Mark(name="x", photo=key, u=float(uv[0]), v=float(uv[1]))
            found = timed(lambda m=mark: match_click(session.scene, [m], session.image), cpu)
            words[word_of(found)] += 1
            for one in found.matches:
                seen = views[one.mark.photo].project(place)
                misses.append((np.array([one.mark.u, one.mark.v]) - seen, one.covariance))
        told("corners" if at_corners else "random pixels", misses, words, cpu)


# -- closure -------------------------------------------------------------------------------------


def closure(folder: Path, count: int) -> None:
    session = MeasureSession.open(Project.open(folder, read_only=True))
    rng = np.random.default_rng(2)
    misses: Misses = []
    words: Counter[str] = Counter()
    cpu: list[float] = []
    source = pixels(session, rng, True)
    for _ in range(count):
        key, uv = next(source)
        first = Mark(name="x", photo=key, u=float(uv[0]), v=float(uv[1]))
        try:
            found = timed(lambda m=first: match_click(session.scene, [m], session.image), cpu)
        except GeorefError:
            continue
        words[word_of(found)] += 1
        if len(found.matches) < 2:
            continue
        by_photo = {one.mark.photo: one for one in found.matches}
        between = found.matches[rng.integers(len(found.matches))]
        others = [one for one in by_photo if one != between.mark.photo]
        again = match_click(session.scene, [between.mark], session.image, photo_ids=others)
        for one in again.matches:
            direct = by_photo[one.mark.photo]
            e = np.array([one.mark.u - direct.mark.u, one.mark.v - direct.mark.v])
            misses.append((e, one.covariance + direct.covariance + between.covariance))
    told("closure", misses, words, cpu)


# -- places --------------------------------------------------------------------------------------


def places(count: int) -> None:
    for displaced in (0.0, 0.4):
        rng, source = np.random.default_rng(5), cases.Places()
        ratios, inside = [], []
        for _ in range(count):
            uv, place = next(source)
            errors = rng.normal(size=(len(cases.IDS), 6)) * cases.POSE_SIGMA
            moved = {key: displaced * rng.normal(size=2) for key in cases.IDS}
            mark = cases.click("P0", uv + moved["P0"] + cases.CLICK * rng.normal(size=2))
            found = match_click(cases.scene(errors), [mark], lambda k, m=moved: shifted(k, m[k]))
            if found.place is None:
                continue
            e, C = found.place.p_enu[0] - place, found.place.each[0]
            ratios.append(e**2 / np.diag(C))
            inside.append(e[:2] @ np.linalg.solve(C[:2, :2], e[:2]))
        shares = [np.mean(np.array(inside) < -2 * np.log(1 - p)) for p in (0.3935, 0.95)]
        print(f"displaced by {displaced} px: {len(ratios)} places, error/sigma e n u "
              f"{np.round(np.sqrt(np.mean(ratios, axis=0)), 2)}, ellipses hold "
              f"{100 * shares[0]:.1f} and {100 * shares[1]:.1f} %")  # fmt: skip


def shifted(key: str, by: Array) -> np.ndarray:
    """Picture displaced by a part of a pixel: what no camera model tells."""
    picture = cases.picture(key)
    if not np.any(by):
        return picture
    move = np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]]])
    size = (picture.shape[1], picture.shape[0])
    return cv2.warpAffine(picture, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


if __name__ == "__main__":
    cv2.setNumThreads(1)
    kind, *rest = sys.argv[1:]
    if kind == "places":
        places(int(rest[0]) if rest else 300)
    else:
        {"truth": truth, "closure": closure}[kind](Path(rest[0]), int([*rest, "300"][1]))
