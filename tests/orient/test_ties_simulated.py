"""Tie points of the simulator's photos, judged by its own geometry: lens, relief, objects, tags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from flight_photos import fly_direct

from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.ties import TieSettings, find_ties
from georef_gis.simulate import (
    CameraTruth,
    FlightSettings,
    ecef_from_enu,
    enu_from_ecef,
    optics,
    project_truth,
    simulate_flight,
    site,
)
from georef_gis.simulate.render import render_photo


@pytest.mark.slow
def test_tie_points_of_rendered_photos_are_where_the_truth_has_them(tmp_path: Path) -> None:
    full = CameraTruth()
    camera = replace(full, width=648, height=432, fx=full.fx / 2, fy=full.fy / 2, cx=328, cy=212)
    flight = simulate_flight(FlightSettings(camera=camera), seed=11)
    shots = [0, 1, 2, 9, 10]
    direct = fly_direct(flight)
    photos = []
    for i in shots:
        path = tmp_path / f"{flight.names[i]}.png"
        cv2.imwrite(str(path), render_photo(flight, i)[..., ::-1])
        photo = direct.oriented(i)
        photos.append(replace(photo, photo=replace(photo.photo, path=path)))
    ground = FlatTerrain(origin=direct.origin, height_ellipsoidal=277.6, sigma=1.0)
    result = find_ties(photos, ground, TieSettings(max_side=648, max_features=1500))
    assert [len(c) for c in result.components] == [5]
    assert not any(t.quarter_deg for t in result.turns.values())
    ties = result.ties
    miss = []
    first = np.flatnonzero(np.diff(ties.point, prepend=-1))
    for k in range(len(ties.point)):
        start = first[ties.point[k]]
        if k == start:
            continue
        a, b = shots[ties.photo[start]], shots[ties.photo[k]]
        R = site.rotation_ecef_from_site_enu().T @ flight.R_ecef_from_cam[a]
        ray = optics.rays_of_pixels(ties.uv[start], camera) @ R.T
        p = site.intersect_ground(enu_from_ecef(flight.p_ecef[a]), ray)
        miss.append(project_truth(flight, b, ecef_from_enu(p)) - ties.uv[k])
    off = np.hypot(*np.array(miss).T)
    assert len(off) > 300
    assert np.median(off) < 0.4  # px
    assert np.abs(np.median(miss, axis=0)).max() < 0.1  # px: half a pixel would show
    # Cones, signs, vehicles and trees lean out of the ground: not wrong, but off the oracle's.
    assert np.mean(off > 4.0) < 0.06
