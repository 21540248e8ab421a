"""Photos out of the PWM index on a recorder's channel, against the simulated truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.csv_log import read_csv_log
from georef_gis.ingest.pwm_index import PwmIndex, decode_pwm_index
from georef_gis.ingest.recorder_channel import RecorderChannel, read_channel, write_index
from georef_gis.simulate.sync_board import PwmSettings, simulate_pwm_channel

RECORDERS = {
    "20 Hz, 1 us": PwmSettings(),
    "no noise, whole us": PwmSettings(noise=0.0),
    "10 Hz, noise a fifth of the step": PwmSettings(rate=10.0, noise=2.0),
    "50 Hz, noise a quarter of the step": PwmSettings(rate=50.0, noise=2.5),
    "5 Hz, as in 2009": PwmSettings(rate=5.0, noise=1.0),
    "a tenth of the samples missing": PwmSettings(rate=10.0, noise=1.5, dropped=0.1),
    "one sample in fifty a glitch": PwmSettings(glitches=0.02),
    "per cent, a step of one digit": PwmSettings(base=5, step=1.0, noise=0.05, quantum=1.0),
    "per cent, step of two digits and a half": PwmSettings(
        base=10, step=2.5, levels=20, noise=0.3, quantum=1.0
    ),
    "five levels": PwmSettings(levels=5, step=100.0, noise=8.0),
    "stamps jitter by 4 ms": PwmSettings(stamp_jitter=0.004),
}


def photos(rng: np.random.Generator, count: int = 250) -> Array:
    """Times of photos, 1.6 to 2.8 s apart."""
    return np.cumsum(rng.uniform(1.6, 2.8, count)) + 5.0


def decode(truth: Array, settings: PwmSettings, rng: np.random.Generator, **given) -> PwmIndex:
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, settings, rng)
    return decode_pwm_index(time, value, **given)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDERS)
def test_every_photo_is_found_once_at_its_time(name: str) -> None:
    ratios, settings = [], RECORDERS[name]
    for seed in range(5):
        rng = np.random.default_rng([seed, 11])
        truth = photos(rng)
        index = decode(truth, settings, rng)
        assert len(index) == len(truth), index.doubts
        assert np.array_equal(index.count, np.arange(1, len(truth) + 1))
        assert np.array_equal(index.level, np.arange(1, len(truth) + 1) % settings.levels)
        assert (index.steps == 1).all()
        assert index.scale.levels == settings.levels
        # A step wrong by half a level over all of them would count wrongly.
        assert abs(index.scale.step / settings.step - 1.0) < 0.5 / settings.levels
        assert abs(index.glitch_share - settings.glitches) < 0.01
        sure = index.confidence[index.level != 0]
        assert sure.min() > 0.9
        ratios.append((index.time - truth) / index.sigma)
    ratio = np.concatenate(ratios)
    assert 0.85 < np.sqrt(np.mean(ratio**2)) < 1.15
    assert abs(ratio.mean()) < 0.15
    # A uniform error never exceeds sqrt(3) sigma; a dropped or noisy sample may.
    assert np.mean(np.abs(ratio) > 2.5) < 0.01


def test_sigma_is_the_sample_interval_over_root_twelve() -> None:
    rng = np.random.default_rng(1)
    index = decode(photos(rng, 60), PwmSettings(rate=20.0, noise=0.5), rng)
    assert np.allclose(index.sigma, 0.05 / np.sqrt(12.0), rtol=0.01)


def test_step_in_a_gap_of_the_log_has_the_sigma_of_the_gap() -> None:
    rng = np.random.default_rng(2)
    truth = photos(rng, 60)
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, PwmSettings(), rng)
    kept = np.abs(time - truth[30]) > 0.6
    index = decode_pwm_index(time[kept], value[kept])
    assert len(index) == 60
    assert index.sigma[30] == pytest.approx(1.2 / np.sqrt(12.0), rel=0.06)
    assert abs(index.time[30] - truth[30]) < 0.06


@pytest.mark.parametrize("hidden", [1, 2])
def test_photos_that_were_not_seen_leave_a_gap_in_the_count_and_are_named(hidden: int) -> None:
    rng = np.random.default_rng([3, hidden])
    truth = photos(rng, 80)
    # The board counted twice or more at one instant: its output was not updated in between.
    moved = truth.copy()
    moved[40 : 40 + hidden] = moved[40 + hidden]
    index = decode(moved, PwmSettings(), rng)
    assert len(index) == 80 - hidden
    assert index.steps.max() == 1 + hidden
    assert index.count[-1] == 80
    assert list(np.setdiff1d(np.arange(1, 81), index.count)) == list(range(41, 41 + hidden))
    assert f"photos not seen: {hidden}; the index rose by two or more at" in index.doubts[0]


def test_restart_of_the_board_is_no_photo_and_is_named() -> None:
    rng = np.random.default_rng(4)
    truth = photos(rng, 290)
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, PwmSettings(), rng)
    again = time > 0.5 * (truth[250] + truth[251])
    # 251 photos: level 51, which falls to level 0.
    value[again] -= 510.0
    index = decode_pwm_index(time, value)
    assert len(index) == 290
    assert np.abs(index.time - truth).max() < 0.05
    (doubt,) = index.doubts
    assert "the index fell without a wrap at" in doubt


def test_single_fall_may_be_a_wrap_or_a_restart_and_says_so() -> None:
    rng = np.random.default_rng(5)
    truth = photos(rng, 60)
    settings = PwmSettings(levels=40)
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, settings, rng)
    index = decode_pwm_index(time, value)
    assert len(index) == 60
    assert index.confidence[39] <= 0.5
    assert np.delete(index.confidence, 39).min() > 0.95
    assert any("cannot be told; give --levels" in doubt for doubt in index.doubts)
    known = decode_pwm_index(time, value, levels=40)
    assert known.confidence.min() > 0.95
    assert known.doubts == ()


def test_confidence_of_wrong_steps_is_low() -> None:
    """Noise of 0.4 steps at 5 Hz: what is claimed with 99 % is right in at least 98 %."""
    claimed = right = unsure = 0
    for seed in range(30):
        rng = np.random.default_rng([seed, 6])
        truth = photos(rng, 120)
        index = decode(truth, PwmSettings(rate=5.0, noise=4.0), rng, step=10.0)
        sure = index.confidence > 0.99
        at = index.time[sure]
        near = np.abs(at[:, None] - truth).min(axis=1) < 4.0 * index.sigma[sure]
        claimed += len(at)
        right += int(near.sum())
        unsure += int((~sure).sum())
    assert claimed > 2000
    assert unsure > 20
    assert right > 0.98 * claimed


def test_excursion_of_a_few_samples_is_a_glitch_and_not_two_steps() -> None:
    rng = np.random.default_rng(7)
    truth = photos(rng, 60)
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, PwmSettings(), rng)
    for photo, size, length in ((10, 10.0, 1), (20, 10.0, 3), (30, -20.0, 4), (40, 300.0, 5)):
        start = np.searchsorted(time, truth[photo] + 0.5)
        value[start : start + length] += size
    index = decode_pwm_index(time, value)
    assert np.array_equal(index.count, np.arange(1, 61))
    assert np.abs(index.time - truth).max() < 0.05


def test_falling_index_and_missing_values() -> None:
    rng = np.random.default_rng(8)
    truth = photos(rng, 60)
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, PwmSettings(), rng)
    value[rng.random(len(value)) < 0.05] = np.nan
    value[:40] = np.nan
    index = decode_pwm_index(time, 4000.0 - value, step=-10.0)
    assert np.array_equal(index.count, np.arange(1, 61))
    assert index.scale.step == -10.0
    assert index.scale.base == pytest.approx(3000.0, abs=1.0)


@pytest.mark.slow
def test_an_hour_at_50_hz_takes_seconds() -> None:
    from time import process_time

    rng = np.random.default_rng(9)
    truth = photos(rng, 1600)
    time, value = simulate_pwm_channel(truth, 3600.0, PwmSettings(rate=50.0), rng)
    decode_pwm_index(time[:3000], value[:3000])
    begun = process_time()
    index = decode_pwm_index(time, value)
    assert len(index) == np.sum(truth < time[-1])
    assert process_time() - begun < 10.0


@pytest.mark.parametrize(
    ("value", "given", "words"),
    [
        (np.full(500, 1500.0), {}, r"the channel is constant \(1500\)"),
        (np.full(500, np.nan), {}, "0 samples with a value are too few"),
        (np.random.default_rng(0).normal(1500, 3, 500), {}, "0 clear steps in 500 samples"),
        (1500 + 10.0 * (np.arange(500) > 250), {}, "1 clear steps in 500 samples"),
        (np.random.default_rng(0).normal(1500, 9, 500), {"step": 10}, "hides steps of 10"),
        (1500 + 10.0 * (np.arange(500) // 50), {"levels": 4}, "10 levels of 10, more than the 4"),
    ],
)
def test_channel_without_an_index_is_refused(value: Array, given, words: str) -> None:
    with pytest.raises(InputError, match=f"log.txt: servo: .*{words}"):
        decode_pwm_index(np.arange(500) * 0.05, value, source="log.txt: servo", **given)


def test_samples_of_one_time_are_refused() -> None:
    with pytest.raises(InputError, match="all samples have one time"):
        decode_pwm_index(np.ones(500), np.arange(500.0))


@pytest.fixture
def flight() -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(10)
    truth = photos(rng, 50)
    return truth, *simulate_pwm_channel(truth, truth[-1] + 5.0, PwmSettings(levels=30), rng)


def test_channel_of_a_table_on_gps_time_becomes_an_event_log(tmp_path: Path, flight) -> None:
    truth, time, value = flight
    # The flight runs over the end of a week.
    tow = 604800.0 - 60.0 + time
    rows = [
        f"{1550 + int(t >= 604800)},{t % 604800:.3f},{v:.0f},7"
        for t, v in zip(tow, value, strict=True)
    ]
    log, out = tmp_path / "recorder.csv", tmp_path / "out" / "index.csv"
    log.write_text("gps_week,tow_s,Servo 3,Servo 4\n" + "\n".join(rows) + "\n")
    channel = read_channel(log, "servo3")
    assert channel.scale == "gps"
    index = decode_pwm_index(channel.time, channel.value)
    write_index(out, index, channel)
    (events,) = read_csv_log(out).events
    assert (events.kind, events.scale) == ("sync_board", "gps")
    assert list(events.sequence) == list(range(1, 51))
    # 0.05 s samples; the table is written to 0.1 ms
    assert np.abs(events.time - (1551 * 604800.0 - 60.0 + truth)).max() < 0.0251
    assert np.allclose(events.sigma, index.sigma, atol=1e-5)


def test_channel_of_an_eagle_tree_record_is_on_the_recorders_clock(tmp_path: Path, flight) -> None:
    truth, time, value = flight
    rows = [f"{1000 * t:.0f} 0 0 0 {v:.0f}" for t, v in zip(time, value, strict=True)]
    log, out = tmp_path / "flight.FDR", tmp_path / "index.csv"
    head = "My model\nset-up\nMilliseconds IsEvent EventError EventData Servo1\n"
    log.write_text(head + "\n".join(rows) + "\n")
    channel = read_channel(log, "Servo1")
    index = decode_pwm_index(channel.time, channel.value)
    write_index(out, index, channel)
    (events,) = read_csv_log(out).events
    assert events.scale == "boot"
    assert np.abs(events.time - truth).max() < 0.0251


@pytest.mark.parametrize("unit", [("t", "t:ms", 1e3), ("stamp (ms)", "", 1e3)])
def test_time_column_can_be_named_with_its_unit(tmp_path: Path, flight, unit) -> None:
    header, named, factor = unit
    truth, time, value = flight
    log = tmp_path / "recorder.txt"
    header = "millis" if not named else header
    rows = [f"{factor * t:.1f};{v:.0f};1" for t, v in zip(time, value, strict=True)]
    log.write_text(f"{header};pwm;mode\n" + "\n".join(rows) + "\n")
    channel = read_channel(log, "#2", named)
    assert np.abs(decode_pwm_index(channel.time, channel.value).time - truth).max() < 0.0251


def test_unknown_channel_is_named_with_those_there_are(tmp_path: Path, flight) -> None:
    log = tmp_path / "recorder.csv"
    log.write_text("tow_s,servo1,servo2\n" + "".join(f"{i / 20},1,{i}\n" for i in range(50)))
    with pytest.raises(InputError, match=r"'servo9'; did you mean servo\d\?; columns are tow_s, s"):
        read_channel(log, "servo9")
    log.write_text("a,servo1,servo2\n" + "".join(f"{i / 20},1,{i}\n" for i in range(50)))
    with pytest.raises(InputError, match="name one by --time-column, of a, servo1"):
        read_channel(log, "servo1")


def test_refused_target_leaves_nothing_behind(tmp_path: Path, flight) -> None:
    _, time, value = flight
    channel = RecorderChannel(time=time, value=value, scale="boot")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_index(tmp_path / "folder.csv", decode_pwm_index(time, value), channel)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]
