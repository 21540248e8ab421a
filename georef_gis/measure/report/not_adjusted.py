"""Why the poses of a project are direct ones: the first thing its page has to say."""

from __future__ import annotations

import math

import numpy as np

from georef_gis.measure.report.draw import metres
from georef_gis.measure.report.facts import ADJUST, DONE, MATCH, Facts
from georef_gis.measure.report.page import Level, Text, Verdict

# reasons shown; all stand among the warnings
MOST_REASONS = 4
_DIRECT = "all poses are direct ones"


def not_adjusted_item(facts: Facts) -> Text:
    """What is said in place of an adjustment; heads the findings unless nothing was asked for."""
    level, told = _why(facts)
    if level != "told":
        told += f"; neighbouring photos may stand {metres(apart(facts))} apart at their seams"
    verdict = Verdict(level=level, text=told + ".", first=level != "told")
    return Text(title="No adjustment", lines=(), verdict=verdict)


def apart(facts: Facts) -> float:
    """One sigma of how far two photos that are not adjusted stand apart on the ground, m."""
    sigma = [f.sigma_horizontal for f in facts.footprints.values()]
    return math.sqrt(2.0) * float(np.median(sigma))


def _why(facts: Facts) -> tuple[Level, str]:
    if facts.quick:
        return "told", "A quick run stops at the direct result: nothing is adjusted"
    run, match = facts.run_of(ADJUST), facts.run_of(MATCH)
    if run is None:
        why = ""
        if match is not None and match["outcome"] != DONE:
            why = f" (the last matching {match['outcome']}: {match['message']})"
        level: Level = "look" if len(facts.footprints) > 1 else "told"
        return level, f"The photos were not adjusted to each other{why}: {_DIRECT}"
    if run["outcome"] != DONE:
        return "bad", f"The last adjustment {run['outcome']} ({run['message']}): {_DIRECT}"
    summary = run["summary"] or {}
    if summary.get("used"):
        return "bad", f"What the last adjustment left cannot be read: {_DIRECT}"
    reasons = [str(line) for line in summary.get("doubts", ())]
    if not reasons:
        level = "bad" if len(facts.footprints) > 1 else "told"
        return level, f"The last adjustment was not used: {_DIRECT}"
    some = "; ".join(reasons[-MOST_REASONS:])
    return "bad", f"The last adjustment was not used: {some}: {_DIRECT}"
