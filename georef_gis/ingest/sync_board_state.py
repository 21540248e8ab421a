"""What a live recording of a sync board has seen so far, in figures and sentences."""

from __future__ import annotations

from dataclasses import dataclass, field

from georef_gis.ingest.serial_port import BAUD_RATES
from georef_gis.ingest.sync_board import Framer, SequenceWatch
from georef_gis.ingest.tsb_line import TsbRecord
from georef_gis.units import gps_from_week, utc_from_gps


@dataclass(slots=True)
class Recording:
    """What was recorded so far."""

    bytes_read: int = 0
    triggers: int = 0
    without_gps_time: int = 0
    interruptions: int = 0
    away_s: float = 0.0
    wrong_baud: bool = False
    connected: bool = False
    last: TsbRecord | None = None
    framer: Framer = field(default_factory=Framer)
    sequence: SequenceWatch = field(default_factory=SequenceWatch)

    def last_time(self) -> str:
        """Time of the last trigger, for people."""
        if self.last is None:
            return "none yet"
        if not self.last.has_gps_time:
            return f"{self.last.tow_s:.1f} s, no GPS time"
        instant = utc_from_gps(gps_from_week(self.last.gps_week, self.last.tow_s))
        return f"{instant:%H:%M:%S}.{instant.microsecond // 100_000} UTC"

    def line(self) -> str:
        """State in one short line."""
        state = "" if self.connected else "PORT GONE, "
        return f"{state}{self.triggers} triggers, last {self.last_time()}"

    def doubts(self, baud: int) -> list[str]:
        """What was wrong, in sentences; empty for a flawless recording."""
        framer, sequence = self.framer, self.sequence
        others = ", ".join(f"{count} of {name}" for name, count in framer.talkers.most_common(4))
        restarts, away = sequence.restarts, self.interruptions
        told = {
            f"triggers missing by their counter: {sequence.lost}": sequence.lost,
            f"lines with a wrong checksum or content, left out: {framer.frames['damaged']}":
                framer.frames["damaged"],
            f"lines begun and not ended: {framer.partial}": framer.partial,
            f"bytes that belong to no line: {framer.garbage}": framer.garbage,
            f"the board restarted its counter; times: {restarts}": restarts,
            f"triggers that came twice: {sequence.repeated}": sequence.repeated,
            f"triggers that lie before the one before: {sequence.backwards}": sequence.backwards,
            f"triggers without GPS time: {self.without_gps_time} of {self.triggers}":
                self.without_gps_time,
            f"the port was gone for {self.away_s:.1f} s; times: {away}": away,
            baud_advice(baud): self.wrong_baud and not self.triggers,
            f"other devices talk on this port: {others}": bool(others),
            "no trigger arrived": not self.triggers,
        }  # fmt: skip
        return [sentence for sentence, wrong in told.items() if wrong]


def baud_advice(baud: int) -> str:
    """Sentence on a wrong baud rate, with those to try."""
    rates = ", ".join(str(rate) for rate in BAUD_RATES if rate != baud)
    return f"what arrives cannot be read: {baud} Bd seems wrong; try --baud {rates}"
