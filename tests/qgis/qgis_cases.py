"""QGIS of the system for tests: where it is, a profile with the plug-in, jobs for `driver.py`."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent.parent
PLUGIN = ROOT / "georef_gis/qgis_plugin/georef_qgis"
SAMPLE = ROOT / "sample_project"
QGIS_PROCESS = "/usr/bin/qgis_process.bin"
PYTHON = "/usr/bin/python3"
DRIVER = Path(__file__).parent / "driver.py"
PROFILE = ".local/share/QGIS/QGIS3/profiles/default"
# the plug-in is no package of ours: its plain modules are taken from its folder
sys.path.insert(0, str(PLUGIN.parent))


def why_not() -> str:
    """Why QGIS cannot be used here; empty if it can."""
    if not Path(QGIS_PROCESS).is_file():
        return f"no QGIS here: {QGIS_PROCESS} is missing (apt install qgis python3-qgis)"
    if not Path("/usr/share/qgis/python/plugins/processing").is_dir():
        return "no Processing plug-in of QGIS here (apt install python3-qgis)"
    return ""


def environment(home: Path) -> dict[str, str]:
    """Clean environment: an activated virtual environment makes QGIS crash."""
    runtime = home / "run"
    runtime.mkdir(mode=0o700, parents=True, exist_ok=True)
    return {
        "HOME": str(home), "XDG_RUNTIME_DIR": str(runtime), "QT_QPA_PLATFORM": "offscreen",
        "PATH": "/usr/bin:/bin", "LANG": "C.UTF-8", "OMP_NUM_THREADS": "1",
    }  # fmt: skip


def georef(*words: str | Path, home: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command line of georef, with a HOME of the test."""
    env = dict(os.environ) if home is None else {**os.environ, "HOME": str(home)}
    for name in ("XDG_DATA_HOME", "QGIS_CUSTOM_CONFIG_PATH"):
        env.pop(name, None)
    command = [sys.executable, "-m", "georef_gis.app", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, env=env, check=False)


def install(home: Path) -> Path:
    """Put the plug-in into the profile of a new user; its folder."""
    done = georef("qgis", "install", "--profile", "default", home=home)
    assert done.returncode == 0, done.stderr
    return home / PROFILE / "python/plugins/georef_qgis"


def qgis_process(home: Path, *words: str | Path, **more: Any) -> subprocess.CompletedProcess[str]:
    """QGIS' own command line."""
    return subprocess.run(
        [QGIS_PROCESS, *map(str, words)], capture_output=True, text=True, env=environment(home),
        check=False, timeout=120, **more,
    )  # fmt: skip


def drive(home: Path, folder: Path, jobs: list[dict[str, Any]], limit: float = 900) -> list[Any]:
    """Do jobs in one process of QGIS' Python; their results in order."""
    folder.mkdir(parents=True, exist_ok=True)
    asked, told = folder / "jobs.json", folder / "results.json"
    asked.write_text(json.dumps(jobs), encoding="utf-8")
    done = subprocess.run(
        [PYTHON, str(DRIVER), str(asked), str(told)], capture_output=True, text=True,
        env=environment(home), cwd=folder, check=False, timeout=limit,
    )  # fmt: skip
    results = json.loads(told.read_text("utf-8")) if told.is_file() else []
    assert len(results) == len(jobs), f"QGIS ended early: {done.stderr[-2000:]}"
    return results


def copy_sample(folder: Path) -> Path:
    """Sample project without anything that was made of it."""
    made = shutil.ignore_patterns("products", "cache", "navigation", "adjustment", "georef.gpkg*",
                                  "assets.gpkg", "seams.gpkg", ".georef.lock", "truth")  # fmt: skip
    return Path(shutil.copytree(SAMPLE, folder, ignore=made))


CLICKS = """\
asset,class,photo,u,v,line,width_in,mutcd_code
C01,cone,IMG_0013.JPG,421.8,249.7,T1,14,
C01,cone,IMG_0014.JPG,1099.9,129.0,T1,14,
C02,cone,IMG_0013.JPG,423.6,296.5,T1,14,
C02,cone,IMG_0014.JPG,1062.2,128.3,T1,14,
C03,cone,IMG_0013.JPG,426.1,343.4,T1,14,
C03,cone,IMG_0014.JPG,1024.4,127.8,T1,14,
C04,cone,IMG_0013.JPG,428.4,391.1,T1,14,
C05,cone,IMG_0013.JPG,431.1,439.6,T1,14,
C06,cone,IMG_0013.JPG,434.5,488.3,T1,14,
C07,cone,IMG_0013.JPG,437.6,537.2,T1,14,
C08,cone,IMG_0013.JPG,441.1,586.5,T1,14,
S2,sign,IMG_0013.JPG,394.7,159.2,S1,,W20-1
right edge,lane_edge,IMG_0013.JPG,421.4,430,,,
right edge,lane_edge,IMG_0013.JPG,410.7,690,,,
"""
CONE = "IMG_0013.JPG:421.8,249.7"
SQUARE = "1693980,219050; 1694040,219050; 1694040,219110; 1693980,219110"


def write_inputs(folder: Path) -> None:
    """Files that tools of other instruments read."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "one photo").mkdir(exist_ok=True)
    shutil.copy(SAMPLE / "photos/IMG_0013.JPG", folder / "one photo")
    truth = json.loads((SAMPLE / "truth/camera.json").read_text("utf-8"))
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    camera = {"model": "brown", "width": truth["width"], "height": truth["height"],
              "parameters": {name: truth[name] for name in names}}  # fmt: skip
    (folder / "camera.json").write_text(json.dumps(camera), encoding="utf-8")
    (folder / "clicks.csv").write_text(CLICKS, encoding="utf-8")
    marks = "name,photo,u,v\n" + "".join(
        f"c,{line.split(',')[2]},{line.split(',')[3]},{line.split(',')[4]}\n"
        for line in CLICKS.splitlines()[1:3]
    )
    (folder / "marks.csv").write_text(marks, encoding="utf-8")
    (folder / "residuals.csv").write_text(
        "name,dx,dy,dz\n"
        + "".join(f"P{n},{0.01 * n},{-0.02 * n},{0.03 * n}\n" for n in range(1, 9)),
        encoding="utf-8",
    )
    with (folder / "pwm.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_s", "ch7"])
        writer.writerows([n * 0.1, 1000 + 20 * (n // 20 % 10)] for n in range(800))


def cases(project: Path, folder: Path) -> dict[str, dict[str, Any]]:
    """Parameters of every tool on the sample project, in the order of the work.

    A key ``error`` is what the one line of the refusal must contain, where the sample project has
    nothing that the tool could work on.
    """
    p, f = str(project), str(folder)
    return {
        "init": {"photos": f"{p}/photos", "into": f"{f}/new project"},
        "simulate": {"folder": f"{f}/flight", "photos": False},
        "check": {"folder": f"{p}/photos", "target": f"{f}/again.kml"},
        # a first answer without matches: what comes after it makes the steps stale one by one
        "run": {"quick": True},
        "read_photos": {},
        "navigate": {}, "orient_direct": {}, "orient_navigation": {},
        "match": {"max_side": 800, "observations": 300}, "adjust": {},
        "footprints": {}, "orthos": {"photos": "IMG_0013\nIMG_0014"},
        "mosaic": {"gsd": 0.1}, "control": {}, "accuracy": {}, "report": {},
        "show_project": {},
        "sync_board_list_ports": {},
        "sync_board_record": {"list_ports": True, "output": f"{f}/board.log"},
        "sync_board_send": {"port": "/dev/no-such-port", "shutter": True, "error": "no-such-port"},
        "sync_board_simulate": {"duration": 0.5},
        "sync_board_decode": {"log": f"{f}/pwm.csv", "channel": "ch7", "output": f"{f}/index.csv"},
        "ppk": {"rover": f"{f}/pwm.csv", "base": f"{f}/marks.csv", "output": f"{f}/ppk.pos",
                "error": "pwm.csv"},
        "compare_trajectory": {"estimate": f"{p}/navigation/trajectory.csv",
                               "reference": f"{p}/logs/gnss.csv", "target": f"{f}/compared"},
        "calibrate_camera": {"photos": f"{f}/one photo", "target": f"{f}/camera.toml",
                             "error": "chessboard"},
        "calibrate_mount": {"exposures": f"{f}/residuals.csv", "camera": f"{f}/camera.json",
                            "targets": f"{f}/residuals.csv", "marks": f"{f}/marks.csv",
                            "target": f"{f}/mount.toml", "error": "residuals.csv"},
        "undistort": {"photos": f"{f}/one photo", "camera": f"{f}/camera.json",
                      "target": f"{f}/straight"},
        "mosaic_sheets": {"length": 60.0},
        "band_index": {"raster": f"{p}/products/mosaic.tif", "index": "exg",
                       "target": f"{f}/green.tif"},
        "where_to_click": {"target": f"{f}/where.csv"},
        "accuracy_table": {"table": f"{f}/residuals.csv", "target": f"{f}/statement"},
        "measure_photo": {"photo": f"{p}/photos/IMG_0013.JPG", "pixel": "421.8,249.7", "site": p,
                          "target": f"{f}/one.csv"},
        "locate": {"pixel": [CONE, "IMG_0013.JPG:423.6,296.5"], "target": f"{f}/places.csv"},
        "intersect": {"marks": f"{f}/marks.csv", "target": f"{f}/crossed.csv"},
        "match_clicks": {"pixel": CONE, "target": f"{f}/matched.csv"},
        "measure_lines": {"pixel": "IMG_0013.JPG:410.7,690; IMG_0013.JPG:528,694.5"},
        "who_sees": {"place": "1694010,219080 [EPSG:6601]", "target": f"{f}/who.csv"},
        "assets": {"clicks": f"{f}/clicks.csv"},
        "screen_work_zone": {}, "wzdx": {"error": "work_zone.toml"},
        "surface": {"las": "none"},
        "profile": {"corner": "1693980,219050; 1694040,219110", "target": f"{f}/profile.csv"},
        "volume": {"corner": SQUARE, "target": f"{f}/volume.csv"},
        "error_budget": {"pixel": CONE},
        "change": {"error": "earlier"},
        "plan_flight": {"height": 60.0, "speed": 12.0, "focal": 18.0, "sensor_width": 22.2,
                        "columns": 3888, "rows": 2592, "corner": _square_geographic(),
                        "target": f"{f}/plan.kml"},
    }  # fmt: skip


def _square_geographic() -> str:
    south, west, d = 39.0970, -80.4680, 0.001
    corners = ((west, south), (west + d, south), (west + d, south + d), (west, south + d))
    return "\n".join(f"{lon},{lat}@EPSG:4326" for lon, lat in corners)
