"""The photo index that a time-synchronisation board writes as a pulse width on a servo channel.

The width rises by one step at every photo and wraps after N steps (2009 report, section 3.3). The
recorder samples it 5 to 50 times a second, rounded and noisy; step, levels and noise are learnt
from the samples. The path through the levels is the likeliest one of a hidden Markov model whose
transitions are a photo, a photo that was not seen, a restart, and whose samples may be glitches:
what a hysteresis does by thresholds, with a probability.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.pwm_path import (
    IntArray,
    PwmScale,
    changes_of,
    likeliest_path,
    plateau_confidence,
    when_changed,
    without_excursions,
)

# A change must be so many sigmas of the noise to be seen before the step is known.
_CLEAR = 5.0
# Samples on each side of a change whose medians are compared, tried in turn.
_WIDTHS = (1, 2, 3, 5, 8)
# Samples in a row that make a level.
_RUN = 3
# The scale is fitted to the path and the path to the scale, at most so often.
_PASSES = 4
_FEWEST_SAMPLES, _FEWEST_STEPS, _MOST_LEVELS = 10, 3, 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PwmIndex:
    """Photos found on the channel.

    Parameters
    ----------
    time, sigma : shape (n,), s
        On the recorder's clock; uniform between two samples gives dt / sqrt(12).
    count : shape (n,)
        Photos so far, by the index, this one included; a photo that was not seen leaves a gap.
    level : shape (n,)
        Level after the step, 0..levels - 1.
    steps : shape (n,)
        Levels risen at once: 1, or more where photos were not seen.
    confidence : shape (n,)
        Probability that the level before and the level after are right.
    glitch_share
        Share of samples on no level.
    doubts
        Sentences for people.
    """

    time: Array
    sigma: Array
    count: IntArray
    level: IntArray
    steps: IntArray
    confidence: Array
    scale: PwmScale
    glitch_share: float
    doubts: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        """Photos."""
        return len(self.time)


def decode_pwm_index(
    time: Array,
    value: Array,
    *,
    step: float | None = None,
    levels: int | None = None,
    source: str = "",
) -> PwmIndex:
    """Find the photos in the samples of a channel.

    Parameters
    ----------
    time : shape (n,), s
    value : shape (n,)
        Pulse width in us, per cent or any unit; NaN where the recorder has none.
    step, levels
        Of the board, in the unit of `value`; learnt if not given. The step may fall.
    source
        File, for messages.

    Raises
    ------
    InputError
        If there are too few samples, the channel is constant, or no step can be told from noise.
    """
    time, value = _cleaned(time, value, source)
    falling = step is not None and step < 0.0
    value = -value if falling else value
    scale, states = _learn(time, value, abs(step) if step else None, levels, source)
    rate = max(len(changes_of(states)), 1) / (time[-1] - time[0])
    for _ in range(_PASSES):
        before = states
        states = without_excursions(likeliest_path(time, value, scale, rate), scale.levels)
        unused = scale.levels - int(np.ptp(states)) - 1 if levels is None else 0
        if unused:
            # Noise and glitches made a level beyond the ends, which no photo reaches.
            scale = replace(
                scale,
                base=scale.base + scale.step * int(states.min()),
                levels=scale.levels - unused,
            )
            states = states - states.min()
        scale = _refitted(value, states, scale, fixed_step=step is not None)
        if not unused and np.array_equal(states, before):
            break
    index = _photos(time, value, states, scale, rate)
    if falling:
        index = replace(index, scale=replace(scale, base=-scale.base, step=-scale.step))
    return index


def _cleaned(time: Array, value: Array, source: str) -> tuple[Array, Array]:
    time, value = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    good = np.isfinite(time) & np.isfinite(value)
    time, value = time[good], value[good]
    if len(time) < _FEWEST_SAMPLES:
        raise InputError(
            f"{len(time)} samples with a value are too few for an index; name another channel",
            source=source,
        )
    # Two samples of one instant, or a stamp that jitters backwards, keep their order of writing.
    time = np.maximum.accumulate(time)
    if time[-1] <= time[0]:
        raise InputError("all samples have one time; name another time column", source=source)
    if np.ptp(value) == 0.0:
        raise InputError(
            f"the channel is constant ({value[0]:g}): no index; name another channel", source=source
        )
    return time, value


def _quantum(value: Array) -> float:
    """Unit of the last digit; 0 where there is none."""
    gaps = np.diff(np.unique(value))
    smallest = float(gaps.min())
    whole = np.abs(gaps / smallest - np.round(gaps / smallest)) < 0.01
    return smallest if whole.mean() > 0.98 and len(gaps) < len(value) / 3 else 0.0


def _noise(value: Array, quantum: float) -> float:
    """Sigma of a sample, from differences of neighbours: most of them hold no step."""
    differences = np.abs(np.diff(value))
    robust = 1.4826 * float(np.median(differences)) / math.sqrt(2.0)
    if robust < quantum:
        # Rounding makes the median jump; the mean of what lies within one unit does not.
        near = differences[differences <= 1.5 * quantum]
        robust = math.sqrt(float(np.mean(near**2)) / 2.0)
    floor = quantum / math.sqrt(12.0) or 1e-6 * float(np.ptp(value))
    return max(robust, floor)


def _rises(value: Array, noise: float) -> tuple[Array, int]:
    """Clear rises of the channel, and the width of the medians that show them best."""
    best: tuple[float, Array, int] = (0.0, np.empty(0), 1)
    for width in _WIDTHS:
        if len(value) < 4 * width:
            break
        windows = np.lib.stride_tricks.sliding_window_view(value, width)
        medians = np.median(windows, axis=1)
        jump = medians[width:] - medians[:-width]
        limit = _CLEAR * max(
            noise * math.sqrt(2.0 / width), 1.4826 * float(np.median(np.abs(jump))) / width
        )
        size = np.abs(jump)
        reach = np.lib.stride_tricks.sliding_window_view(
            np.pad(size, width, mode="edge"), 2 * width + 1
        ).max(axis=1)
        at = np.flatnonzero((size >= reach) & (jump > limit))
        # One jump gives its largest value at several samples in a row.
        found = jump[at[np.diff(at, prepend=-2 * width) > width]]
        score = len(found) * float(np.median(found)) / limit if len(found) else 0.0
        if score > 1.2 * best[0]:
            best = (score, found, width)
    return best[1], best[2]


def _learn(
    time: Array, value: Array, step: float | None, levels: int | None, source: str
) -> tuple[PwmScale, IntArray]:
    """First guess of the scale, and the nearest level of every sample."""
    quantum = _quantum(value)
    noise = _noise(value, quantum)
    if step is None:
        rises, _ = _rises(value, noise)
        if len(rises) < _FEWEST_STEPS:
            raise InputError(
                f"{len(rises)} clear steps in {len(value)} samples (noise {noise:.3g}): no index "
                "can be learnt; give --step, or name another channel",
                source=source,
            )
        step = _in_phase(value, _typical(rises))
    if noise > 0.5 * step:
        raise InputError(
            f"the noise {noise:.3g} hides steps of {step:.3g}; the board needs a larger step",
            source=source,
        )
    phase = float(np.angle(np.mean(np.exp(2j * math.pi * value / step)))) / (2.0 * math.pi) * step
    nearest = np.round((value - phase) / step).astype(np.int64)
    lowest, highest = _level_range(nearest, abs(value - phase - step * nearest) < 3.5 * noise)
    if levels is not None and highest - lowest + 1 > levels:
        raise InputError(
            f"the channel has {highest - lowest + 1} levels of {step:.3g}, more than the {levels} "
            "given; check --levels and --step",
            source=source,
        )
    count = levels or highest - lowest + 1
    if not 2 <= count <= _MOST_LEVELS:
        raise InputError(
            f"steps of {step:.3g} give {count} levels, which is no index; give --step",
            source=source,
        )
    scale = PwmScale(
        base=phase + step * lowest, step=step, levels=count, noise=noise, quantum=quantum,
        wrap_known=levels is not None,
    )  # fmt: skip
    return scale, np.clip(nearest - lowest, 0, count - 1)


def _typical(rises: Array) -> float:
    """Commonest rise: a rise over several levels, or half of one, is rarer than a single step."""
    width = 0.25 * float(np.median(rises))
    near = np.abs(rises[:, None] - rises[None, :]) < width if len(rises) < 4000 else None
    if near is None:
        return float(np.median(rises))
    middle = int(np.argmax(near.sum(axis=1)))
    return float(np.median(rises[near[middle]]))


def _in_phase(value: Array, step: float) -> float:
    """Step near a guess at which the samples lie best on one comb of levels."""
    span = float(np.ptp(value)) / step
    # A histogram finer than any noise that leaves steps visible stands for a million samples.
    bins, weight = np.unique(np.round(value * (64.0 / step)), return_counts=True)
    centre = bins * (step / 64.0)
    for width in (0.15, 0.02):
        count = int(min(max(8.0 * width * span, 40.0), 2000.0))
        trials = step * np.linspace(1.0 - width, 1.0 + width, 2 * count + 1)
        fit = [abs(weight @ np.exp(2j * math.pi * centre / trial)) for trial in trials]
        # A comb of fewer levels fits ever worse; a quiet channel of two levels fits all alike.
        step = float(trials[int(np.argmax(fit))]) if max(fit) > 1.02 * fit[count] else step
    return step


def _level_range(nearest: IntArray, fits: NDArray[np.bool_]) -> tuple[int, int]:
    """Lowest and highest level that some samples in a row have."""
    for run in range(_RUN, 0, -1):
        same = fits.copy()
        for shift in range(1, run):
            same[shift:] &= fits[:-shift] & (nearest[shift:] == nearest[:-shift])
            same[:shift] = False
        held = nearest[same]
        if len(held) and held.min() < held.max():
            return int(held.min()), int(held.max())
    return int(nearest.min()), int(nearest.max())


def _refitted(value: Array, states: IntArray, scale: PwmScale, *, fixed_step: bool) -> PwmScale:
    """Scale of the samples on their levels."""
    residual = value - scale.base - scale.step * states
    near = np.abs(residual) < max(4.0 * scale.noise, 0.5 * scale.quantum)
    near &= np.abs(residual) < 0.5 * scale.step
    if near.sum() < _FEWEST_SAMPLES:
        return scale
    step, base = scale.step, scale.base + float(np.mean(residual[near]))
    if not fixed_step and np.ptp(states[near]) > 0:
        step, base = (float(term) for term in np.polyfit(states[near], value[near], 1))
    left = value[near] - base - step * states[near]
    spread = max(1.4826 * float(np.median(np.abs(left))), 0.8 * float(np.std(left)))
    noise = max(spread, scale.quantum / math.sqrt(12.0), 1e-6 * step)
    return replace(scale, base=base, step=step, noise=noise)


@dataclass(slots=True)
class _Photos:
    """Rows of the result while they are gathered."""

    rows: list[tuple[float, float, int, int, int, float]] = field(default_factory=list)
    count: int = 0
    wraps: list[float] = field(default_factory=list)
    falls: list[float] = field(default_factory=list)
    unseen: list[float] = field(default_factory=list)


def _photos(time: Array, value: Array, states: IntArray, scale: PwmScale, rate: float) -> PwmIndex:
    """Photos of a path, with their times and how sure they are."""
    changes = changes_of(states)
    edges = np.concatenate([[0], changes, [len(states)]])
    usual = float(np.median(np.diff(time)))
    sure = plateau_confidence(time, value, states, edges, scale, rate)
    found = _Photos()
    for number, change in enumerate(changes):
        before, after = int(states[change - 1]), int(states[change])
        rise = (after - before) % scale.levels
        gap = float(time[change] - time[change - 1])
        expected = rate * gap
        if after < before and rise > 3 + expected + 4.0 * math.sqrt(expected):
            found.falls.append(float(time[change]))
            continue
        at, sigma = when_changed(time, value, edges[number : number + 3], (before, after), scale)
        if rise > 1 and gap > 1.5 * usual:
            # The last of several photos somewhere in the gap: an order statistic.
            at = float(time[change - 1]) + gap * rise / (rise + 1.0)
            sigma = gap * math.sqrt(rise / ((rise + 1.0) ** 2 * (rise + 2.0)))
        found.count += rise
        found.wraps += [at] if after < before else []
        found.unseen += [at] if rise > 1 else []
        confidence = sure[number] * sure[number + 1]
        found.rows.append((at, sigma, found.count, after, rise, confidence))
    return _index(found, value, states, scale)


def _index(found: _Photos, value: Array, states: IntArray, scale: PwmScale) -> PwmIndex:
    known = scale.wrap_known or len(found.wraps) > 1
    table = np.array(found.rows, dtype=float).reshape(-1, 6)
    confidence = np.clip(table[:, 5], 0.0, 1.0)
    if not known:
        # A single fall from the top may be a wrap, with a photo, or a restart, without one.
        confidence = np.where(np.isin(table[:, 0], found.wraps), 0.5 * confidence, confidence)
    residual = np.abs(value - scale.base - scale.step * states)
    return PwmIndex(
        time=table[:, 0],
        sigma=table[:, 1],
        count=table[:, 2].astype(np.int64),
        level=table[:, 3].astype(np.int64),
        steps=table[:, 4].astype(np.int64),
        confidence=confidence,
        scale=replace(scale, wrap_known=known),
        glitch_share=float(np.mean(residual > 5.0 * scale.noise)),
        doubts=tuple(_doubts(found, table, confidence, known=known)),
    )


def _doubts(found: _Photos, table: Array, confidence: Array, *, known: bool) -> list[str]:
    """What is doubtful, in sentences."""
    hidden = int(np.sum(table[:, 4] - 1))
    weak = int(np.sum(confidence < 0.9))
    told = {
        f"photos not seen: {hidden}; the index rose by two or more at "
        f"{_instants(found.unseen)}": hidden,
        f"the index fell without a wrap at {_instants(found.falls)}: the board restarted, and "
        "photos in between are unknown": found.falls,
        f"whether the index wrapped or the board restarted at {_instants(found.wraps)} cannot be "
        "told; give --levels": bool(found.wraps) and not known,
        f"ambiguous steps: {weak} of {len(table)}": weak,
    }
    return [sentence for sentence, wrong in told.items() if wrong]


def _instants(times: list[float]) -> str:
    shown = ", ".join(f"{at:.2f} s" for at in times[:5])
    return shown + (f" and {len(times) - 5} more" if len(times) > 5 else "")
