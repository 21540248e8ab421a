"""The line of the time-synchronisation board: `$TSB,seq,gps_week,tow_s,pulse_us,flags*CS`.

CS is the exclusive or of the characters between `$` and `*`, two hexadecimal digits, as in
NMEA 0183. One line per trigger, closed by CR LF, 8 bits, no parity, 115 200 baud.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import reduce
from operator import xor

from georef_gis.units import GPS_WEEK

# Bit of `flags` that says that the board's clock is disciplined by GPS.
TSB_FLAG_GPS_TIME = 1

_BODY = re.compile(
    rb"TSB,(\d{1,10}),(\d{1,5}),(\d{1,6}(?:\.\d{0,9})?),(\d{1,7}(?:\.\d{0,6})?),(\d{1,5})"
)
_WHOLE = re.compile(rb"\$([^$*]*)\*([0-9A-Fa-f]{2})[\s\x00]*$")


@dataclass(frozen=True, slots=True, kw_only=True)
class TsbRecord:
    """One trigger.

    Parameters
    ----------
    seq
        Counter of triggers; it may wrap.
    gps_week, tow_s
        GPS week and second of the week, s, of the trigger; 0 and s since power-up before the
        first fix.
    pulse_us
        Width of the shutter pulse, us.
    flags
        Bits; `TSB_FLAG_GPS_TIME` says that the time is of GPS.
    """

    seq: int
    gps_week: int
    tow_s: float
    pulse_us: float
    flags: int

    @property
    def has_gps_time(self) -> bool:
        """Whether the board says that its clock is disciplined by GPS."""
        return bool(self.flags & TSB_FLAG_GPS_TIME)


def tsb_checksum(body: bytes) -> int:
    """Exclusive or of all characters between `$` and `*`."""
    return reduce(xor, body, 0)


def parse_tsb_line(line: bytes) -> TsbRecord | None:
    """Record of one line, or None if the line is damaged or something else.

    What stands before the last `$` of the line is left out: a broken frame ends where the next
    begins.
    """
    whole = _WHOLE.search(line)
    if whole is None or tsb_checksum(whole[1]) != int(whole[2], 16):
        return None
    body = _BODY.fullmatch(whole[1])
    if body is None:
        return None
    record = TsbRecord(
        seq=int(body[1]),
        gps_week=int(body[2]),
        tow_s=float(body[3]),
        pulse_us=float(body[4]),
        flags=int(body[5]),
    )
    # 604800.000000 is what rounding makes of the last microsecond of a week.
    return record if record.tow_s <= GPS_WEEK else None


def format_tsb_line(record: TsbRecord) -> bytes:
    """Line of a record, with checksum and CR LF; times to 1 us."""
    pulse = f"{record.pulse_us:.3f}".rstrip("0").rstrip(".")
    body = f"TSB,{record.seq},{record.gps_week},{record.tow_s:.6f},{pulse},{record.flags}".encode()
    return b"$" + body + f"*{tsb_checksum(body):02X}\r\n".encode()
