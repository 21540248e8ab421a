"""Text in tables that spreadsheets open."""

from __future__ import annotations

# With these a spreadsheet takes a text for a formula, or drops what stands before one. An
# apostrophe is among them so that the first one can be taken away again.
GUARDED = ("=", "+", "-", "@", "\t", "\r", "\n", "'", "＝", "＋", "－", "＠")
GUARD = "'"


def guarded(text: str) -> str:
    """Text that no spreadsheet takes for a formula: an apostrophe stands before such a one."""
    return GUARD + text if text.startswith(GUARDED) else text


def unguarded(text: str) -> str:
    """The text that `guarded` was given."""
    return text.removeprefix(GUARD)
