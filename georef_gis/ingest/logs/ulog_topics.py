"""Topics of a ULog file as columns, by pyulog."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.logs import unknown


@dataclass(slots=True)
class UlogFile:
    """Topics of a file by name, and what was doubtful on the way."""

    path: Path
    topics: Mapping[str, list[tuple[int, Mapping[str, Any]]]]
    doubts: list[str] = field(default_factory=list)

    def longest(self, name: str) -> Topic | None:
        """Instance of a topic with the most rows; `used` names the choice."""
        held = [(n, d) for n, d in self.topics.get(name, []) if len(d["timestamp"])]
        if not held:
            return None
        instance, data = max(held, key=lambda item: len(item[1]["timestamp"]))
        return Topic(name=f"{name}[{instance}]", data=data, instances=len(held))

    def used(self, topic: Topic) -> None:
        """Say which of several instances a log is made of."""
        if topic.instances > 1:
            self.doubts.append(
                f"{topic.name} of {topic.instances} instances is used, it has the most rows"
            )


@dataclass(frozen=True, slots=True)
class Topic:
    """One instance of a topic: its fields as columns."""

    name: str
    data: Mapping[str, Any]
    instances: int = 1

    @property
    def time(self) -> Array:
        """Boot time, s."""
        return np.asarray(self.data["timestamp"], dtype=np.float64) * 1e-6

    def __len__(self) -> int:
        """Rows."""
        return len(self.data["timestamp"])

    @property
    def rate(self) -> float:
        """Rows per second."""
        return (len(self) - 1) / max(1e-6, float(np.ptp(self.time)))

    def column(self, *names: str) -> Array | None:
        """First of the named fields that is there, as it is written."""
        found = next((n for n in names if n in self.data), None)
        return None if found is None else np.asarray(self.data[found], dtype=np.float64)

    def columns(self, name: str, count: int = 3) -> Array | None:
        """Fields `name[0]` .. as rows of one array."""
        names = [f"{name}[{k}]" for k in range(count)]
        if not all(n in self.data for n in names):
            return None
        return np.column_stack([np.asarray(self.data[n], dtype=np.float64) for n in names])

    def scaled(self, real: str, whole: str, unit: float) -> Array | None:
        """Field that newer firmware writes as `real`, older as whole numbers of `unit`."""
        if real in self.data:
            return self.column(real)
        if whole not in self.data:
            return None
        values = np.asarray(self.data[whole])
        return np.asarray(values * (unit if values.dtype.kind in "iu" else 1.0), dtype=np.float64)

    def or_nan(self, *names: str) -> Array:
        """Like `column`, NaN where there is none."""
        values = self.column(*names)
        return unknown(len(self)) if values is None else values


def open_ulog(path: Path) -> UlogFile:
    """Topics of a file, with damage and dropouts named.

    Raises
    ------
    InputError
        If pyulog is missing or cannot read the file.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise InputError("needs pyulog; pip install georef-gis[logs]", source=str(path)) from error
    said = io.StringIO()
    try:
        # pyulog prints what it stumbles over; its findings are named below
        with (
            path.open("rb") as stream,
            contextlib.redirect_stdout(said),
            np.errstate(all="ignore"),
        ):
            log = ULog(stream)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    except Exception as error:
        raise InputError(
            f"is no complete ULog ({str(error)[:80] or type(error).__name__}); copy the file from "
            "the autopilot again",
            source=str(path),
        ) from error
    topics: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
    for data in log.data_list:
        topics.setdefault(data.name, []).append((int(data.multi_id), data.data))
    file = UlogFile(path=path, topics=topics)
    if log.file_corruption:
        file.doubts.append("the file is damaged: pyulog left parts of it out")
    if log.dropouts:
        lost = [d.duration * 1e-3 for d in log.dropouts]
        first = log.dropouts[0].timestamp * 1e-6
        file.doubts.append(
            f"{len(lost)} dropout(s) of the logger, {sum(lost):.2f} s in all, longest "
            f"{max(lost):.2f} s, first {first:.1f} s after boot"
        )
    return file
