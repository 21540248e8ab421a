"""Screening of made-up work zones whose lengths are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.measure.workzone.geometry import (
    Measured,
    distances_to_line,
    order_along,
    spacings,
)
from georef_gis.measure.workzone.rules import load_rules
from georef_gis.measure.workzone.screening import (
    LaneCheck,
    SignCheck,
    TangentCheck,
    TaperCheck,
    ZoneChecks,
    screen,
)
from georef_gis.measure.workzone.told import DISCLAIMER, finding_rows, screening_text
from georef_gis.measure.workzone.verdicts import Finding
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

RULES = load_rules()
# The example of the manual's table: 12 ft at 55 mph ask for 660 ft.
SPEED, OFFSET, LENGTH = 55.0, 12.0, 660.0
PLACE = np.array([4000.0, -2500.0])


def measured(xy_ft: Array, *, own: float = 0.02, shared: float = 0.0) -> Measured:
    """Places in feet; `own` and `shared` sigma per axis, m."""
    n = len(xy_ft)
    p_enu = np.column_stack([np.asarray(xy_ft) * FOOT, np.full(n, 30.0)])
    C = np.kron(np.eye(n) * own**2 + np.ones((n, n)) * shared**2, np.eye(3))
    return Measured.of(tuple(f"C{k + 1}" for k in range(n)), p_enu, C)


def row_of(n: int, length: float = LENGTH, offset: float = OFFSET, turned: float = 0.7) -> Array:
    """n devices of a taper along a road that runs `turned` rad from east; ft."""
    x, y = np.linspace(0, length, n), np.linspace(0, offset, n)
    c, s = math.cos(turned), math.sin(turned)
    return np.column_stack([c * x - s * y, s * x + c * y]) + PLACE


def taper(n: int, **more: object) -> ZoneChecks:
    check = TaperCheck(name="T1", kind="merging", devices=tuple(range(n)), **more)  # type: ignore[arg-type]
    return ZoneChecks(speed_mph=SPEED, tapers=(check,))


def one(findings: list[Finding], check: str) -> Finding:
    (found,) = [f for f in findings if f.check == check and not f.part]
    return found


@pytest.mark.parametrize(
    ("length", "verdict"),
    [(670.0, "pass"), (650.0, "fail"), (660.05, "cannot tell")],
)
def test_taper_length_against_the_offset_that_is_given(length: float, verdict: str) -> None:
    found = one(
        screen(taper(14, offset=OFFSET * FOOT), measured(row_of(14, length)), RULES), "taper length"
    )
    # along the road, not along the devices: 660 ft, not 660.1
    assert found.value / FOOT == pytest.approx(length, abs=1e-6)
    assert found.low / FOOT == pytest.approx(LENGTH)
    assert found.sigma == pytest.approx(0.02 * math.sqrt(2), rel=1e-3)
    assert found.verdict == verdict


def test_error_that_all_places_share_does_not_count() -> None:
    # the seed flight without control: 7.8 m of place, 2 cm of distance
    zone = taper(14, offset=OFFSET * FOOT)
    apart = screen(zone, measured(row_of(14, 700), own=7.8), RULES)
    together = screen(zone, measured(row_of(14, 700), shared=7.8), RULES)
    assert {f.verdict for f in apart} == {"cannot tell"}
    assert {f.verdict for f in together} == {"pass"}
    assert one(together, "taper length").sigma == pytest.approx(0.02 * math.sqrt(2), rel=1e-3)


def test_measured_offset_brings_its_error_times_the_speed() -> None:
    edge = np.array([[0.0, -30.0], [900.0, -30.0]])
    xy = np.vstack([row_of(14, 700, turned=0.0) - PLACE, edge])
    zone = taper(14, edge=(14, 15))
    found = one(screen(zone, measured(xy), RULES), "taper length")
    assert found.value / FOOT == pytest.approx(700, abs=1e-6)
    assert found.low / FOOT == pytest.approx(660, abs=1e-6)
    # offset: sqrt(2) x 2 cm, and the turn of the edge, 2 cm sqrt(2) in 900 ft over 700 ft; x 55
    across = 0.02 * math.sqrt(2) * math.hypot(1, 700 / 900)
    assert found.sigma == pytest.approx(math.hypot(55 * across, 0.02 * math.sqrt(2)), rel=1e-3)
    assert "measured" in found.note


def test_taper_without_offset_is_refused_with_the_cure() -> None:
    with pytest.raises(InputError, match="T1: needs its offset: give offset_ft, or an edge"):
        screen(taper(3), measured(row_of(3)), RULES)


def test_short_taper_has_to_lie_between_two_lengths() -> None:
    for length, verdict in ((40, "fail"), (75, "pass"), (110, "fail"), (50.02, "cannot tell")):
        check = TaperCheck(name="D", kind="downstream", devices=(0, 1, 2, 3, 4))
        zone = ZoneChecks(speed_mph=SPEED, tapers=(check,))
        found = one(screen(zone, measured(row_of(5, length, 0.0)), RULES), "taper length")
        assert found.verdict == verdict, length


def test_one_spacing_too_wide_fails_the_row_and_is_named() -> None:
    xy = np.column_stack([[0, 50, 100, 165, 215], np.zeros(5)])
    check = TaperCheck(name="T1", kind="shoulder", devices=(0, 1, 2, 3, 4), offset=1.0)
    findings = screen(ZoneChecks(speed_mph=SPEED, tapers=(check,)), measured(xy), RULES)
    row = one(findings, "device spacing, all")
    assert row.verdict == "fail"
    assert row.value / FOOT == pytest.approx(65)
    assert "C3 to C4" in row.note
    parts = [f for f in findings if f.part]
    assert [f.verdict for f in parts] == ["pass", "pass", "fail", "pass"]
    # the same row may be twice as wide on a tangent
    tangent = ZoneChecks(speed_mph=SPEED, tangents=(TangentCheck(name="G1", devices=(0, 1, 2, 3)),))
    assert one(screen(tangent, measured(xy), RULES), "device spacing, all").verdict == "pass"


def test_many_spacings_near_the_limit_are_less_sure_together_than_each() -> None:
    # each passes with 97 %, 20 of them at once do not
    n, limit = 21, SPEED
    sigma_gap = 0.05 * math.sqrt(2)
    gap = limit * FOOT - 1.9 * sigma_gap
    xy = np.column_stack([np.arange(n) * gap / FOOT, np.zeros(n)])
    check = TaperCheck(name="T1", kind="shoulder", devices=tuple(range(n)), offset=1.0)
    zone = ZoneChecks(speed_mph=SPEED, tapers=(check,))
    findings = screen(zone, measured(xy, own=0.05), RULES)
    assert {f.verdict for f in findings if f.part} == {"pass"}
    row = one(findings, "device spacing, all")
    assert row.verdict == "cannot tell"
    assert 0.4 < row.probability < 0.9


def test_devices_whose_order_is_not_known_have_no_answer() -> None:
    # 10 ft apart with 8 m of error each: far below the limit, if they are neighbours at all
    xy = np.column_stack([np.arange(6) * 10.0, np.zeros(6)])
    zone = ZoneChecks(speed_mph=55, tangents=(TangentCheck(name="G1", devices=tuple(range(6))),))
    findings = screen(zone, measured(xy, own=8.0), RULES)
    assert {f.verdict for f in findings} == {"cannot tell"}
    parts = [f for f in findings if f.part]
    assert all("which comes first" in f.note for f in parts)
    assert all(f.sigma_needed / FOOT <= 10.0 / 3.0 + 1e-9 for f in parts)


def test_answers_are_wrong_no_more_often_than_they_say() -> None:
    # a taper that just fails, measured 2 000 times with errors that hang together
    rng = np.random.default_rng(1)
    xy = row_of(2, LENGTH - 0.001)
    truth = measured(xy, own=0.3, shared=2.0)
    L = np.linalg.cholesky(truth.covariance)
    zone = taper(2, offset=OFFSET * FOOT)
    passed = 0
    for _ in range(2000):
        noisy = truth.xy + (L @ rng.standard_normal(4)).reshape(2, 2)
        found = Measured(names=truth.names, xy=noisy, covariance=truth.covariance)
        passed += one(screen(zone, found, RULES), "taper length").verdict == "pass"
    # 5 % and 3 standard errors of 2 000 draws
    assert 0.035 < passed / 2000 < 0.065


@pytest.mark.slow
@pytest.mark.parametrize(("gaps", "verdict"), [([2.0] * 7, "fail"), ([1.6] * 3 + [2.0], "pass")])
def test_rows_are_answered_wrong_no_more_often_than_they_say(
    gaps: list[float], verdict: str
) -> None:
    # spacings on the limit of 2 ft a mph, all of them met, or one of them just missed
    rng = np.random.default_rng(2)
    along = np.concatenate([[0.0], np.cumsum(gaps)]) * SPEED
    n = len(along)
    truth = measured(np.column_stack([along, np.zeros(n)]), own=0.3, shared=2.0)
    L = np.linalg.cholesky(truth.covariance)
    check = TangentCheck(name="G1", devices=tuple(range(n)))
    zone = ZoneChecks(speed_mph=SPEED, tangents=(check,))
    wrong = 0
    for _ in range(300):
        noisy = truth.xy + (L @ rng.standard_normal(2 * n)).reshape(n, 2)
        found = Measured(names=truth.names, xy=noisy, covariance=truth.covariance)
        wrong += one(screen(zone, found, RULES), "device spacing, all").verdict == verdict
    # 5 % and 3 standard errors of 300 draws
    assert wrong / 300 < 0.088


# -- lanes ---------------------------------------------------------------------------------------


def lane(widths_ft: list[float], half_ft: float | None, side: float = 1.0) -> list[Finding]:
    """A lane beside an edge that bends: 100 ft east, then north-east."""
    edge = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 100.0]])
    along = np.linspace(10, 90, len(widths_ft))
    xy = np.vstack([np.column_stack([along, side * np.array(widths_ft)]), edge])
    n = len(widths_ft)
    half = () if half_ft is None else (half_ft * FOOT,) * n
    check = LaneCheck(name="L", devices=tuple(range(n)), edge=(n, n + 1, n + 2), half_widths=half)
    return screen(ZoneChecks(speed_mph=SPEED, lanes=(check,)), measured(xy), RULES)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_lane_ends_at_the_near_face_of_the_devices(side: float) -> None:
    # 10.5 ft to the middle of drums of 2 ft: 9.5 ft to drive
    found = one(lane([10.5, 11.0, 12.0], 1.0, side), "lane width, all")
    assert found.value / FOOT == pytest.approx(9.5, abs=1e-6)
    assert found.verdict == "fail"
    assert "C1" in found.note


def test_lane_to_devices_of_unknown_width_says_so() -> None:
    found = one(lane([10.5, 11.0], None), "lane width, all")
    assert found.value / FOOT == pytest.approx(10.5, abs=1e-6)
    assert found.verdict == "pass"
    assert "to the middle of the device" in found.note


def test_devices_beyond_the_edge_are_refused_and_one_on_it_is_not() -> None:
    # feet; the measured places are good to centimetres
    with pytest.raises(InputError, match=r"C3 of lane .L. stand beyond its edge, by 2\.00 m"):
        lane([12.0, 5.0, -2.0 / FOOT], None)
    assert lane([12.0, 5.0, 0.0], None)


def test_width_is_taken_against_the_width_that_is_asked_for() -> None:
    edge = np.array([[0.0, 0.0], [100.0, 0.0]])
    xy = np.vstack([[[50.0, 11.0]], edge])
    check = LaneCheck(name="L", devices=(0,), edge=(1, 2), least=12 * FOOT)
    found = screen(ZoneChecks(speed_mph=SPEED, lanes=(check,)), measured(xy), RULES)
    assert found[0].verdict == "fail"
    assert found[0].source == "as given"


def test_distance_to_a_line_goes_on_beyond_its_ends_and_round_its_corners() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    places = np.array([[-5.0, 2.0], [5.0, -3.0], [11.0, -1.0], [8.0, 12.0]])
    # left is positive; at a corner the corner counts; the last segment goes on
    expected = [2.0, -3.0, -math.sqrt(2), 2.0]
    assert distances_to_line(places, line) == pytest.approx(expected)


# -- signs ---------------------------------------------------------------------------------------


def test_signs_are_screened_from_the_taper_outwards() -> None:
    x = np.array([0.0, -520.0, -1010.0, -1520.0])
    xy = np.column_stack([x, np.zeros(4)])
    check = SignCheck(name="S1", signs=(1, 2, 3), start=0)
    zone = ZoneChecks(speed_mph=SPEED, road_type="rural", signs=(check,))
    findings = screen(zone, measured(xy), RULES)
    assert [f.check[-1] for f in findings] == ["A", "B", "C"]
    assert [f.value / FOOT for f in findings] == pytest.approx([520, 490, 510])
    assert [f.verdict for f in findings] == ["pass", "fail", "pass"]


# -- order ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 13, 90])
def test_devices_along_a_bend_are_put_in_order(n: int) -> None:
    rng = np.random.default_rng(n)
    # three quarters of a circle: the longest axis alone would fold it
    t = np.linspace(0, 1.5 * math.pi, n)
    xy = 100.0 * np.column_stack([np.cos(t), np.sin(t)]) + 0.05 * rng.standard_normal((n, 2))
    shuffled = rng.permutation(n)
    way = [int(shuffled[k]) for k in order_along(xy[shuffled])]
    assert way in (list(range(n)), list(range(n))[::-1])


def test_order_of_devices_in_zigzag_is_the_shortest_way() -> None:
    xy = np.column_stack([np.arange(10.0) * 5, np.tile([0.0, 1.0], 5)])
    assert order_along(xy) in (list(range(10)), list(range(9, -1, -1)))


def test_spacings_are_distances_from_one_to_the_next() -> None:
    assert spacings(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])) == pytest.approx([5.0, 1.0])


# -- what is told --------------------------------------------------------------------------------


def test_account_calls_itself_screening_and_names_its_sources() -> None:
    findings = screen(taper(14, offset=OFFSET * FOOT), measured(row_of(14, 660.05)), RULES)
    text = screening_text(findings, RULES, SPEED, "joint")
    assert text.startswith(DISCLAIMER)
    assert "not a statement of compliance" in text
    assert "CANNOT TELL: taper length of T1" in text
    assert "an answer needs a sigma of" in text
    assert "Table 6C-4" in text
    assert "MUTCD 2009" in text
    rows = finding_rows(findings)
    assert rows[0]["low_ft"] == pytest.approx(660)
    assert rows[0]["high_ft"] == ""
    assert rows[0]["value_m"] == pytest.approx(660.05 * FOOT, abs=1e-3)


@pytest.mark.parametrize(
    "zone",
    [
        ZoneChecks(speed_mph=55, tangents=(TangentCheck(name="G1", devices=(0,)),)),
        ZoneChecks(speed_mph=55, lanes=(LaneCheck(name="G1", devices=(0, 1), edge=(2,)),)),
        ZoneChecks(speed_mph=55, road_type="rural",
                   signs=(SignCheck(name="G1", signs=(), start=0),)),
    ],
)  # fmt: skip
def test_too_few_places_are_refused_by_name(zone: ZoneChecks) -> None:
    with pytest.raises(InputError, match=r"^G1: has .* or more are needed; measure them"):
        screen(zone, measured(row_of(3)), RULES)
