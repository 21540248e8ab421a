"""The plug-in keeps to what QGIS 3.22 to 4 have: read with `ast`, never run."""

from __future__ import annotations

import ast
import configparser
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import make_styles
import pytest
from qgis_cases import PLUGIN

MODULES = sorted(PLUGIN.glob("*.py"))
# Members of Qt's and QGIS' enumerations stand behind the name of their enumeration; Qt 6 has no
# other way. Their first letters tell them from methods, which begin with a small one.
CLASS = re.compile(r"^(Q[A-Z]\w*|Qgs\w*|Qt|Qgis)$")


def tree(path: Path) -> ast.Module:
    # QGIS 3.22 comes with Python 3.8 at the oldest
    return ast.parse(path.read_text("utf-8"), feature_version=(3, 8))


def unscoped(root: ast.AST) -> list[str]:
    """Members taken from a class itself: ``Qt.AlignLeft``, not ``Qt.AlignmentFlag.AlignLeft``."""
    scopes = {id(node.value) for node in ast.walk(root) if isinstance(node, ast.Attribute)}
    return [
        ast.unparse(node)
        for node in ast.walk(root)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and CLASS.match(node.value.id)
        and node.attr[0].isupper()
        and id(node) not in scopes
        # a class within a class
        and node.attr != "LayerDetails"
    ]


def imported(root: ast.AST) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(root):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add(str(node.module))
    return found


def test_this_test_knows_an_unscoped_member() -> None:
    code = "Qt.AlignLeft, Qgis.Warning, Qt.AlignmentFlag.AlignLeft, Qgis.version(), own.AlignLeft"
    assert unscoped(ast.parse(code)) == ["Qt.AlignLeft", "Qgis.Warning"]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.name)
def test_module_takes_enumerations_from_one_place_and_qt_through_qgis(path: Path) -> None:
    assert unscoped(tree(path)) == []
    for name in imported(tree(path)):
        head = name.split(".")[0]
        assert head in sys.stdlib_module_names | {"qgis", "processing"}, name


def test_names_in_the_compatibility_table_are_scoped() -> None:
    texts = [n.value for n in ast.walk(tree(PLUGIN / "compat.py"))
             if isinstance(n, ast.Constant) and isinstance(n.value, str)]  # fmt: skip
    paths = [text for text in texts if re.match(r"^Q\w+\.", text)]
    assert len(paths) > 15
    assert all(path.count(".") == 2 for path in paths), paths


@pytest.mark.parametrize(
    "name", ["tools", "child", "manifest", "products", "telling", "help_page", "__init__"]
)
def test_plain_modules_need_no_qgis(name: str) -> None:
    root = tree(PLUGIN / f"{name}.py")
    assert not any(head.startswith(("qgis", "processing")) for head in imported(root))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.name)
def test_newer_methods_than_python_3_8_are_not_called(path: Path) -> None:
    called = {n.attr for n in ast.walk(tree(path)) if isinstance(n, ast.Attribute)}
    assert not called & {"removeprefix", "removesuffix", "is_relative_to", "with_stem", "UTC"}


def test_metadata_tell_qgis_what_it_asks_for() -> None:
    reader = configparser.ConfigParser(interpolation=None)
    reader.read(PLUGIN / "metadata.txt", encoding="utf-8")
    told = reader["general"]
    for key in ("name", "description", "version", "author", "email", "about"):
        assert told[key], key
    assert told["qgisMinimumVersion"] == "3.22"
    assert told["qgisMaximumVersion"].startswith("4.")
    assert told["supportsQt6"] == "True"
    assert told["hasProcessingProvider"] == "yes"
    from georef_gis import __version__

    assert told["version"] == __version__


def test_folder_has_the_licence_that_qgis_asks_for() -> None:
    assert "GNU GENERAL PUBLIC LICENSE" in (PLUGIN / "LICENSE").read_text("utf-8")[:200]
    for path in MODULES:
        assert path.read_text("utf-8").startswith("# SPDX-License-Identifier: GPL-2.0-or-later"), (
            path
        )


@pytest.mark.parametrize("name", make_styles.styles())
def test_styles_are_those_of_the_table_of_classes(name: str) -> None:
    made = make_styles.styles()[name]
    assert (PLUGIN / "styles" / name).read_text("utf-8") == made, "run tests/qgis/make_styles.py"
    ElementTree.fromstring(made.replace(make_styles.HEAD, ""))


def test_every_style_that_layers_ask_for_is_there() -> None:
    from georef_qgis.products import style_of

    names = ("asset_points", "asset_lines", "asset_polygons", "asset_ellipses", "footprints",
             "photos", "seams", "places")  # fmt: skip
    for name in names:
        assert (PLUGIN / "styles" / f"{style_of(name)}.qml").is_file(), name
    assert style_of("overlap", raster=True) == "overlap"
    assert style_of("unknown") == ""
