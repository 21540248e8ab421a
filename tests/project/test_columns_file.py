"""Columns in one file: given back as they were, whole or not at all, and none but our own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.project import columns_file
from georef_gis.project.columns_file import columns_of, kind_of, read_columns, write_columns

COLUMNS = {
    "matrix": np.arange(12.0).reshape(3, 4),
    "count": np.array([3, 1], np.int64),
    "nothing": np.zeros((0, 3)),
    "word": "one µ text",
    "words": ["IMG_0001", "IMG_0002 (copy)"],
}


def test_columns_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    write_columns(path, "points", COLUMNS)
    assert kind_of(path) == "points"
    back = read_columns(path, "points")
    assert set(back) == set(COLUMNS)
    for name, value in COLUMNS.items():
        np.testing.assert_array_equal(back[name], np.asarray(value))
        assert back[name].dtype == np.asarray(value).dtype
    assert [file.name for file in tmp_path.iterdir()] == ["points.npz"]


def test_older_file_stays_where_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    write_columns(path, "points", {"x": np.ones(3)})
    with pytest.raises(ValueError, match="pickle"):
        write_columns(path, "points", {"x": np.array([object()])})
    np.testing.assert_array_equal(read_columns(path, "points")["x"], np.ones(3))
    assert [file.name for file in tmp_path.iterdir()] == ["points.npz"]


def test_what_is_not_ours_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "points.npz"
    write_columns(path, "points", COLUMNS)
    (tmp_path / "cut.npz").write_bytes(path.read_bytes()[:-200])
    (tmp_path / "text.npz").write_text("no archive")
    np.savez(tmp_path / "foreign.npz", x=np.ones(3))
    cases = [("points.npz", "other", "holds 'points', not 'other'"),
             *((f"{name}.npz", "points", "holds no columns of ours")
               for name in ("cut", "text", "foreign", "none"))]  # fmt: skip
    for name, kind, words in cases:
        with pytest.raises(InputError, match=words) as caught:
            read_columns(tmp_path / name, kind)
        assert caught.value.source == str(tmp_path / name)
        assert "georef run" in str(caught.value)
        assert "trajectory" not in str(caught.value)
        assert "\n" not in str(caught.value)
    monkeypatch.setattr(columns_file, "FORMAT", 2)
    with pytest.raises(InputError, match="another version"):
        read_columns(path, "points")


@pytest.mark.parametrize(
    ("spoil", "why"), [(lambda read: read["absent"], "absent"), (lambda read: float("ten"), "ten")]
)
def test_column_that_does_not_fit_is_the_files_fault(
    tmp_path: Path, spoil: Callable[[dict[str, Any]], Any], why: str
) -> None:
    path = tmp_path / "points.npz"
    write_columns(path, "points", COLUMNS)
    words = rf"holds no points \(.*{why}.*\); match anew"
    with pytest.raises(InputError, match=words) as told:
        with columns_of(path, "points", cure="match anew") as read:
            spoil(read)
    assert told.value.source == str(path)
