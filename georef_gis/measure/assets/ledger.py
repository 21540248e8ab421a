"""What is written down about every edit: before and after, in steps that can be undone.

A step is a group of edits that are undone together. Edits that another program made in the layers
are found by comparing them with what was last known, and become steps too. The functions below run
inside a transaction of the file.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from dataclasses import dataclass, replace

from georef_gis.measure.assets.asset import EDITED
from georef_gis.measure.assets.domain import Domain
from georef_gis.measure.assets.file import AssetFile
from georef_gis.measure.assets.tables import (
    CLICK_COLUMNS,
    ELLIPSES,
    LAYERS,
    QUALITY_COLUMNS,
    SHAPE_OF,
    Row,
    asset_of,
    content_of,
    ellipse_wkb,
    row_in,
)
from georef_gis.project.asset_layers import same_place

DONE, UNDONE, DROPPED = "done", "undone", "dropped"
OUTSIDE = "edited in another program"
_MEASURED = (*QUALITY_COLUMNS, *CLICK_COLUMNS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What is known of an asset; `content` is None after it was deleted."""

    id: str
    revision: int
    layer: str
    fid: int
    content: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Edits that are done and undone together.

    Parameters
    ----------
    state
        "done", "undone" (may be redone) or "dropped" (undone, then something else was done).
    asset_ids
        What it changed.
    """

    number: int
    title: str
    at: str
    state: str
    asset_ids: tuple[str, ...]


class Ledger:
    """Edits of one file; `unit` is m per CRS unit."""

    def __init__(self, file: AssetFile, domain: Domain, unit: float) -> None:
        self.file = file
        self.domain = domain
        self.unit = unit

    # -- what is known ---------------------------------------------------------------------------

    def known(self, asset_id: str) -> Known | None:
        """What is known of an asset."""
        return next(self._known("WHERE asset_id = ?", (asset_id,)), None)

    def all_known(self) -> dict[str, Known]:
        """What is known of all assets, deleted ones too."""
        return {one.id: one for one in self._known()}

    def _known(self, where: str = "", values: tuple[str, ...] = ()) -> Iterator[Known]:
        found = self.file.execute(
            f"SELECT asset_id, revision, layer, fid_in_layer, content FROM asset_known {where}",
            values,
        )
        for asset_id, revision, layer, fid, content in found.fetchall():
            yield Known(id=asset_id, revision=revision, layer=layer, fid=fid, content=content)

    # -- writing ---------------------------------------------------------------------------------

    def begin(self, title: str, at: str) -> Step:
        """Start a step: what was undone before can no longer be redone."""
        self.file.execute("UPDATE asset_history SET state = ? WHERE state = ?", (DROPPED, UNDONE))
        last = self.file.execute("SELECT coalesce(max(step), 0) FROM asset_history").fetchone()[0]
        return Step(number=int(last) + 1, title=title, at=at, state=DONE, asset_ids=())

    def put(self, step: Step, asset_id: str, layer: str, row: Row | None) -> None:
        """Make the row of an asset this one (None = delete it), and write it down."""
        known = self.known(asset_id)
        before = known.content if known else None
        after = self._apply(asset_id, layer, row, known)
        self._note(step, asset_id, layer, before, after)

    def _apply(self, asset_id: str, layer: str, row: Row | None, known: Known | None) -> str | None:
        fid = known.fid if known else None
        if row is None:
            assert fid is not None
            self.file.delete(layer, fid)
        else:
            fid = self._free(layer, fid, asset_id)
            fid = self.file.write(layer, fid, row)
        return self._remember(asset_id, layer, fid, known)

    def _free(self, layer: str, fid: int | None, asset_id: str) -> int | None:
        """The fid, unless another row has taken it since."""
        there = None if fid is None else self.file.row(layer, fid)
        return None if there is not None and there.get("asset_id") != asset_id else fid

    def _remember(self, asset_id: str, layer: str, fid: int, known: Known | None) -> str | None:
        """Note the row as it is in the file now."""
        row = self.file.row(layer, fid)
        # A row of another asset may have got the fid of one that was deleted.
        mine = row is not None and row.get("asset_id") == asset_id
        content = content_of(row) if row is not None and mine else None
        revision = known.revision + 1 if known else 1
        self.file.execute(
            "INSERT INTO asset_known (asset_id, revision, layer, fid_in_layer, content) "
            "VALUES (?, ?, ?, ?, ?) ON CONFLICT (asset_id) DO UPDATE SET revision = "
            "excluded.revision, layer = excluded.layer, fid_in_layer = excluded.fid_in_layer, "
            "content = excluded.content",
            (asset_id, revision, layer, fid, content),
        )
        self._draw_ellipse(asset_id, layer, row if mine else None)
        return content

    def _draw_ellipse(self, asset_id: str, layer: str, row: Row | None) -> None:
        if layer != LAYERS["point"].name:
            return
        self.file.execute(f"DELETE FROM {ELLIPSES.name} WHERE asset_id = ?", (asset_id,))
        if row is None:
            return
        asset = asset_of(row, "point", 0, self.domain)
        wkb = ellipse_wkb(asset, self.unit)
        if wkb is None or asset.quality is None:
            return
        q = asset.quality
        values = {"asset_id": asset_id, "class": asset.kind, "name": asset.name, "conf": q.conf,
                  "semi_major": q.semi_major, "semi_minor": q.semi_minor, "azimuth": q.azimuth,
                  "geom": wkb}  # fmt: skip
        self.file.write(ELLIPSES.name, None, values)

    def _note(
        self, step: Step, asset_id: str, layer: str, before: str | None, after: str | None
    ) -> None:
        self.file.execute(
            "INSERT INTO asset_history (step, state, title, at, asset_id, layer, before, after) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (step.number, DONE, step.title, step.at, asset_id, layer, before, after),
        )

    # -- undoing ---------------------------------------------------------------------------------

    def undo(self) -> Step | None:
        """Take the last step back; None if there is none."""
        return self._turn("max(step)", DONE, UNDONE)

    def redo(self) -> Step | None:
        """Do the step again that was undone last; None if there is none."""
        return self._turn("min(step)", UNDONE, DONE)

    def _turn(self, which: str, state: str, new: str) -> Step | None:
        number = self.file.execute(
            f"SELECT {which} FROM asset_history WHERE state = ?", (state,)
        ).fetchone()[0]
        if number is None:
            return None
        back = new == UNDONE
        edits = self.file.execute(
            "SELECT asset_id, layer, before, after FROM asset_history WHERE step = ? "
            f"ORDER BY fid {'DESC' if back else 'ASC'}",
            (number,),
        ).fetchall()
        for asset_id, layer, before, after in edits:
            wanted = before if back else after
            known = self.known(asset_id)
            row = None if wanted is None else row_in(wanted)
            if row is None and (known is None or known.content is None):
                continue
            self._apply(asset_id, layer, row, known)
        self.file.execute("UPDATE asset_history SET state = ? WHERE step = ?", (new, number))
        return self._steps("WHERE step = ?", number)[0]

    def steps(self, most: int = 1_000_000) -> list[Step]:
        """Steps, the last first."""
        last = self.file.execute("SELECT coalesce(max(step), 0) FROM asset_history").fetchone()[0]
        return self._steps("WHERE step > ?", int(last) - most)

    def _steps(self, where: str, value: int) -> list[Step]:
        found = self.file.execute(
            f"SELECT step, title, at, state, asset_id FROM asset_history {where} ORDER BY fid",
            (value,),
        ).fetchall()
        ids: dict[int, list[str]] = {}
        about = {}
        for number, title, at, state, asset_id in found:
            ids.setdefault(number, []).append(asset_id)
            about[number] = (title, at, state)
        return [
            Step(number=number, title=title, at=at, state=state, asset_ids=tuple(ids[number]))
            for number, (title, at, state) in sorted(about.items(), reverse=True)
        ]

    # -- edits of other programs -----------------------------------------------------------------

    def adopt(self, at: str) -> Step | None:
        """Take what another program changed in the layers into the history."""
        known = self.all_known()
        rows = [(layer, fid, row) for layer in SHAPE_OF for fid, row in self.file.rows(layer)]
        named = _identities(rows, known)
        changes: list[tuple[tuple[str, str, int], Row | None]] = []
        for asset_id, (layer, fid, row) in zip(named, rows, strict=True):
            before = known.get(asset_id)
            if before is None or before.content != content_of(row):
                changes.append(((asset_id, layer, fid), row))
            elif before.fid != fid:
                # a layer that was written anew
                self.file.execute(
                    "UPDATE asset_known SET fid_in_layer = ? WHERE asset_id = ?", (fid, asset_id)
                )
        gone = known.keys() - set(named)
        changes += [
            ((one.id, one.layer, one.fid), None)
            for one in known.values()
            if one.content is not None and one.id in gone
        ]
        if not changes:
            return None
        step = self.begin(OUTSIDE, at)
        for place, changed in changes:
            self._adopt_one(step, known.get(place[0]), place, changed)
        return replace(step, asset_ids=tuple(place[0] for place, _ in changes))

    def _adopt_one(
        self, step: Step, known: Known | None, place: tuple[str, str, int], row: Row | None
    ) -> None:
        asset_id, layer, fid = place
        before = known.content if known else None
        if row is not None:
            row = row | {"asset_id": asset_id, "changed": step.at}
            if known is None or before is None:
                row["created"] = row.get("created") or step.at
            else:
                old = row_in(before)
                moved = not same_place(old.get("geom"), row.get("geom"))
                if moved and all(old.get(name) == row.get(name) for name in _MEASURED):
                    row |= dict.fromkeys(_MEASURED) | {"method": EDITED.method}
            fid = self.file.write(layer, fid, row)
        after = self._remember(asset_id, layer, fid, known)
        self._note(step, asset_id, layer, before, after)


def _identities(rows: list[tuple[str, int, Row]], known: dict[str, Known]) -> list[str]:
    """Id of every row: its own, or a new one where it has none or is a copy of another."""
    owned = {(one.layer, one.fid): one.id for one in known.values() if one.content is not None}
    layer_of = {one.id: one.layer for one in known.values()}
    at_home = {row.get("asset_id") for layer, fid, row in rows
               if owned.get((layer, fid), "") == row.get("asset_id")}  # fmt: skip
    taken: set[str] = set()
    out = []
    for layer, fid, row in rows:
        asset_id = str(row.get("asset_id") or "")
        elsewhere = asset_id in at_home and owned.get((layer, fid)) != asset_id
        moved = layer_of.get(asset_id, layer) != layer
        if not asset_id or asset_id in taken or elsewhere or moved:
            asset_id = str(uuid.uuid4())
        taken.add(asset_id)
        out.append(asset_id)
    return out
