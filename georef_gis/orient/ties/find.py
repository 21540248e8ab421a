"""The search for tie points from end to end: features, pairs, matches, checks, headings, tracks."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from georef_gis.errors import InputError
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.ties.cache import FeatureCache
from georef_gis.orient.ties.features import (
    Features,
    Picture,
    find_features,
    no_features,
    read_picture,
)
from georef_gis.orient.ties.headings import solve_headings
from georef_gis.orient.ties.matching import Sight, coarse_matches, guided_matches, lean_of, sight_of
from georef_gis.orient.ties.pairs import Candidate, View, bridges, candidate_pairs, groups, view_of
from georef_gis.orient.ties.results import Progress, TiePair, TieResult, TieSettings, no_ties
from georef_gis.orient.ties.tracks import tie_points
from georef_gis.orient.ties.verify import Verified, against_the_loops, verified_matches
from georef_gis.orient.ties.words import doubts_of

logger = logging.getLogger(__name__)

# shares of the whole at which a step ends
FEATURES_END, PAIRS_END, DEEP_END = 0.55, 0.9, 0.97
# pairs per photo of which all features are compared where the outstanding ones joined nothing
DEEP_PER_PHOTO = 3

T = TypeVar("T")
R = TypeVar("R")


def find_ties(
    photos: Sequence[OrientedPhoto],
    terrain: Terrain,
    settings: TieSettings | None = None,
    *,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> TieResult:
    """Ground points that several photos see.

    A photo that cannot be read, or that nothing connects to the others, is named among the doubts
    and does not stop the search.

    Parameters
    ----------
    photos
        With predicted poses; headings may be wrong or unknown.
    terrain
        Ground on which the footprints lie.
    cache
        Folder in which features are kept for the next time.
    progress
        Told the share done and what is being done; it may raise to stop the search.
    """
    search = _Search(
        photos=list(photos),
        terrain=terrain,
        settings=settings or TieSettings(),
        tell=progress or (lambda share, what: None),
    )
    return search.run(cache)


@dataclass(slots=True)
class _Search:
    """State of one search."""

    photos: list[OrientedPhoto]
    terrain: Terrain
    settings: TieSettings
    tell: Progress
    features: list[Features] = field(default_factory=list)
    views: list[View] = field(default_factory=list)
    sights: list[Sight] = field(default_factory=list)
    unread: dict[str, str] = field(default_factory=dict)
    pairs: dict[tuple[int, int], TiePair] = field(default_factory=dict)
    verified: dict[tuple[int, int], Verified] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def run(self, cache: Path | None) -> TieResult:
        ids = tuple(p.id for p in self.photos)
        if len(self.photos) < 2:
            return TieResult(
                ties=no_ties(ids), doubts=("tie points need two photos: there is one",)
            )
        self._timed("features", lambda: self._read(cache))
        self._timed("pairs", self._place)
        self._timed("matches", self._match)
        self._timed("bridges", self._bridge)
        self._timed("loops", self._check_loops)
        turns = solve_headings(self.photos, self.views, self.verified)
        ties = self._timed("tracks", self._tracks)
        group = groups(len(ids), list(self.verified))
        members = [tuple(ids[i] for i in np.flatnonzero(group == g)) for g in np.unique(group)]
        components = tuple(sorted((m for m in members if len(m) > 1), key=len, reverse=True))
        result = TieResult(
            ties=ties,
            pairs=tuple(self.pairs[key] for key in sorted(self.pairs)),
            turns={ids[i]: turn for i, turn in turns.items()},
            components=components,
            seconds=self.seconds,
        )
        self.tell(1.0, "tie points")
        return replace(result, doubts=doubts_of(result, self.unread))

    def _timed(self, name: str, work: Callable[[], R]) -> R:
        start = time.process_time()
        out = work()
        self.seconds[name] = time.process_time() - start
        logger.info("ties: %s in %.2f s of CPU", name, self.seconds[name])
        return out

    def _read(self, folder: Path | None) -> None:
        s = self.settings
        cache = FeatureCache(folder, (s.max_side, s.max_features))

        def one(photo: OrientedPhoto) -> Features | Picture:
            camera, path = photo.camera, photo.photo.path
            kept = cache.load(path)
            if kept is not None and (kept.width, kept.height) == (camera.width, camera.height):
                return kept
            size = {"width": camera.width, "height": camera.height}
            try:
                return read_picture(path, max_side=s.max_side, **size)
            except InputError as error:
                self.unread[photo.id] = str(error)
                return no_features(**size)

        ahead = self._each(one, self.photos, (0.0, FEATURES_END), "features")
        for photo, found in zip(self.photos, ahead, strict=True):
            if isinstance(found, Picture):
                found = find_features(found, max_features=s.max_features)
                cache.save(photo.photo.path, found)
            self.features.append(found)

    def _place(self) -> None:
        self.views = [view_of(p, self.terrain) for p in self.photos]
        self.sights = [
            sight_of(p, f, self.terrain, v.height)
            for p, f, v in zip(self.photos, self.features, self.views, strict=True)
        ]

    def _match(self) -> None:
        found = candidate_pairs(self.photos, self.views, neighbours=self.settings.neighbours)
        self._compare(found, (FEATURES_END, PAIRS_END), deep=False)

    def _bridge(self) -> None:
        """Look again where photos hang together with no others, and then with all features."""
        for deep, span in ((False, (PAIRS_END, PAIRS_END)), (True, (PAIRS_END, DEEP_END))):
            group = groups(len(self.photos), list(self.verified))
            tried = set(self.verified) if deep else set(self.pairs)
            more = bridges(self.views, group, tried)
            if deep:
                more = self._worth_a_deep_look(more, group)
            if more:
                self._compare(more, span, deep=deep)

    def _worth_a_deep_look(self, more: list[Candidate], group: np.ndarray) -> list[Candidate]:
        """Pairs across groups, and few of every photo: each costs 25 times a usual one."""
        known = {key: pair.overlap for key, pair in self.pairs.items()}
        found = [_with_overlap(c, known.get((c.first, c.second), c.overlap)) for c in more]
        found += [
            Candidate(i, j, pair.overlap)
            for (i, j), pair in self.pairs.items()
            if group[i] != group[j] and pair.overlap > 0.1
        ]
        out: dict[tuple[int, int], Candidate] = {}
        count = np.zeros(len(self.photos), dtype=int)
        for c in sorted(found, key=lambda c: -c.overlap):
            if max(count[c.first], count[c.second]) < DEEP_PER_PHOTO:
                out[c.first, c.second] = c
                count[[c.first, c.second]] += 1
        return list(out.values())

    def _compare(self, found: list[Candidate], span: tuple[float, float], *, deep: bool) -> None:
        def one(c: Candidate) -> tuple[Candidate, TiePair, Verified | None]:
            return (c, *self._pair(c, deep=deep))

        for c, pair, verified in self._each(one, found, span, "matches"):
            self.pairs[c.first, c.second] = pair
            if verified is not None:
                self.verified[c.first, c.second] = verified

    def _pair(self, c: Candidate, *, deep: bool) -> tuple[TiePair, Verified | None]:
        a, b = self.sights[c.first], self.sights[c.second]
        pair = TiePair(ids=(self.photos[c.first].id, self.photos[c.second].id), overlap=c.overlap)
        coarse = coarse_matches(a, b, deep=deep)
        if isinstance(coarse, int):
            return replace(pair, candidates=coarse, why="the pictures agree on no place"), None
        lean = lean_of(a, b, self.settings.relief)
        ia, ib, H = guided_matches(a, b, coarse, lean=lean)
        pair = replace(pair, candidates=coarse.candidates, matches=len(ia))
        found = verified_matches(a, b, ia, ib, H, lean=lean, least=self.settings.min_inliers)
        if isinstance(found, str):
            return replace(pair, why=found), None
        pair = replace(
            pair,
            inliers=len(found.a),
            geometry=found.geometry,
            residual=found.residual,
            turn=-float(np.angle(found.similarity)),
            scale=1.0 / abs(found.similarity),
            shift=float(np.hypot(*(found.middle[0] - found.middle[1]))),
        )
        return pair, found

    def _check_loops(self) -> None:
        wrong = against_the_loops(
            {key: v.similarity for key, v in self.verified.items()},
            {key: len(v.a) for key, v in self.verified.items()},
        )
        for key in wrong:
            del self.verified[key]
            self.pairs[key] = replace(
                self.pairs[key], inliers=0, why="turns or scales otherwise than its neighbours do"
            )

    def _tracks(self) -> TiePoints:
        self.tell(DEEP_END, "tie points")
        return tie_points(
            [p.id for p in self.photos],
            self.features,
            {key: (v.a, v.b) for key, v in self.verified.items()},
            observations=self.settings.observations,
        )

    def _each(
        self, work: Callable[[T], R], items: Sequence[T], span: tuple[float, float], what: str
    ) -> Iterator[R]:
        """Work on every item in threads, a few ahead; results in order, progress told between."""
        waiting: deque[Future[R]] = deque()
        done = 0
        with ThreadPoolExecutor(max(self.settings.workers, 1)) as pool:
            try:
                for k, item in enumerate(items):
                    waiting.append(pool.submit(work, item))
                    while waiting and (len(waiting) > self.settings.workers or k + 1 == len(items)):
                        yield waiting.popleft().result()
                        done += 1
                        self.tell(span[0] + (span[1] - span[0]) * done / len(items), what)
            finally:
                pool.shutdown(cancel_futures=True)


def _with_overlap(candidate: Candidate, overlap: float) -> Candidate:
    """The same pair with another overlap."""
    return Candidate(candidate.first, candidate.second, overlap)
