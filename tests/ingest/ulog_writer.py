"""Writes ULog files by the format's description (docs.px4.io, "ULog File Format")."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

_LETTER = {"uint64_t": "Q", "int32_t": "i", "uint32_t": "I", "float": "f", "double": "d",
           "uint8_t": "B", "int8_t": "b", "bool": "?", "uint16_t": "H"}  # fmt: skip


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def _split(form: str) -> list[tuple[str, str, int]]:
    """Type, name and count of each field of 'uint64_t timestamp;float[3] q'."""
    out = []
    for field in form.split(";"):
        kind, name = field.split(" ")
        base, _, count = kind.partition("[")
        out.append((base, name, int(count.rstrip("]")) if count else 1))
    return out


def write_ulog(
    path: Path,
    formats: Mapping[str, str],
    rows: Sequence[tuple[str, int, Sequence[object]]],
    dropouts: Mapping[int, int] | None = None,
) -> Path:
    """Rows of (topic, instance, values), arrays flat; `dropouts` is ms before a row's index."""
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    out.append(_message("B", bytes(40)))
    for name, form in formats.items():
        fields = ";".join(
            f"{kind}[{count}] {field}" if count > 1 else f"{kind} {field}"
            for kind, field, count in _split(form)
        )
        out.append(_message("F", f"{name}:{fields};".encode()))
    ids: dict[tuple[str, int], int] = {}
    for k, (name, instance, values) in enumerate(rows):
        if (name, instance) not in ids:
            ids[name, instance] = len(ids)
            body = struct.pack("<BH", instance, ids[name, instance]) + name.encode()
            out.append(_message("A", body))
        if dropouts and k in dropouts:
            out.append(_message("O", struct.pack("<H", dropouts[k])))
        letters = "".join(_LETTER[t] * n for t, _, n in _split(formats[name]))
        out.append(
            _message(
                "D", struct.pack("<H", ids[name, instance]) + struct.pack(f"<{letters}", *values)
            )
        )
    path.write_bytes(b"".join(out))
    return path
