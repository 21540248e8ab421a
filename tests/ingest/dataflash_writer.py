"""Writes DataFlash logs, binary and text, as ArduPilot describes them (FMT first)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

_STRUCT = {"b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "n": "4s",
           "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "d": "d",
           "Q": "Q"}  # fmt: skip
_UNIT = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}

FORMATS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (64, "QNf", "TimeUS,Name,Value"),
    "GPS": (130, "QBBIHBcLLeffffB",
            "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    "GPA": (131, "QBCCCCfBIHf", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,Und"),
    "IMU": (132, "QBffffffIIfBBHH",
            "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "ATT": (133, "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF"),
    "BARO": (134, "QBffcfIffB", "TimeUS,I,Alt,Press,Temp,CRt,SMS,Offset,GndTemp,Health"),
    "MAG": (135, "QBhhhhhhhhhBI",
            "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"),
    "CAM": (136, "QBHIHLLeeeccC",
            "TimeUS,I,Img,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,R,P,Y"),
    "TRIG": (137, "QBHIHLLeeeccC",
             "TimeUS,I,Img,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,R,P,Y"),
    "ARSP": (138, "QBffcffBBfffB",
             "TimeUS,I,Airspeed,DiffPress,Temp,RawPress,Offset,U,H,Hp,TR,PV,Pri"),
}  # fmt: skip
# messages as firmware of 2014 wrote them, without TimeUS
OLD = {
    "FMT": FORMATS["FMT"],
    "GPS": (130, "BIHBcLLeeEefI",
            "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
    "IMU": (131, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (132, "IccccCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "CAM": (133, "IHLLeccC", "GPSTime,GPSWeek,Lat,Lng,Alt,Roll,Pitch,Yaw"),
}  # fmt: skip

Message = tuple[str, Sequence[object]]


def _packed(formats, name: str, values: Sequence[object]) -> bytes:
    number, form, _ = formats[name]
    fields = []
    for letter, value in zip(form, values, strict=True):
        if isinstance(value, str):
            fields.append(value.encode("ascii"))
        elif letter in _UNIT:
            fields.append(round(float(value) * _UNIT[letter]))
        else:
            fields.append(float(value) if letter in "fd" else int(value))
    body = struct.pack("<" + "".join(_STRUCT[c] for c in form), *fields)
    return bytes((0xA3, 0x95, number)) + body


def _descriptions(formats) -> list[Message]:
    out: list[Message] = []
    for name, (number, form, columns) in formats.items():
        length = 3 + struct.calcsize("<" + "".join(_STRUCT[c] for c in form))
        out.append(("FMT", (number, length, name, form, columns)))
    return out


def write_binary(path: Path, messages: Sequence[Message], formats=FORMATS) -> Path:
    every = [*_descriptions(formats), *messages]
    path.write_bytes(b"".join(_packed(formats, name, values) for name, values in every))
    return path


def write_text(path: Path, messages: Sequence[Message], formats=FORMATS) -> Path:
    every = [*_descriptions(formats), *messages]
    lines = [", ".join([name, *(str(v) for v in values)]) for name, values in every]
    path.write_text("\n".join(lines) + "\n")
    return path
