"""Which way the arrows point: imports are read with `ast`, never run, except for two start-ups."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("georef_gis", "processing_algorithms", "exports")
STAGES = {"ingest", "navigate", "orient", "rectify", "mosaic", "measure"}
FOUNDATION = {"errors", "units", "frames", "ellipsoid", "geodesy", "model", "rasters", "project"}

# What a part of georef_gis may import of georef_gis ("" is the package itself: its version).
ALLOWED: dict[str, set[str]] = {
    "": {"*"},
    "errors": set(),
    "units": {"errors"},
    "frames": {"errors", "units"},
    "ellipsoid": {"frames"},
    "geodesy": {"errors", "units", "frames", "ellipsoid"},
    "model": {"errors", "units", "frames", "ellipsoid", "geodesy"},
    "rasters": {"errors", "units", "frames", "ellipsoid", "geodesy", "model"},
    "project": {"errors", "units", "frames", "ellipsoid", "geodesy", "model", ""},
    "simulate": {"errors", "units"},
    "toolbox": {"errors", "units", "model", "project", ""},
    "app": {"errors", "toolbox", "project", ""},
    # a plug-in of QGIS with a licence of its own: nothing else imports it, nor it anything
    "qgis_plugin": set(),
    **{stage: {*FOUNDATION, ""} for stage in STAGES},
}
# Libraries and the only places that may import them.
OWNERS: dict[str, tuple[str, ...]] = {
    "pyproj": ("georef_gis/geodesy",),
    "rasterio": ("georef_gis/rasters", "exports/"),
    "serial": ("georef_gis/ingest/serial_port.py",),
    "click": ("georef_gis/app/",),
    "rich": ("georef_gis/app/",),
    "fastapi": ("georef_gis/app/",),
    "starlette": ("georef_gis/app/",),
    "uvicorn": ("georef_gis/app/",),
    "qgis": ("georef_gis/qgis_plugin/",),
    "PyQt5": ("georef_gis/app/",),
    "PyQt6": ("georef_gis/app/",),
    "orthority": (),
}
# They take too long for `georef --help`; tools import them inside run().
HEAVY = ("cv2", "rasterio", "scipy", "geopandas", "pandas", "numpy", "shapely", "pyproj", "rich")


def modules() -> dict[str, Path]:
    """Name of every module of the product, and its file."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def _top_level(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that run at import: not in functions, not for the type checker only."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _top_level(node)


def imports(name: str, *, at_start: bool = False) -> set[str]:
    """Modules that a module imports: of ours in full, of others as written."""
    path = MODULES[name]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    base = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found: set[str] = set()
    for node in _top_level(tree) if at_start else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parent = ".".join(base[: len(base) - node.level + 1]) if node.level else ""
            source = ".".join(part for part in (parent, node.module or "") if part)
            inner = {f"{source}.{alias.name}" for alias in node.names}
            found |= {source, *(inner & MODULES.keys())} if inner - MODULES.keys() else inner
    return found


def part_of(module: str) -> str:
    """Part of georef_gis that a module belongs to; "" for the package itself."""
    names = module.split(".")
    return names[1] if len(names) > 1 and names[1] in ALLOWED else ""


def wrong_arrow(name: str, target: str) -> bool:
    """Whether a module of ours must not import a module."""
    package, other = name.split(".")[0], target.split(".")[0]
    if other not in PACKAGES:
        return False
    if package == "processing_algorithms":
        return other == "exports" or part_of(target) == "app"
    if package == "exports":
        allowed = FOUNDATION | {"toolbox", ""}
        return other == "processing_algorithms" or (
            other == "georef_gis" and part_of(target) not in allowed
        )
    part = part_of(name)
    allowed = ALLOWED[part]
    return other != "georef_gis" or not ("*" in allowed or part_of(target) in {*allowed, part})


@pytest.mark.parametrize("name", MODULES)
def test_module_imports_only_what_lies_below_it(name: str) -> None:
    assert [target for target in sorted(imports(name)) if wrong_arrow(name, target)] == []


@pytest.mark.parametrize("library", OWNERS)
def test_library_is_imported_by_its_owner_only(library: str) -> None:
    users = [
        path.relative_to(ROOT).as_posix()
        for name, path in MODULES.items()
        if any(target.split(".")[0] == library for target in imports(name))
    ]
    assert [user for user in users if not user.startswith(OWNERS[library])] == []


def test_no_module_imports_itself_in_a_circle() -> None:
    left = {
        name: {target for target in imports(name, at_start=True) if target in MODULES} - {name}
        for name in MODULES
    }
    # A package's __init__ is run before its modules, which may import each other through it.
    while True:
        free = {name for name, targets in left.items() if not targets & left.keys()}
        if not free:
            break
        left = {name: targets for name, targets in left.items() if name not in free}
    assert left == {}


@pytest.mark.parametrize(
    ("name", "target", "wrong"),
    [
        ("georef_gis.mosaic", "georef_gis.rectify", True),
        ("georef_gis.mosaic", "georef_gis.rasters", False),
        ("georef_gis.toolbox", "georef_gis.ingest", True),
        ("georef_gis.app", "processing_algorithms", True),
        ("georef_gis.app", "georef_gis.model", True),
        ("georef_gis.simulate", "georef_gis.frames", True),
        ("georef_gis.model", "georef_gis.project", True),
        ("exports", "georef_gis.rectify", True),
        ("processing_algorithms", "georef_gis.rectify", False),
    ],
)
def test_this_test_knows_a_wrong_arrow(name: str, target: str, wrong: bool) -> None:
    assert wrong_arrow(name, target) is wrong


@pytest.mark.parametrize(
    "code",
    [
        "import georef_gis",
        "import georef_gis, sys; [getattr(georef_gis, n) for n in ('errors', '__version__') "
        "if hasattr(georef_gis, n)]",
        "import sys; sys.argv = ['georef', '--help']\nfrom georef_gis.app.cli import main\n"
        "try: main()\nexcept SystemExit: pass",
        "import sys; sys.argv = ['georef', 'tools']\nfrom georef_gis.app.cli import main\n"
        "try: main()\nexcept SystemExit: pass",
    ],
    ids=["import", "version", "help", "tools"],
)
def test_start_up_is_light(code: str) -> None:
    code += f"\nimport sys\nprint('HEAVY', *sorted(set({HEAVY!r}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY", done.stdout.splitlines()[-1]
