"""Findings of the screening as rows and as text, in feet and metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_args

from georef_gis.measure.workzone.rules import Rules
from georef_gis.measure.workzone.verdicts import CERTAIN, Finding, Verdict
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

DISCLAIMER = (
    "Screening of measured positions, not a statement of compliance: an engineer judges the zone."
)
COLUMNS = (
    "check", "subject", "verdict", "probability", "value_ft", "sigma_ft", "low_ft", "high_ft",
    "sigma_needed_ft", "value_m", "sigma_m", "source", "note",
)  # fmt: skip


def finding_rows(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """A row per finding; an empty text where there is no limit."""
    return [
        {
            "check": one.check,
            "subject": one.subject,
            "verdict": one.verdict,
            "probability": round(one.probability, 4),
            **{f"{name}_ft": _feet(getattr(one, name))
               for name in ("value", "sigma", "low", "high", "sigma_needed")},
            "value_m": round(one.value, 4),
            "sigma_m": round(one.sigma, 4),
            "source": one.source,
            "note": one.note,
        }
        for one in findings
    ]  # fmt: skip


def count_verdicts(findings: Sequence[Finding]) -> dict[str, int]:
    """How often each answer was given, parts of findings apart."""
    main = [one.verdict for one in findings if not one.part]
    return {word: main.count(word) for word in get_args(Verdict)}


def screening_text(findings: Sequence[Finding], rules: Rules, speed_mph: float, basis: str) -> str:
    """Account of a screening: the answers, and what they rest on.

    Parameters
    ----------
    basis
        What the covariance of the positions rests on.
    """
    lines = [
        DISCLAIMER,
        f"Against: {rules.title}. {rules.note}".strip(),
        f"Speed: {speed_mph:g} mph. Pass: what is asked for is met with a probability of "
        f"{CERTAIN:.0%} or more; fail: a limit is missed with as much.",
        f"Covariance of the positions: {basis}.",
        ", ".join(f"{word}: {n}" for word, n in count_verdicts(findings).items()),
        "",
    ]
    for one in findings:
        if not one.part:
            lines.append(sentence(one))
        elif one.verdict != "pass":
            lines.append("    " + sentence(one))
    sources = dict.fromkeys(one.source for one in findings if one.source)
    lines += ["", "Sources", *(f"- {source}" for source in sources)]
    return "\n".join(lines) + "\n"


def sentence(one: Finding) -> str:
    """One finding in a line."""
    told = (
        f"{one.verdict.upper()}: {one.check} of {one.subject}: {one.value / FOOT:.1f} ft "
        f"(sigma {one.sigma / FOOT:.2f} ft), {_required(one)}, probability "
        f"{one.probability:.3f}"
    )
    if one.verdict == "cannot tell":
        told += (
            f"; an answer needs a sigma of {one.sigma_needed / FOOT:.2f} ft or less"
            if one.sigma_needed > 0
            else "; it lies on the limit, where no accuracy gives an answer"
        )
    return told + (f" [{one.note}]" if one.note else "")


def _required(one: Finding) -> str:
    low, high = one.low / FOOT, one.high / FOOT
    if math.isfinite(low) and low > 0 and math.isfinite(high):
        return f"{low:.1f} to {high:.1f} ft asked for"
    if math.isfinite(high):
        return f"at most {high:.1f} ft asked for"
    return f"at least {low:.1f} ft asked for"


def _feet(metres: float) -> float | str:
    return round(metres / FOOT, 3) if math.isfinite(metres) else ""
