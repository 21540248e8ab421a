"""Whether an adjustment is to be believed: blocks that are spoilt on purpose are refused."""

from __future__ import annotations

from dataclasses import replace

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_cases import ORIGIN, Array, adjusted

from georef_gis.frames import exp_so3
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.adjustment.adjust import Adjusted
from georef_gis.orient.adjustment.checks import Check, observability, plausibility


@pytest.fixture(scope="module")
def believed() -> tuple[Adjusted, FlatTerrain]:
    flight = sim.survey(21, 3, 5, relief=1.0)
    return adjusted(flight), FlatTerrain(origin=ORIGIN, height_ellipsoidal=0.0, sigma=1.0)


def failed(checks: list[Check]) -> list[str]:
    return [check.name for check in checks if not check.passed]


def moved(answer: Adjusted, about: Array, turn: Array, scale: float, up: float) -> Adjusted:
    """The whole block turned about a place (rad), scaled and lifted; pixels still fit."""
    R = exp_so3(turn)

    def there(p: Array) -> Array:
        return np.asarray(about + scale * (p - about) @ R.T + [0, 0, up])

    state = replace(
        answer.solution.state, origin=there(answer.solution.state.origin),
        rotation=R @ answer.solution.state.rotation, points=there(answer.solution.state.points),
    )  # fmt: skip
    poses = tuple(
        replace(p, origin_enu=there(p.origin_enu), R_enu_from_cam=R @ p.R_enu_from_cam)
        for p in answer.poses
    )
    return replace(
        answer, solution=replace(answer.solution, state=state), poses=poses,
        points=replace(answer.points, p_enu=there(answer.points.p_enu)),
    )  # fmt: skip


def test_a_good_adjustment_passes_all_checks(believed: tuple[Adjusted, FlatTerrain]) -> None:
    checks = plausibility(*believed)
    assert len(checks) == 5
    assert failed(checks) == []
    assert all("agrees" in check.told() for check in checks)


def test_a_focal_length_of_30_percent_more_is_refused(
    believed: tuple[Adjusted, FlatTerrain],
) -> None:
    answer, ground = believed
    camera = answer.cameras[0]
    long = replace(answer, cameras=(replace(camera, fx=1.3 * camera.fx),))
    (name,) = failed(plausibility(long, ground))
    assert name.startswith("focal length")


@pytest.mark.parametrize(
    ("turn", "scale", "word"),
    [((0.0, 0.0, 0.0), 0.7, "scale"), ((np.radians(40), 0.0, 0.0), 1.0, "turn"),
     ((0.0, 0.0, np.radians(180)), 1.0, "turn")],
)  # fmt: skip
def test_a_block_that_shrank_tilted_or_turned_is_refused(
    believed: tuple[Adjusted, FlatTerrain], turn: tuple[float, ...], scale: float, word: str
) -> None:
    answer, ground = believed
    about = np.mean([p.origin_enu for p in answer.poses], axis=0)
    names = failed(plausibility(moved(answer, about, np.array(turn), scale, 0.0), ground))
    assert any(name.startswith(word) for name in names), names


@pytest.mark.parametrize("share", [-0.3, 0.3])
def test_a_height_above_ground_a_third_off_is_refused_or_the_ground_is(
    believed: tuple[Adjusted, FlatTerrain], share: float
) -> None:
    """Cameras at another height over the same points; 5 % of relief are allowed for.

    Where focal length and scale are right, the block has its size, and the ground is what is off.
    """
    answer, ground = believed
    poses = tuple(replace(p, origin_enu=p.origin_enu * [1, 1, 1 + share]) for p in answer.poses)
    off = replace(answer, poses=poses)
    check = next(c for c in plausibility(off, ground) if c.name == "height above ground")
    assert check.passed
    assert "[ground] dem" in check.remark
    cameras = tuple(replace(c, fx=1.1 * c.fx) for c in off.cameras)
    assert "height above ground" in failed(plausibility(replace(off, cameras=cameras), ground))


def test_mostly_wrong_matches_are_refused(believed: tuple[Adjusted, FlatTerrain]) -> None:
    answer, ground = believed
    many = np.full(len(answer.poses), 2 * len(answer.problem.ties.photo) // len(answer.poses))
    names = failed(plausibility(replace(answer, removed=many), ground))
    assert names == ["share of wrong matches"]


def test_what_one_height_and_speed_cannot_tell_apart_is_said() -> None:
    """Lever arm and clock of a single strip: the prior holds or they are told as a pair."""
    answer = adjusted(sim.strip(22))
    told = observability(answer)
    names = {u.name: u for u in told.unknowns}
    assert names["flight lever_x"].held
    assert told.condition > 10.0
    assert any("prior holds" in line and "flight lever_x" in line for line in told.told())
    assert np.allclose(np.diag(told.correlation), 1.0)
    assert "sim f" in names
    assert names["flight clock"].unit == "s"
