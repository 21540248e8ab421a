"""Marks of people as arrays, those that can be used, and one line on each of the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.scene import Scene
from georef_gis.model.control import Mark
from georef_gis.model.photo_stack import Ints

OnFail = Literal["raise", "skip"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Clicks:
    """Marks of m pixels: names, photo (m,) index, uv (m, 2) px.

    `sigma` (m,) px is each mark's own, `shared` (m,) px what it has in common with others of its
    point; `number` (m,) counts the marks as they were given.
    """

    marks: tuple[Mark, ...]
    number: Ints
    photo: Ints
    uv: Array
    sigma: Array
    shared: Array

    def __len__(self) -> int:
        """Number of marks."""
        return len(self.marks)

    def where(self, good: NDArray[np.bool_]) -> Clicks:
        """Some of them."""
        return Clicks(
            marks=tuple(m for m, keep in zip(self.marks, good, strict=True) if keep),
            number=self.number[good],
            photo=self.photo[good],
            uv=self.uv[good],
            sigma=self.sigma[good],
            shared=self.shared[good],
        )

    @property
    def whole(self) -> Array:
        """One sigma of each mark taken alone; (m,) px."""
        return np.hypot(self.sigma, self.shared)

    @property
    def names(self) -> tuple[str, ...]:
        """Names; a mark without one has its number, from 1."""
        return tuple(m.name or str(i + 1) for m, i in zip(self.marks, self.number, strict=True))


def where_of(mark: Mark) -> str:
    """File and line of a mark, where it has them, and its name, each with a colon."""
    return "".join(f"{part}: " for part in (mark.source, mark.name) if part)


def told(mark: Mark, why: str) -> str:
    """One line on what is wrong with a mark."""
    return f"{where_of(mark)}photo {mark.photo}: pixel ({mark.u:.7g}, {mark.v:.7g}) {why}"


def clicks_of(scene: Scene, marks: Sequence[Mark]) -> tuple[Clicks, dict[int, str]]:
    """Marks that lie in photos of the scene, and why the others do not, by their number."""
    refused: dict[int, str] = {}
    numbers = np.zeros(len(marks), dtype=np.int64)
    for i, mark in enumerate(marks):
        try:
            numbers[i] = scene.number(mark.photo)
        except GeometryError as error:
            refused[i] = f"{where_of(mark)}{error}"
        for sigma in (mark.sigma_px, mark.shared_px):
            if not (math.isfinite(sigma) and sigma >= 0.0):
                refused[i] = told(mark, f"has a sigma of {sigma} px; give one >= 0")
    uv = np.array([[mark.u, mark.v] for mark in marks], dtype=np.float64).reshape(-1, 2)
    inside = scene.photos.contains(numbers, uv)
    for k in (int(i) for i in np.flatnonzero(~inside)):
        camera = scene.photos.photos[numbers[k]].camera
        why = f"lies outside {camera.width} x {camera.height} px; click within the photo"
        refused.setdefault(k, told(marks[k], why))
    good = np.array([i not in refused for i in range(len(marks))], dtype=bool)
    clicks = Clicks(
        marks=tuple(marks),
        number=np.arange(len(marks)),
        photo=numbers,
        uv=uv,
        sigma=np.array([mark.sigma_px for mark in marks], dtype=np.float64),
        shared=np.array([mark.shared_px for mark in marks], dtype=np.float64),
    )
    return clicks.where(good), refused


def raise_first(refused: dict[int, str], on_fail: OnFail) -> None:
    """Raise the first of the lines, unless what fails is to be skipped.

    Raises
    ------
    GeometryError
        If there is one.
    """
    if refused and on_fail == "raise":
        raise GeometryError(refused[min(refused)])
