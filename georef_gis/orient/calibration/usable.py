"""Photos and marks that a calibration can use: enough of them, and no blunders."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import Array
from georef_gis.orient.calibration.bundle import BundleFit, State, Targets, View, adjust

# marks that a photo must show
FEWEST_MARKS = 6
# a residual this many robust sigmas long is a blunder
BLUNDER = 6.0
# px; residuals below this are no blunders
GOOD_ENOUGH = 0.3
_ROUNDS = 12


def enough(targets: Targets, views: Sequence[View]) -> tuple[list[View], dict[str, str]]:
    """Photos that show enough targets, and why the others are left out."""
    kept, left_out = [], {}
    for view in views:
        if len(view.index) != len(np.unique(view.index)):
            raise InputError("a target is marked twice; remove one", source=f"photo {view.id}")
        if len(view.index) < FEWEST_MARKS:
            left_out[view.id] = f"{len(view.index)} marks, {FEWEST_MARKS} are needed"
            continue
        xyz = targets.xyz[view.index]
        size = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
        if size[1] < 0.02 * size[0]:
            left_out[view.id] = "its marks lie in a line"
            continue
        kept.append(view)
    return kept, left_out


def planar(targets: Targets) -> bool:
    """Whether the targets lie in a plane, as on a board."""
    size = np.linalg.svd(targets.xyz - targets.xyz.mean(axis=0), compute_uv=False)
    return bool(size[2] < 0.02 * size[1])


def check_views(targets: Targets, views: Sequence[View], left_out: Mapping[str, str]) -> None:
    """Refuse too few photos."""
    needed = 3 if planar(targets) else 1
    if len(views) < needed:
        reason = "; ".join(f"{k}: {v}" for k, v in list(left_out.items())[:3])
        raise AdjustmentError(
            f"{len(views)} photos show enough targets, {needed} are needed, better 12"
            + (f" ({reason})" if reason else "")
        )


def without_bad_starts(
    state: State, targets: Targets, views: Sequence[View], left_out: dict[str, str]
) -> tuple[State, list[View], dict[str, str], int]:
    """Leave out marks that are far off already with the first camera."""
    kept, origins, turns, dropped = [], [], [], 0
    left_out = dict(left_out)
    offs = [_off(state, i, view) for i, view in enumerate(views)]
    typical = float(np.median(np.concatenate([np.hypot(*off.T) for off in offs])))
    for i, view in enumerate(views):
        off = np.hypot(*offs[i].T)
        # The lens is not known yet: its distortion is up to tens of pixels.
        good = off < max(20.0 * typical, 20.0)
        if np.count_nonzero(good) < FEWEST_MARKS:
            left_out[view.id] = f"its marks are off by {np.median(off):.0f} px: mislabelled?"
            continue
        dropped += int(np.count_nonzero(~good))
        kept.append(view.only(good))
        origins.append(state.origins[i])
        turns.append(state.R[i])
    return replace(state, origins=origins, R=turns), kept, left_out, dropped


def _off(state: State, i: int, view: View) -> Array:
    p_cam = (state.xyz[view.index] - state.origins[i]) @ state.R[i]
    return np.nan_to_num(view.uv - state.camera.project(p_cam), nan=1e6)


def cleaned(
    state: State, targets: Targets, views: list[View], parameters: tuple[str, ...]
) -> tuple[BundleFit, list[View], dict[str, str], int]:
    """Bundle without outlying marks, and without photos of which more than a few marks are."""
    left_out: dict[str, str] = {}
    lost = {view.id: 0 for view in views}
    fit = adjust(state, targets, views, parameters)
    for _ in range(_ROUNDS):
        lengths = [np.hypot(*r.T) for r in fit.residuals]
        rms = [math.sqrt(float(np.mean(n**2)) / 2.0) for n in lengths]
        # Rayleigh's median is 1.1774 sigma of an axis.
        sigma = float(np.median(np.concatenate(lengths))) / 1.1774
        limit = max(BLUNDER * sigma, GOOD_ENOUGH)
        kept: list[View] = []
        places: list[int] = []
        for i, view in enumerate(views):
            # A blunder pulls its neighbours along: the worst go first.
            bad = lengths[i] > max(limit, 0.5 * float(lengths[i].max()))
            allowed = max(2, round(0.1 * (len(view.index) + lost[view.id])))
            others = float(np.median(rms[:i] + rms[i + 1 :])) if len(views) > 1 else rms[i]
            if np.count_nonzero(bad) + lost[view.id] > allowed and len(views) > 3:
                left_out[view.id] = (
                    f"rms {rms[i]:.2f} px against {others:.2f} px of the others: blurred, "
                    "mislabelled, or the board was moved or bent"
                )
                continue
            if len(view.index) - np.count_nonzero(bad) < FEWEST_MARKS:
                left_out[view.id] = "too few marks are left without blunders"
                continue
            lost[view.id] += int(np.count_nonzero(bad))
            kept.append(view.only(~bad))
            places.append(i)
        if sum(len(v.index) for v in kept) == sum(len(v.index) for v in views):
            break
        check_views(targets, kept, left_out)
        state, views = _only(fit.state, places), kept
        fit = adjust(state, targets, views, parameters)
    return fit, views, left_out, sum(lost[view.id] for view in views)


def _only(state: State, places: Sequence[int]) -> State:
    return replace(
        state, origins=[state.origins[i] for i in places], R=[state.R[i] for i in places]
    )
