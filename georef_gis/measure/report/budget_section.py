"""The error budget: what the error of a place is made of, and what to work on first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from georef_gis.measure.budget.plots import budget_figure
from georef_gis.measure.budget.shares import COUPLED, SOURCES, PointBudget, Remedy
from georef_gis.measure.budget.table import ADVICE, height_line
from georef_gis.measure.report.draw import few, metres, plural, png
from georef_gis.measure.report.page import Item, Lines, Picture, Table, Text, Verdict, judged

# times the usual error from which a photo is named
FAR = 3.0
# of the variance; a source that words in project.toml cure should not give more
CURABLE = 0.25
_CURED_BY_WORDS = ("datum", "lever_arm")
# photos of the table, the worst
MOST_PHOTOS = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Budget:
    """Error budget of the photos.

    Parameters
    ----------
    each
        Of photos that look at the ground; `of` is how many there are in all.
    whole
        The usual one; `found` is what reducing its sources brings, the best first.
    """

    whole: PointBudget
    each: Sequence[PointBudget]
    found: Sequence[Remedy]
    of: int
    notes: tuple[str, ...] = ()


def budget_items(budget: Budget | None, why: str = "") -> list[Item]:
    """Picture and tables; or why there are none, which asks for a look."""
    if budget is None:
        if why:
            return [Text(title="No error budget", lines=(), verdict=judged(why, fine=False))]
        return [Text(lines=("There is no error budget.",))]
    items: list[Item] = [_picture(budget), _sources(budget), _first(budget), _photos(budget)]
    if budget.notes:
        items.append(Lines(title="Not taken apart", lines=budget.notes))
    return items


def _picture(budget: Budget) -> Picture:
    figure = budget_figure(budget.whole, budget.found, budget.each, title="")
    return Picture(
        title="Sources of error",
        data=png(figure),
        alt="Bars of the sources of error, of what reducing them brings, and of every photo",
        look="One sigma of the place of a pixel on the ground, on average over a photo; squares of "
        "the sources add to the square of the whole. Photos should be alike.",
        verdict=_told(budget),
    )


def _told(budget: Budget) -> Verdict:
    whole = budget.whole
    names = [source for source in whole.by_source if source not in COUPLED]
    most = max(names, key=lambda source: float(whole.variance(source)[:2].mean()))
    total = float(whole.variance()[:2].mean())
    share = float(whole.variance(most)[:2].mean()) / total if total > 0 else 0.0
    told = f"a place is usually known to {metres(whole.horizontal())} per axis, {share:.0%} of the "
    told += f"variance by {SOURCES[most]}; {height_line(whole)}."
    cheap = [s for s in _CURED_BY_WORDS if s in names and _share(whole, s) > CURABLE]
    if cheap:
        told += f" To cure at once: {'; '.join(ADVICE[s] for s in cheap)}."
        return judged(told, fine=False)
    return Verdict(level="told", text=told)


def _share(budget: PointBudget, source: str) -> float:
    total = float(budget.variance()[:2].mean())
    return float(budget.variance(source)[:2].mean()) / total if total > 0 else 0.0


def _sources(budget: Budget) -> Table:
    whole = budget.whole
    rows = [
        (
            SOURCES[source], *(metres(float(v)) for v in whole.sigma(source)),
            # + 0.0 takes the sign off a zero
            metres(whole.horizontal(source)), f"{round(_share(whole, source), 2) + 0.0:.0%}",
        )
        for source in whole.by_source
    ]  # fmt: skip
    together = (metres(float(v)) for v in whole.sigma())
    rows.append(("together", *together, metres(whole.horizontal()), "100%"))
    return Table(
        title="Error budget by source", rows=rows,
        columns=("Source", "σ east", "σ north", "σ up", "σ per axis in plan", "Share"),
        look="Usual photo: the mean over the middle 80 % of the photos by their error. A coupling "
        "of two sources may be negative. `georef error-budget` gives the same for every photo, "
        "point or asset.",
    )  # fmt: skip


def _first(budget: Budget) -> Table:
    rows = [
        (
            SOURCES[r.source], metres(r.sigma), f"{r.share:.0%}", metres(r.reduced_to),
            metres(r.without), ADVICE[r.source],
        )
        for r in budget.found[:6]
    ]  # fmt: skip
    best = budget.found[0] if budget.found else None
    told = "there is nothing to reduce."
    if best is not None and best.now > 0:
        told = f"{SOURCES[best.source]}: reduced to {best.factor:.0%}, {metres(best.now)} become "
        told += f"{metres(best.reduced_to)} ({ADVICE[best.source]})."
    return Table(
        title="What to fix first", rows=rows, words=(0, 5),
        columns=("Source", "σ now", "Share", "Whole if halved", "Whole if gone", "How"),
        look="Sources by what reducing each brings.",
        verdict=Verdict(level="told", text=told),
    )  # fmt: skip


def _photos(budget: Budget) -> Table:
    usual = budget.whole.horizontal()
    worst = sorted(budget.each, key=lambda one: -one.horizontal())
    far = [one.name for one in worst if one.horizontal() > FAR * usual]
    rows = [
        (
            one.name, one.pose_kind, metres(one.horizontal()), metres(float(one.sigma()[2])),
            SOURCES[_largest(one)], metres(one.horizontal(_largest(one))),
        )
        for one in worst[:MOST_PHOTOS]
    ]  # fmt: skip
    told = f"{plural(len(far), 'photo')} beyond {FAR:g} times the usual error"
    told += f": {few(far)}" if far else ""
    if len(budget.each) < budget.of:
        told += f"; {len(budget.each)} of {budget.of} photos, evenly chosen, stand for all"
    return Table(
        title="Photos with the largest errors", rows=rows, words=(0, 1, 4),
        columns=("Photo", "Pose", "σ per axis in plan", "σ up", "Most by", "σ of that"),
        look="No photo should be far worse than the rest.",
        verdict=judged(told + ".", fine=not far, bad=len(far) > 0.3 * max(len(budget.each), 1)),
    )  # fmt: skip


def _largest(budget: PointBudget) -> str:
    names = [source for source in budget.by_source if source not in COUPLED]
    return max(names, key=lambda source: float(budget.variance(source)[:2].mean()))
