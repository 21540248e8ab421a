"""A line of what `georef doctor` finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# "absent" is no fault: less can be done without it.
State = Literal["ok", "absent", "doubtful", "bad"]
SIGNS: dict[State, str] = {"ok": "ok  ", "absent": "--  ", "doubtful": "??  ", "bad": "BAD "}


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One line of the examination."""

    subject: str
    state: State
    message: str

    def line(self) -> str:
        """Text for a terminal."""
        return f"{SIGNS[self.state]}{self.subject:<24} {self.message}"

    def content(self) -> dict[str, str]:
        """JSON-able content."""
        return {"subject": self.subject, "state": self.state, "message": self.message}
