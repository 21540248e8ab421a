"""A project's folder: settings and what is said of wrong ones, template, photos, fingerprints."""

import os
import pickle
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from georef_gis.errors import InputError
from georef_gis.project import Project, Settings, fingerprint, read_settings, render_settings
from georef_gis.project.fingerprint import fingerprints, is_same
from georef_gis.project.lock import project_lock


def settings_of(folder: Path, text: str) -> Settings:
    (folder / "project.toml").write_text(text)
    return read_settings(folder / "project.toml")


def test_empty_file_gives_the_defaults(tmp_path: Path) -> None:
    settings = settings_of(tmp_path, "")
    assert settings.gnss.height_kind == "auto"
    assert settings.products.gsd_m is None
    assert settings.tools == {}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[gnss]\nsigma_hm = 1", r"gnss.sigma_hm: unknown key; did you mean sigma_h_m\?"),
        ("[gns]\nx = 1", r"gns: unknown key; did you mean gnss\?"),
        ("[project]\nsigma_yaw = 1", r"project.sigma_yaw: .*did you mean attitude.sigma_yaw_deg\?"),
        ("[camera]\nqqq = 1", "camera.qqq: unknown key; valid keys: focal_px, focal_mm"),
        ("[cameras.X1]\nfocal = 1", r"cameras.X1.focal: unknown key; did you mean focal_px\?"),
        ("[gnss]\nsigma_h_m = -1", r"gnss.sigma_h_m: -1: input should be greater than 0 \(One "),
        ('[gnss]\nheight_kind = "msl"', "gnss.height_kind: 'msl': input should be 'auto', "),
        ('[ground]\nheight_m = "low"', "ground.height_m: 'low': input should be a valid number"),
        ('[attitude.rotate_photos]\n"A.JPG" = 45', r"rotate_photos.A.JPG: 45: input should be 0"),
        ("[gnss\n", "is not valid TOML: .*line 1"),
    ],
)  # fmt: skip
def test_wrong_settings_give_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        settings_of(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "project.toml"))
    assert "\n" not in str(caught.value)


def test_height_of_the_ground_and_above_it_are_not_both_taken(tmp_path: Path) -> None:
    both = "[ground]\nheight_above_ground_m = 60\nheight_m = 314\n"
    with pytest.raises(InputError, match=r"ground\.height_above_ground_m: 60: .*with height_m;"):
        settings_of(tmp_path, both)
    assert settings_of(tmp_path, "[ground]\nheight_m = 314\n").ground.height_m == 314.0


def test_unit_of_the_dem_is_one_that_is_known(tmp_path: Path) -> None:
    assert settings_of(tmp_path, '[ground]\ndem_unit = "us-ft"\n').ground.dem_unit == "us-ft"
    with pytest.raises(InputError, match=r"ground\.dem_unit: 'yd': input should be 'auto', 'm'"):
        settings_of(tmp_path, '[ground]\ndem_unit = "yd"\n')


def test_camera_table_of_its_own_goes_before_the_general_one(tmp_path: Path) -> None:
    settings = settings_of(
        tmp_path, '[camera]\nfocal_px = 3000\nk1 = -0.1\n[cameras."Canon X"]\nfocal_px = 3100.5\n'
    )
    own = settings.camera_of("serial 5", "Canon X")
    assert (own.focal_px, own.k1) == (3100.5, -0.1)
    assert settings.camera_of("Nikon").focal_px == 3000


def test_template_states_the_values_and_describes_all_keys(tmp_path: Path) -> None:
    values = {
        "project": {"name": 'Bridge "A"\n\\', "crs": "EPSG:6549"},
        "photos": {"folder": Path("in") / "photos", "subfolders": True},
        "attitude": {"rotate_photos": {"DJI_0024.JPG": 180}},
        "cameras": {"FC 300": {"focal_px": 2345.6, "resized_from": (4000, 3000)}},
    }
    text = render_settings(values, {"photos": "18 photos of 9 MP"})
    settings = settings_of(tmp_path, text)
    assert settings.project.name == 'Bridge "A"\n\\'
    assert settings.camera_of("FC 300").resized_from == (4000, 3000)
    assert settings.model_dump(exclude_unset=True)["attitude"] == values["attitude"]
    assert "# 18 photos of 9 MP" in text
    assert max(map(len, text.splitlines())) <= 100
    uncommented = [line.lstrip("# ") for line in text.splitlines()]
    for name, field in Settings.model_fields.items():
        for key in getattr(field.annotation, "model_fields", ()):
            assert any(line.startswith(f"{key} =") for line in uncommented), f"{name}.{key}"


def test_defaults_shown_in_the_template_are_valid() -> None:
    lines = [
        line.removeprefix("# ") if " = " in line and line.startswith("# ") else line
        for line in render_settings({}).partition("\n# Parameters of single")[0].splitlines()
    ]
    shown = [line for line in lines if line.startswith("[") or _is_toml(line)]
    assert Settings.model_validate(tomllib.loads("\n".join(shown))) == Settings()


def _is_toml(line: str) -> bool:
    try:
        return " = " in line and bool(tomllib.loads(line))
    except tomllib.TOMLDecodeError:
        return False


def test_create_writes_a_project_that_opens_and_no_second_one(tmp_path: Path) -> None:
    made = Project.create(tmp_path / "site", {"project": {"name": "Site"}})
    assert Project.open(tmp_path / "site" / "project.toml").settings.project.name == "Site"
    assert made.products == tmp_path / "site" / "products"
    with pytest.raises(InputError, match="is there already"):
        Project.create(tmp_path / "site")
    assert [path.name for path in (tmp_path / "site").iterdir()] == ["project.toml"]


def test_folder_that_is_no_project_is_told_how_to_become_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no project\.toml; make one with `georef init`"):
        Project.open(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        Project.open(tmp_path / "nowhere")


def test_photo_files_follow_patterns_and_exclusions(tmp_path: Path) -> None:
    for name in ("b.JPG", "a.jpg", "c.tif", "no.png", ".hidden.jpg", "sub/d.jpg"):
        path = tmp_path / "photos" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (tmp_path / "project.toml").write_text('[photos]\nexclude = ["a.jpg"]\n')
    assert [path.name for path in Project.open(tmp_path).photo_files()] == ["b.JPG", "c.tif"]
    (tmp_path / "project.toml").write_text("[photos]\nsubfolders = true\n")
    names = [path.name for path in Project.open(tmp_path).photo_files()]
    assert names == ["a.jpg", "b.JPG", "c.tif", "d.jpg"]
    (tmp_path / "project.toml").write_text('[photos]\nfolder = "pics"\n')
    with pytest.raises(InputError, match=r"photos\.folder: no folder .*pics"):
        Project.open(tmp_path).photo_files()


def test_pickled_project_opens_its_own_database(tmp_path: Path) -> None:
    project = Project.create(tmp_path)
    project.database.set_meta(epoch=1.5)
    twin: Project = pickle.loads(pickle.dumps(project))
    assert twin.database.meta("epoch") == 1.5
    assert twin.database is not project.database
    project.close()
    twin.close()


@pytest.mark.parametrize("size", [0, 10, 65_536, 100_000, 400_000])
def test_fingerprint_sees_size_time_and_both_edges(tmp_path: Path, size: int) -> None:
    path = tmp_path / "a.bin"

    def write(content: bytes) -> str:
        path.write_bytes(content)
        os.utime(path, ns=(7, 7))
        return fingerprint(path)

    first = write(bytes(size))
    assert write(bytes(size)) == first
    assert write(bytes(size) + b"\0") != first
    if size:
        assert write(b"x" + bytes(size - 1)) != first
        assert write(bytes(size - 1) + b"x") != first
    write(bytes(size))
    os.utime(path, ns=(8, 8))
    assert fingerprint(path) != first
    assert fingerprint(tmp_path / "none") == ""


def test_whole_fingerprint_is_needed_on_both_sides(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"abc")
    edge, whole = fingerprint(path), fingerprint(path, whole=True)
    assert is_same(whole, edge)
    assert is_same(whole, whole)
    assert not is_same(edge, whole)


def test_many_files_are_named_relative_to_the_project(tmp_path: Path) -> None:
    files = [tmp_path / "site" / "photos" / f"{n}.jpg" for n in range(100)]
    files[0].parent.mkdir(parents=True)
    for file in files:
        file.write_bytes(file.name.encode())
    (tmp_path / "dem.tif").write_bytes(b"dem")
    found = fingerprints([files[0].parent, tmp_path / "dem.tif"], tmp_path / "site")
    assert len(found) == 101
    assert "photos/7.jpg" in found
    assert (tmp_path / "dem.tif").as_posix() in found


def test_file_is_hashed_once_a_run_unless_it_changed(tmp_path: Path) -> None:
    path, known = tmp_path / "a.jpg", {}
    path.write_bytes(b"one")
    first = fingerprints([path], tmp_path, known=known)
    assert fingerprints([path], tmp_path, known=known) == first
    assert len(known) == 1
    path.write_bytes(b"three")
    assert fingerprints([path], tmp_path, known=known) == {"a.jpg": fingerprint(path)}


def test_lock_is_free_again_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), project_lock(tmp_path):
        raise KeyError
    with project_lock(tmp_path), pytest.raises(InputError, match="another run"):
        with project_lock(tmp_path):
            pass


TRY_LOCK = """
import sys
from pathlib import Path
from georef_gis.errors import InputError
from georef_gis.project.lock import project_lock
try:
    with project_lock(Path(sys.argv[1])):
        print("got it")
except InputError as error:
    print(error)
"""


def other_process(folder: Path) -> str:
    """What another process says that tries to take the lock."""
    run = subprocess.run(
        [sys.executable, "-c", TRY_LOCK, str(folder)], capture_output=True, text=True, timeout=60
    )
    return run.stdout + run.stderr


def refused_here(folder: Path) -> bool:
    try:
        with project_lock(folder):
            return False
    except InputError as error:
        return "another run" in str(error)


def test_second_try_of_the_same_process_does_not_drop_the_lock(tmp_path: Path) -> None:
    with project_lock(tmp_path):
        assert refused_here(tmp_path)
        said = other_process(tmp_path)
        assert "another run" in said
        assert f"process {os.getpid()}" in said
    assert other_process(tmp_path).strip() == "got it"


def test_reading_the_lock_file_does_not_drop_the_lock(tmp_path: Path) -> None:
    """As a fingerprint of all files of the folder does."""
    with project_lock(tmp_path):
        fingerprints([tmp_path], tmp_path)
        assert "another run" in other_process(tmp_path)


def test_one_project_by_two_names_has_one_lock(tmp_path: Path) -> None:
    folder, link = tmp_path / "site", tmp_path / "link"
    folder.mkdir()
    link.symlink_to(folder, target_is_directory=True)
    with project_lock(folder):
        assert refused_here(link)
        assert refused_here(folder / ".." / "site")
        assert "another run" in other_process(link)
    assert not refused_here(link)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_forked_worker_does_not_hold_the_lock_on(tmp_path: Path) -> None:
    """The worker outlives the run, as it does when the run is killed."""
    code = TRY_LOCK.replace(
        'print("got it")',
        "import os, time\n"
        "        if os.fork() == 0:\n"
        "            os.close(1); os.close(2); time.sleep(30); os._exit(0)\n"
        "        print('got it', flush=True); os._exit(0)",
    )
    run = subprocess.run([sys.executable, "-c", code, str(tmp_path)],
                         capture_output=True, text=True, timeout=60)  # fmt: skip
    assert "got it" in run.stdout, run.stderr
    assert other_process(tmp_path).strip() == "got it"


def test_windows_locks_a_byte_behind_the_note(tmp_path: Path, monkeypatch) -> None:
    """By the calls that msvcrt documents: the byte at the position of the file, not waiting."""
    calls: list[tuple[int, int, int]] = []
    taken = False

    def locking(stream: int, mode: int, count: int) -> None:
        calls.append((os.lseek(stream, 0, os.SEEK_CUR), mode, count))
        if taken:
            raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    with project_lock(tmp_path):
        assert (tmp_path / ".georef.lock").read_bytes().startswith(b'{"process"')
    assert calls == [(1 << 20, 2, 1)]
    taken = True
    assert refused_here(tmp_path)


def test_file_that_may_not_be_read_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clicks.csv"
    path.touch()

    def refuse(*_: object, **__: object) -> None:
        # root may read anything
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(InputError, match=r"clicks\.csv: cannot be read: Permission denied; check"):
        fingerprints([path], tmp_path)
