"""Of noises that are nearly as likely, the one that is taken."""

from __future__ import annotations

from georef_gis.navigate.tuning import STEP, WORTH, _plainest


def test_stated_noise_is_kept_unless_another_is_clearly_likelier() -> None:
    assert _plainest({(1.0, 1.0): 10.0, (STEP, 1.0): 10.0 + 0.9 * WORTH}) == (1.0, 1.0)
    assert _plainest({(1.0, 1.0): 10.0, (STEP, 1.0): 10.0 + 1.1 * WORTH}) == (STEP, 1.0)


def test_of_two_noises_as_likely_the_larger_is_taken() -> None:
    """Less noise than stated trusts the IMU more than its maker does, on a guess."""
    less, more, stated = (1.0 / STEP, 1.0), (STEP, 1.0), (1.0, 1.0)
    for tried in ((less, more), (more, less)):
        values = {**dict.fromkeys(tried, 10.0), stated: 10.0 - 2.0 * WORTH}
        assert _plainest(values) == more
    # also where it is the better part of a decade farther from what is stated
    assert _plainest({(1.0, 1.0 / STEP): 10.0, (STEP, STEP): 9.0, stated: 0.0}) == (STEP, STEP)


def test_less_noise_is_taken_where_the_log_says_so() -> None:
    less = (1.0 / STEP, 1.0 / STEP)
    assert _plainest({(1.0, 1.0): 0.0, less: 10.0 * WORTH, (STEP, STEP): -9.0}) == less
