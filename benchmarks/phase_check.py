"""How far overlapping orthos disagree, by phase correlation on a fixed grid away from tie points.

    python benchmarks/phase_check.py ORTHOS [--project PROJECT] [--grid 5] [--window 128]

ORTHOS is a folder with one GeoTIFF per photo, of one CRS in metres, north up. Where two of them
overlap, the nodes of a grid that is fixed to the map are measured: a square of `--window` native
pixels about the node is correlated, and the peak taken where it is sharp and alone. With
`--project` nodes within 0.5 m of a tie point of its adjustment are left out; those whose whole
square holds none are told apart, for there nothing but the surface and the poses aligns the
orthos. Squares that both orthos fill count as tried. A wrong height of the ground moves two orthos
apart along the line between their cameras, wrong poses move them across it too: the parts are
told apart.

A measure that accepts too much would report its own noise: beside the figures stand the share of
squares accepted where they show different ground (wrong ones), and the error where the same square
is read again with a known shift.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray

Array = NDArray[np.float64]
Square = NDArray[np.float32]

# m; nodes nearer to a tie point are left out
CLEAR = 0.5
# a second peak further off than this, px, is another answer
NEAR = 6
# grey levels, one sigma of a square that has something to hold on to
TEXTURE = 4.0
# how much higher than any other the peak must be; set so that squares of different ground fail
PEAK_RATIO = 1.6
# of the height that equal squares would give
RESPONSE = 0.04
# cycles per px, where the weight of a frequency falls to 0.6: above is the blur of the warp
BAND = 0.18
# of the side of a square; a larger shift leaves too little in common
FARTHEST = 0.35
# tie points are drawn from a table with cells of so many m
CELL = 0.5


@dataclass(frozen=True, slots=True)
class Ortho:
    """Grey values, 0 where there is none; left, top and pixel in m of the map."""

    name: str
    grey: NDArray[np.uint8]
    left: float
    top: float
    pixel: float

    @property
    def box(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        rows, cols = self.grey.shape
        return (
            self.left,
            self.top - rows * self.pixel,
            self.left + cols * self.pixel,
            self.top,
        )

    def square(self, x: float, y: float, side: int, pixel: float) -> Square | None:
        """Square of `side` px of `pixel` m about a place of the map; None where not filled."""
        scale = pixel / self.pixel
        col, row = (x - self.left) / self.pixel - 0.5, (self.top - y) / self.pixel - 0.5
        half = 0.5 * (side - 1) * scale
        low_c, low_r = int(np.floor(col - half)) - 1, int(np.floor(row - half)) - 1
        size = int(np.ceil(2 * half)) + 4
        if low_c < 0 or low_r < 0:
            return None
        part = self.grey[low_r : low_r + size, low_c : low_c + size]
        if part.shape != (size, size) or not part.all():
            return None
        to = np.array([[scale, 0.0, col - half - low_c], [0.0, scale, row - half - low_r]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        out = cv2.warpAffine(part.astype(np.float32), to, (side, side), flags=flags)
        return np.asarray(out, dtype=np.float32)


def read_ortho(path: Path) -> Ortho:
    """Grey values of the first three bands."""
    with rasterio.open(path) as file:
        bands = file.read(list(range(1, min(3, file.count) + 1)))
        mask = file.dataset_mask()
        if bands.dtype != np.uint8:
            low, high = np.percentile(bands[:, mask > 0], [0.5, 99.5])
            bands = np.clip((bands - low) / (high - low) * 255.0, 0, 255).astype(np.uint8)
        grey = bands[0]
        if len(bands) == 3:
            grey = cv2.cvtColor(bands.transpose(1, 2, 0), cv2.COLOR_RGB2GRAY)
        inner = cv2.erode((mask > 0).astype(np.uint8), np.ones((5, 5), np.uint8))
        grey = np.where(inner > 0, np.maximum(grey, 1), 0).astype(np.uint8)
        return Ortho(path.name, grey, file.bounds.left, file.bounds.top, file.res[0])


@dataclass(slots=True)
class Correlator:
    """Phase correlation of squares of one size."""

    side: int
    window: NDArray[np.float32] = field(init=False)
    weight: Array = field(init=False)
    far: NDArray[np.bool_] = field(init=False)
    whole: float = field(init=False)

    def __post_init__(self) -> None:
        """What all squares share."""
        hann = np.hanning(self.side + 2)[1:-1]
        self.window = np.outer(hann, hann).astype(np.float32)
        f = np.fft.fftfreq(self.side)
        half = np.fft.rfftfreq(self.side)
        radius2 = f[:, None] ** 2 + half**2
        self.weight = np.exp(-radius2 / (2.0 * BAND**2))
        # a slope of the light over the square is no texture
        self.weight[radius2 < (2.5 / self.side) ** 2] = 0.0
        away = np.minimum(np.arange(self.side), self.side - np.arange(self.side))
        self.far = np.hypot(away[:, None], away) > NEAR
        self.whole = float(np.fft.irfft2(self.weight, s=(self.side, self.side))[0, 0])

    def shift(self, a: Square, b: Square) -> tuple[Array, float, float]:
        """Where in b what a shows lies, less its place in a: (col, row) px; response; ratio."""
        A, B = (np.fft.rfft2((s - s.mean()) * self.window) for s in (a, b))
        cross = np.conj(A) * B
        cross *= self.weight / np.maximum(np.abs(cross), 1e-9)
        surface = np.fft.irfft2(cross, s=a.shape)
        row, col = np.unravel_index(int(np.argmax(surface)), surface.shape)
        peak = float(surface[row, col])
        apart = np.roll(self.far, (int(row), int(col)), axis=(0, 1))
        second = float(surface[apart].max())
        return self._finer(cross, int(row), int(col)), peak / self.whole, peak / max(second, 1e-12)

    def _finer(self, cross: NDArray[np.complex128], row: int, col: int) -> Array:
        """Peak to a fiftieth of a px: the sum of waves itself, evaluated about the coarse peak.

        Guizar-Sicairos, Thurman and Fienup (2008), "Efficient subpixel image registration".
        """
        n = self.side
        row, col = (v - n if v > n // 2 else v for v in (row, col))
        f, half = np.fft.fftfreq(n), np.fft.rfftfreq(n)
        # the other half of the plane is the conjugate
        double = np.where((half == 0.0) | (half == 0.5), 1.0, 2.0)
        for reach, step in ((1.0, 0.1), (0.1, 0.02)):
            offsets = np.arange(-reach, reach + step / 2, step)
            rows = np.exp(2j * np.pi * np.outer(row + offsets, f))
            cols = np.exp(2j * np.pi * np.outer(half, col + offsets)) * double[:, None]
            fine = (rows @ cross @ cols).real
            i, j = np.unravel_index(int(np.argmax(fine)), fine.shape)
            row, col = row + offsets[i], col + offsets[j]
        return np.array([col, row])


def accepted(a: Square, b: Square, found: tuple[Array, float, float], side: int) -> bool:
    """Whether a peak is one to believe."""
    shift, response, ratio = found
    sharp = response >= RESPONSE and ratio >= PEAK_RATIO
    return bool(sharp and has_texture(a, b) and np.hypot(*shift) <= FARTHEST * side)


def has_texture(a: Square, b: Square) -> bool:
    """Whether both squares show something."""
    return bool(min(float(a.std()), float(b.std())) >= TEXTURE)


class TieTable:
    """Places of an adjustment's tie points in the map, and of the cameras by name; m."""

    def __init__(self, xy: Array, cameras: dict[str, Array]) -> None:
        from scipy.spatial import cKDTree

        self.tree = cKDTree(xy) if len(xy) else None
        self.cameras = cameras

    @classmethod
    def of_project(cls, project: Path) -> TieTable:
        """Those that the adjustment kept, and the cameras it placed."""
        from georef_gis.orient.adjustment.keep import POINTS, load_points
        from georef_gis.project import Project
        from processing_algorithms.site import load_site

        opened = Project.open(project)
        site = load_site(opened)
        points = load_points(opened.adjustment / POINTS).p_enu
        cameras = {
            Path(key).stem: site.frame.map_from_enu(photo.pose.origin_enu)[:2]
            for key, photo in site.photos.items()
        }
        return cls(site.frame.map_from_enu(points)[:, :2], cameras)

    def parts(self, a: Ortho, b: Ortho, shift: Array) -> tuple[float, float] | None:
        """Parts of a shift (right, down) along and across the line between two cameras."""
        one, two = (self.cameras.get(Path(o.name).stem) for o in (a, b))
        if one is None or two is None or np.hypot(*(two - one)) < 1.0:
            return None
        u = (two - one) / np.hypot(*(two - one))
        v = shift * [1.0, -1.0]
        return abs(float(v @ u)), abs(float(v @ [-u[1], u[0]]))

    def nearest(self, x: float, y: float) -> float:
        """Distance to the nearest, m."""
        return float(self.tree.query((x, y))[0]) if self.tree is not None else np.inf

    def within_square(self, x: float, y: float, half: float) -> bool:
        """Whether one lies in a square."""
        if self.tree is None:
            return False
        return bool(self.tree.query_ball_point((x, y), half, p=np.inf, return_length=True))


@dataclass(slots=True)
class Tally:
    """What was found at the nodes of one kind."""

    tried: int = 0
    textured: int = 0
    shifts: list[float] = field(default_factory=list)
    parts: list[tuple[float, float]] = field(default_factory=list)

    def report(self, gsd: float) -> dict[str, Any]:
        """Shares, and medians and 90th percentiles of the accepted in native px."""
        out: dict[str, Any] = {
            "tried": self.tried,
            "textured": self.textured,
            "accepted": len(self.shifts),
            "acceptance": round(len(self.shifts) / max(self.tried, 1), 3),
        }
        if self.shifts:
            d = np.array(self.shifts)
            out |= {
                "median_gsd": round(float(np.median(d)), 2),
                "p90_gsd": round(float(np.percentile(d, 90)), 2),
                "p99_gsd": round(float(np.percentile(d, 99)), 2),
                "median_m": round(float(np.median(d)) * gsd, 4),
            }
        if self.parts:
            middle, high = (np.percentile(self.parts, q, axis=0) for q in (50, 90))
            out["along_the_base_gsd"] = [round(float(middle[0]), 2), round(float(high[0]), 2)]
            out["across_the_base_gsd"] = [round(float(middle[1]), 2), round(float(high[1]), 2)]
        return out


def nodes(a: Ortho, b: Ortho, step: float) -> list[tuple[float, float]]:
    """Nodes of the fixed grid within the boxes of both."""
    west, south = (max(p, q) for p, q in zip(a.box[:2], b.box[:2], strict=True))
    east, north = (min(p, q) for p, q in zip(a.box[2:], b.box[2:], strict=True))
    xs = np.arange(np.ceil(west / step), np.floor(east / step) + 1) * step
    ys = np.arange(np.ceil(south / step), np.floor(north / step) + 1) * step
    return [(float(x), float(y)) for x in xs for y in ys]


@dataclass(slots=True)
class OwnNoise:
    """What the measure says where the answer is known: other ground, and a known shift."""

    wrong_tried: int = 0
    wrong: int = 0
    again: list[float] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """Share of squares of other ground that pass, and the error of the known shifts, px."""
        return {
            "wrong_accepted": round(self.wrong / max(self.wrong_tried, 1), 5),
            "wrong_tried": self.wrong_tried,
            "known_shift_error_px": round(float(np.median(self.again)), 3) if self.again else None,
        }


class Survey:
    """Squares of pairs of orthos, correlated and counted by how far tie points are."""

    def __init__(self, correlator: Correlator, ties: TieTable, gsd: float) -> None:
        self.correlator, self.ties, self.gsd = correlator, ties, gsd
        self.near, self.clear, self.inside, self.noise = Tally(), Tally(), Tally(), OwnNoise()
        self._rng = np.random.default_rng(0)

    def pair(self, a: Ortho, b: Ortho, step: float) -> list[float]:
        """Count the nodes of a pair; the accepted shifts, native px, away from tie points."""
        own: list[float] = []
        previous: Square | None = None
        for x, y in nodes(a, b, step):
            one, two = self._square(a, x, y), self._square(b, x, y)
            if one is None or two is None:
                continue
            kinds = self._kinds(x, y)
            shift = self._count(a, b, one, two, kinds)
            if shift is not None and kinds[0] is self.near:
                own.append(shift)
            if previous is not None:
                self._other_ground(previous, two)
            previous = one
            if self._rng.random() < 0.02 and has_texture(one, one):
                self._known_shift(a, one, x, y)
        return own

    def _square(self, ortho: Ortho, x: float, y: float) -> Square | None:
        return ortho.square(x, y, self.correlator.side, self.gsd)

    def _kinds(self, x: float, y: float) -> list[Tally]:
        """Where a node counts."""
        if self.ties.nearest(x, y) <= CLEAR:
            return [self.inside]
        if self.ties.within_square(x, y, 0.5 * self.correlator.side * self.gsd):
            return [self.near]
        return [self.near, self.clear]

    def _count(
        self, a: Ortho, b: Ortho, one: Square, two: Square, kinds: list[Tally]
    ) -> float | None:
        """Length of an accepted shift, native px; None where it is not to be believed."""
        found = self.correlator.shift(one, two)
        good = accepted(one, two, found, self.correlator.side)
        shift = float(np.hypot(*found[0]))
        for tally in kinds:
            tally.tried += 1
            tally.textured += has_texture(one, two)
            if good:
                tally.shifts.append(shift)
                parts = self.ties.parts(a, b, found[0])
                tally.parts += [parts] if parts else []
        return shift if good else None

    def _other_ground(self, one: Square, two: Square) -> None:
        if has_texture(one, two):
            found = self.correlator.shift(one, two)
            self.noise.wrong_tried += 1
            self.noise.wrong += accepted(one, two, found, self.correlator.side)

    def _known_shift(self, ortho: Ortho, square: Square, x: float, y: float) -> None:
        known = self._rng.uniform(-8.0, 8.0, 2)
        moved = self._square(ortho, x + known[0] * self.gsd, y - known[1] * self.gsd)
        if moved is not None:
            off = self.correlator.shift(square, moved)[0] + known
            self.noise.again.append(float(np.hypot(*off)))


def measure(folder: Path, project: Path | None, step: float, side: int) -> dict[str, Any]:
    """All pairs of orthos of a folder."""
    orthos = [read_ortho(path) for path in sorted(folder.glob("*.tif"))]
    if len(orthos) < 2:
        raise SystemExit(f"{folder}: holds {len(orthos)} orthos, two at least are needed")
    gsd = float(np.median([o.pixel for o in orthos]))
    ties = TieTable.of_project(project) if project else TieTable(np.zeros((0, 2)), {})
    survey = Survey(Correlator(side), ties, gsd)
    pairs, by_pair = 0, []
    for a, b in combinations(orthos, 2):
        own = survey.pair(a, b, step)
        pairs += bool(own)
        if len(own) >= 5:
            by_pair.append((float(np.median(own)), a.name, b.name, len(own)))
    by_pair.sort(reverse=True)
    return {
        "folder": str(folder),
        "orthos": len(orthos),
        "gsd_m": round(gsd, 4),
        "square_m": round(side * gsd, 2),
        "pairs": pairs,
        "away_from_ties": survey.near.report(gsd),
        "square_without_ties": survey.clear.report(gsd),
        "at_ties": survey.inside.report(gsd),
        **survey.noise.report(),
        "pair_medians_gsd": {
            "median": round(float(np.median([p[0] for p in by_pair])), 2) if by_pair else None,
            "worst": [[round(p[0], 2), *p[1:]] for p in by_pair[:5]],
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("orthos", type=Path)
    parser.add_argument("--project", type=Path, help="its adjustment names the tie points")
    parser.add_argument("--grid", type=float, default=5.0, help="m")
    parser.add_argument("--window", type=int, default=128, help="native px, even")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    found = measure(args.orthos, args.project, args.grid, args.window)
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
