"""Store of a project's assets: every edit is kept with what was before, and can be undone."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from georef_gis.errors import InputError
from georef_gis.measure.assets.asset import (
    EDITED,
    Asset,
    Draft,
    Quality,
    StaleAssetError,
    Vertex,
    checked_vertices,
)
from georef_gis.measure.assets.domain import Domain, checked_text, load_domain
from georef_gis.measure.assets.file import ASSETS_FILE, WAIT, AssetFile
from georef_gis.measure.assets.ledger import Known, Ledger, Step
from georef_gis.measure.assets.tables import LAYERS, SHAPE_OF, asset_of, row_of
from georef_gis.project.database import Srs

if TYPE_CHECKING:
    from georef_gis.project import Project


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """What is to change in an asset; None leaves it as it is.

    Parameters
    ----------
    kind
        Another class of the same geometry.
    attributes
        All of them anew.
    vertices
        Without a `quality` of their own the place counts as edited by hand.
    """

    kind: str | None = None
    name: str | None = None
    note: str | None = None
    attributes: Mapping[str, object] | None = None
    vertices: tuple[Vertex, ...] | None = None
    quality: Quality | None = None


class AssetStore:
    """Assets in ``assets.gpkg``; a context manager that closes it.

    Threads of a process may share one; other processes, and GIS users, work on the same file.

    Parameters
    ----------
    srs
        Project CRS.
    unit
        m per CRS unit.
    wait
        How long to wait for other programs, s.
    """

    def __init__(
        self,
        path: Path,
        domain: Domain,
        srs: Srs,
        *,
        unit: float = 1.0,
        wait: float = WAIT,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self.path = path
        self.domain = domain
        self._file = AssetFile(path, srs, domain, wait=wait)
        self._ledger = Ledger(self._file, domain, unit)
        self._now = now
        self._version: tuple[int, int] | None = None
        self._step: Step | None = None

    @classmethod
    def of_project(cls, project: Project, *, wait: float = WAIT) -> AssetStore:
        """Store of a project, in its CRS and with its classes.

        Raises
        ------
        InputError
            If no photos were read yet, or its classes cannot be used.
        """
        from georef_gis.geodesy import metres_per_unit
        from georef_gis.project.records import load_frame

        frame = load_frame(project.database)
        crs = frame.horizontal
        return cls(
            project.folder / ASSETS_FILE,
            load_domain(project.folder),
            Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=crs.to_epsg()),
            unit=metres_per_unit(crs),
            wait=wait,
        )

    def __enter__(self) -> Self:
        """Give the store."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    # -- reading ---------------------------------------------------------------------------------

    def assets(self, kinds: Iterable[str] | None = None) -> list[Asset]:
        """Assets as they are now, edits of other programs included, in the order of the layers.

        Parameters
        ----------
        kinds
            Names of classes; None = all.
        """
        self._adopt_if_possible()
        wanted = None if kinds is None else set(kinds)
        with self._file.reading():
            known = self._ledger.all_known()
            return [
                self._asset(layer, row, known.get(str(row.get("asset_id"))))
                for layer in SHAPE_OF
                for _, row in self._file.rows(layer)
                if row.get("asset_id") and (wanted is None or row.get("class") in wanted)
            ]

    def get(self, asset_id: str) -> Asset:
        """Asset of an id.

        Raises
        ------
        InputError
            If there is none.
        """
        self._adopt_if_possible()
        with self._file.reading():
            return self._current(asset_id)

    def steps(self, most: int = 100) -> list[Step]:
        """The last steps of the history, the last first."""
        self._adopt_if_possible()
        with self._file.reading():
            return self._ledger.steps(most)

    def _adopt_if_possible(self) -> None:
        """Take edits of other programs in; one that holds the file keeps nobody from reading."""
        with self._file.reading():
            if self._file.version() == self._version:
                return
        with contextlib.suppress(InputError), self._writing():
            pass

    def _current(self, asset_id: str) -> Asset:
        known = self._ledger.known(asset_id)
        row = None if known is None else self._file.row(known.layer, known.fid)
        if known is None or row is None or row.get("asset_id") != asset_id:
            raise InputError(f"no asset has the id {asset_id[:60]!r}; it may have been deleted",
                             source=str(self.path))  # fmt: skip
        return self._asset(known.layer, row, known)

    def _asset(self, layer: str, row: Mapping[str, Any], known: Known | None) -> Asset:
        revision = known.revision if known else 0
        return asset_of(row, SHAPE_OF[layer], revision, self.domain)

    # -- editing ---------------------------------------------------------------------------------

    @contextlib.contextmanager
    def step(self, title: str) -> Iterator[None]:
        """All edits inside happen or none, and are undone together."""
        with self._writing():
            if self._step is not None:
                yield
                return
            self._step = self._ledger.begin(title, self._time())
            try:
                yield
            finally:
                self._step = None

    def add(self, draft: Draft) -> Asset:
        """Store a new asset.

        Raises
        ------
        InputError
            If it does not fit its class, or the file cannot be written.
        """
        found = self.domain.find(draft.kind)
        vertices = checked_vertices(found.geometry, draft.vertices, source=found.name)
        at = self._time()
        asset = Asset(
            id=str(uuid.uuid4()),
            kind=found.name,
            shape=found.geometry,
            vertices=vertices,
            name=_text(draft.name, "name"),
            note=_text(draft.note, "note"),
            attributes=found.read(draft.attributes),
            quality=_of_vertices(draft.quality, len(vertices)),
            created=at,
            changed=at,
        )
        return self._put(f"add {found.title.lower()}", asset)

    def change(self, asset_id: str, revision: int, change: Change) -> Asset:
        """Change an asset.

        Parameters
        ----------
        revision
            Of the asset that the change was made from.

        Raises
        ------
        StaleAssetError
            If it was changed or deleted since; it carries the asset as it is now.
        InputError
            If it does not fit its class, or the file cannot be written.
        """
        with self._writing():
            old = self._fresh(asset_id, revision)
            new = self._changed(old, change)
            return self._put(f"change {new.kind}", new)

    def delete(self, asset_id: str, revision: int) -> None:
        """Delete an asset.

        Raises
        ------
        StaleAssetError
            If it was changed or deleted since.
        """
        with self._writing():
            old = self._fresh(asset_id, revision)
            with self.step(f"delete {old.kind}"):
                assert self._step is not None
                self._ledger.put(self._step, asset_id, LAYERS[old.shape].name, None)

    def undo(self) -> Step | None:
        """Take the last step back, of this or an earlier session; None if there is none."""
        with self._writing():
            return self._ledger.undo()

    def redo(self) -> Step | None:
        """Do the step again that was undone last; None if there is none."""
        with self._writing():
            return self._ledger.redo()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Begin with what other programs changed, which stays written if the edit is refused."""
        with self._file.mutex:
            if not self._file.in_transaction:
                with self._file.transaction():
                    self._take_in()
            with self._file.transaction():
                taken = self._step is None and self._take_in()
                try:
                    yield
                except BaseException:
                    if taken:
                        self._version = None
                    raise

    def _take_in(self) -> bool:
        """Write edits of other programs down; whether it had to be looked for them."""
        version = self._file.version()
        if version == self._version:
            return False
        self._file.make_whole()
        self._ledger.adopt(self._time())
        self._version = version
        return True

    def _fresh(self, asset_id: str, revision: int) -> Asset:
        try:
            current = self._current(asset_id)
        except InputError as error:
            raise StaleAssetError("the asset was deleted meanwhile; nothing was changed",
                                  source=str(self.path), current=None) from error  # fmt: skip
        if current.revision != revision:
            raise StaleAssetError(
                f"{current.kind} {current.name[:40]!r} was changed meanwhile (revision "
                f"{current.revision}, yours {revision}); look at it and change it again",
                source=str(self.path),
                current=current,
            )
        return current

    def _changed(self, old: Asset, change: Change) -> Asset:
        kind, attributes = self._described(old, change)
        vertices, quality = old.vertices, change.quality or old.quality
        if change.vertices is not None:
            vertices = checked_vertices(old.shape, change.vertices, source=kind)
            if change.quality is None and not _same(vertices, old.vertices):
                quality = EDITED
        return replace(
            old,
            kind=kind,
            vertices=vertices,
            name=old.name if change.name is None else _text(change.name, "name"),
            note=old.note if change.note is None else _text(change.note, "note"),
            attributes=attributes,
            quality=_of_vertices(quality, len(vertices)),
            changed=self._time(),
        )

    def _described(self, old: Asset, change: Change) -> tuple[str, Mapping[str, object]]:
        """Class and attributes; what is not changed need not fit a class that was changed since."""
        if change.kind is None and change.attributes is None:
            return old.kind, old.attributes
        found = self.domain.find(old.kind if change.kind is None else change.kind)
        if found.geometry != old.shape:
            raise InputError(f"is a {found.geometry}, the asset a {old.shape}; add a new one",
                             source=found.name, field="class")  # fmt: skip
        attributes = old.attributes if change.attributes is None else change.attributes
        return found.name, found.read(attributes)

    def _put(self, title: str, asset: Asset) -> Asset:
        if not asset.vertices:
            raise InputError("its geometry cannot be read; draw it anew", source=str(self.path),
                             field=asset.id)  # fmt: skip
        with self.step(title):
            assert self._step is not None
            layer = LAYERS[asset.shape].name
            self._ledger.put(self._step, asset.id, layer, _row(asset))
            return self._current(asset.id)

    def _time(self) -> str:
        return self._now().astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _same(first: tuple[Vertex, ...], second: tuple[Vertex, ...]) -> bool:
    return repr(first) == repr(second)


def _of_vertices(quality: Quality | None, count: int) -> Quality | None:
    """Accuracy without the click that closed a ring, whose vertex is the first one."""
    if quality is None or all(click.vertex < count for click in quality.clicks):
        return quality
    return replace(quality, clicks=tuple(c for c in quality.clicks if c.vertex < count))


def _text(value: object, name: str) -> str:
    try:
        return checked_text(value)
    except ValueError as error:
        raise InputError(str(error), field=name) from error


def _row(asset: Asset) -> dict[str, Any]:
    row = row_of(asset)
    for name, value in row.items():
        try:
            value.encode() if isinstance(value, str) else None
        except UnicodeEncodeError as error:
            raise InputError("holds what is no character; write it anew", source=asset.kind,
                             field=name) from error  # fmt: skip
    return row
