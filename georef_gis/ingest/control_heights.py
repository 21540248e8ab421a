"""Heights of control points: in which unit and of which kind, where the file does not say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.units import INTERNATIONAL_FOOT

# sigmas; a reading beyond the first cannot be right, one within the second may be
_REFUTED, _FITS = 5.0, 3.0
# m; relief and survey beside the sigma of the ground
_RELIEF = 3.0
# m; where the geoid lies this near the ellipsoid, the kind makes no difference
_SAME = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heights:
    """Ellipsoidal heights, m, NaN for none; shape (n,). What they were taken for, and doubts."""

    ellipsoidal: Array
    kind: HeightKind
    doubts: tuple[str, ...] = ()

    @classmethod
    def none(cls, z: Array, doubt: str) -> Heights:
        """No heights at all, and why."""
        empty = np.full(len(z), np.nan)
        return cls(ellipsoidal=empty, kind=HeightKind.UNKNOWN, doubts=(doubt,))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reading:
    kind: HeightKind
    scale: float
    h: Array
    # median of height minus ground over its sigma
    off: float
    metres: float


def settle_heights(
    z: Array,
    undulation: Array,
    ground: Array,
    *,
    sigma_ground: float,
    kind: HeightKind,
    unit: float | None,
    source: str,
) -> Heights:
    """Ellipsoidal heights of points.

    Where kind or unit are not stated, the ground under the points decides if it can: one reading
    refuted beyond 5 sigmas, another within 3. Otherwise heights are not used rather than guessed.

    Parameters
    ----------
    z, undulation, ground : shape (n,)
        Heights as written (m where `unit` is known), geoid above the ellipsoid and ground above
        it, m; NaN for none.
    sigma_ground
        One sigma of the level of the ground, m.
    """
    if not np.any(np.isfinite(z)):
        return Heights(ellipsoidal=np.full(len(z), np.nan), kind=kind)
    if kind is HeightKind.ABOVE_GROUND:
        return Heights.none(z, f"{source}: height: above ground is no place; used without height")
    sigma = float(np.hypot(sigma_ground, _RELIEF))
    stated = _readings(z, undulation, ground, kind, 1.0, sigma)
    if np.nanmax(np.abs(undulation), initial=0.0) < _SAME and len(stated) > 1:
        stated = stated[:1]
    # Feet taken for metres, or metres taken for feet
    in_metres = unit is None or unit > 0.9
    other = INTERNATIONAL_FOOT if in_metres else 1.0 / INTERNATIONAL_FOOT
    wrong_unit = _readings(z, undulation, ground, kind, other, sigma)
    told = f"median height {np.nanmedian(z):.1f}, ground {np.nanmedian(ground):.1f} m above the " \
           "ellipsoid" if np.any(np.isfinite(ground)) else ""  # fmt: skip
    fits = [r for r in stated if not r.off > _FITS]
    refuted = all(r.off > _REFUTED for r in stated)
    better = [r for r in wrong_unit if r.off < _FITS]
    if refuted and better:
        read, said = ("feet", "metres") if in_metres else ("metres", "feet")
        if unit is not None:
            words = f"they fit in {read}, but {said} are stated; used without height"
            return Heights.none(z, f"{source}: height: {told}: {words}: correct the unit")
        words = f"{source}: height: {told}: taken as feet; state [control] height_unit"
        return _chosen(better, words, z, source, told)
    if len(stated) == 1:
        only = stated[0]
        if not only.off > _REFUTED:
            return Heights(ellipsoidal=only.h, kind=only.kind)
        words = f"{source}: height: {_told_of(only, z, ground)}; check kind and unit"
        return Heights(ellipsoidal=only.h, kind=only.kind, doubts=(words,))
    sure = [r for r in fits if all(o is r or o.off > _REFUTED for o in stated)]
    return _chosen(sure, "", z, source, told)


def _told_of(read: _Reading, z: Array, ground: Array) -> str:
    """Heights of one kind against the ground, both above the ellipsoid."""
    as_read = f"{np.nanmedian(read.h):.1f} m above the ellipsoid"
    return (
        f"median height {np.nanmedian(z):.1f} ({read.kind}) is {as_read}, {abs(read.metres):.0f} m "
        f"{'above' if read.metres > 0 else 'below'} the ground at {np.nanmedian(ground):.1f} m"
    )


def _chosen(some: list[_Reading], words: str, z: Array, source: str, told: str) -> Heights:
    if len(some) == 1:
        one = some[0]
        kind = f"{source}: height: kind not stated; taken as {one.kind}, as the ground lies"
        lines = [words] if words else [f"{kind}; state [control] height_kind"]
        return Heights(ellipsoidal=one.h, kind=one.kind, doubts=tuple(lines))
    return Heights.none(
        z,
        f"{source}: height: the kind of the heights is not stated and the ground does not tell it"
        f"{f' ({told})' if told else ''}; used without height: state [control] height_kind",
    )


def _readings(
    z: Array, undulation: Array, ground: Array, kind: HeightKind, scale: float, sigma: float
) -> list[_Reading]:
    kinds = (
        [HeightKind.ORTHOMETRIC, HeightKind.ELLIPSOIDAL] if kind is HeightKind.UNKNOWN else [kind]
    )
    out = []
    for one in kinds:
        h = z * scale + (undulation if one is HeightKind.ORTHOMETRIC else 0.0)
        both = np.isfinite(h) & np.isfinite(ground)
        metres = float(np.median(h[both] - ground[both])) if both.any() else np.nan
        out.append(_Reading(kind=one, scale=scale, h=h, off=abs(metres) / sigma, metres=metres))
    return out
