"""Services: what is marked can be asked for, what cannot be loaded is told."""

from __future__ import annotations

import itertools
from importlib.metadata import EntryPoint
from typing import Any

import pytest
from pydantic import ValidationError

from georef_gis.errors import GeorefError, InputError
from georef_gis.toolbox import services
from georef_gis.toolbox.services import (
    Picture,
    Renewed,
    Request,
    Service,
    call,
    load_services,
    picture,
)


class Number(Request):
    x: float


class Lamp(Service):
    @call(Number)
    def twice(self, request: Number) -> dict[str, float]:
        return {"x": 2.0 * request.x}

    @picture(Number)
    def image(self, request: Number) -> Picture:
        return Picture(content=b"x" * int(request.x), media_type="image/png")

    def secret(self) -> str:
        return "not marked"

    def revisions(self) -> dict[str, str]:
        return {"lamp": "1"}


class Desk(Lamp):
    """Calls of the classes it is made of are its own."""

    def revisions(self) -> dict[str, str]:
        return {"desk": "2"}


class Broken(Service):
    def __init__(self, project: Any) -> None:
        raise RuntimeError("no\nway")


NOT_A_SERVICE = dict


def installed(monkeypatch: pytest.MonkeyPatch, **values: str) -> None:
    entries = [
        EntryPoint(name=name, value=f"{__name__}:{value}", group=services.SERVICE_GROUP)
        for name, value in values.items()
    ]
    monkeypatch.setattr(services, "entry_points", lambda group: entries)


def test_only_what_is_marked_is_an_endpoint() -> None:
    found = Desk(None).endpoints()  # type: ignore[arg-type]
    assert {name: one.is_picture for name, one in found.items()} == {"twice": False, "image": True}
    assert found["twice"].run(found["twice"].Request(x=4.0)) == {"x": 8.0}


@pytest.mark.parametrize("body", [b'{"x": NaN}', b'{"x": 1, "y": 2}', b'{"x": 1e999}', b"{}"])
def test_a_request_takes_finite_numbers_under_known_names(body: bytes) -> None:
    with pytest.raises(ValidationError):
        Number.model_validate_json(body)


def test_what_is_refused_does_not_hold_up_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    installed(monkeypatch, lamp="Lamp", broken="Broken", none="NOT_A_SERVICE", gone="Gone")
    found = load_services(None)  # type: ignore[arg-type]
    assert list(found.found) == ["lamp"]
    told = sorted(str(error) for error in found.refused)
    assert [text.split()[1] for text in told] == ["broken:", "gone:", "none:"]
    assert all("\n" not in text for text in told)


def test_revisions_of_all_services_are_told_together(monkeypatch: pytest.MonkeyPatch) -> None:
    installed(monkeypatch, lamp="Lamp", desk="Desk")
    assert load_services(None).revisions() == {"lamp": "1", "desk": "2"}  # type: ignore[arg-type]


def test_the_own_services_are_installed() -> None:
    from importlib.metadata import entry_points

    names = {entry.name for entry in entry_points(group=services.SERVICE_GROUP)}
    assert {"measure", "view"} <= names


# -- what is read anew when the project changes ---------------------------------------------------


def test_what_was_read_is_read_again_in_another_state_only() -> None:
    numbers = itertools.count(1)
    kept = Renewed(lambda: next(numbers))
    assert [kept.get(state) for state in ("a", "a", "b", "b", "a")] == [1, 1, 2, 2, 3]


@pytest.mark.parametrize("error", [KeyError("camera"), GeorefError("half a run")])
def test_what_was_read_before_a_run_serves_while_its_parts_do_not_fit(error: Exception) -> None:
    answers: list[Any] = ["before", error, error, "after"]

    def read() -> str:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return str(answer)

    kept = Renewed(read)
    assert [kept.get(str(state)) for state in (0, 1, 1, 2, 3)] == ["before"] * 4 + ["after"]


def test_what_could_never_be_read_is_told_with_a_cure_and_tried_again() -> None:
    answers: list[Any] = [KeyError("camera X"), GeorefError("no photo has a pose"), "there"]

    def read() -> str:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return str(answer)

    kept = Renewed(read)
    with pytest.raises(InputError, match=r"'camera X' is missing.*run `georef run` to its end"):
        kept.get("1")
    with pytest.raises(GeorefError, match="no photo has a pose"):
        kept.get("1")
    assert kept.get("1") == "there"
