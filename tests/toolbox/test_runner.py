"""The runner: order, what is skipped, what makes a step stale, and runs that end badly."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from georef_gis.errors import Cancelled, ExportError, InputError, PluginError
from georef_gis.project import Project
from georef_gis.project.lock import project_lock
from georef_gis.toolbox import Algorithm, CollectingFeedback, Context, Feedback, Result
from georef_gis.toolbox import parameters as p
from georef_gis.toolbox.pipeline import plan_steps
from georef_gis.toolbox.registry import Registry
from georef_gis.toolbox.runner import run_pipeline, run_tool
from georef_gis.toolbox.steps import RunOptions, StepReport


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """Registry of the toy plug-in, imported from its source."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "toy_plugin"))
    import toy_georef

    registry = Registry()
    registry.add("toy", (*toy_georef.ALGORITHMS, *toy_georef.EXPORTERS), "toy-georef", "0.3")
    assert registry.refused == []
    return registry


@pytest.fixture
def project(site: Path) -> Iterator[Project]:
    found = Project.open(site)
    yield found
    found.close()


def ran(reports: list[StepReport]) -> list[str]:
    return [report.tool.id for report in reports if not report.skipped]


def run(registry: Registry, site: Path, **options: Any) -> list[StepReport]:
    """Run the pipeline as a new process would: with settings and database opened anew."""
    values = options.pop("values", None)
    project = Project.open(site)
    try:
        return run_pipeline(
            registry, project, CollectingFeedback(), values=values, options=RunOptions(**options)
        )
    finally:
        project.close()


def test_unchanged_site_skips_all_and_keeps_the_summary(toy: Registry, site: Path) -> None:
    assert ran(run(toy, site)) == ["count", "double"]
    again = run(toy, site)
    assert ran(again) == []
    assert again[0].result.summary["products"] == [str(site / "products" / "count.txt")]
    assert again[1].result.summary["double"] == 6


def _edit_photo(site: Path) -> None:
    (site / "photos" / "P1.JPG").write_bytes(b"other")


def _same_size_and_edge(site: Path) -> None:
    os.utime(site / "photos" / "P1.JPG", ns=(1, 1))


def _add_photo(site: Path) -> None:
    (site / "photos" / "P9.jpg").write_bytes(b"new")


def _remove_photo(site: Path) -> None:
    (site / "photos" / "P1.JPG").unlink()


def _change_parameter(site: Path) -> None:
    with (site / "project.toml").open("a") as stream:
        stream.write('[tools.count]\nstep = "5cm"\n')


def _change_setting(site: Path) -> None:
    with (site / "project.toml").open("a") as stream:
        stream.write('[photos]\nexclude = ["P0.JPG"]\n')


def _remove_product(site: Path) -> None:
    (site / "products" / "count.txt").unlink()


def _empty_product(site: Path) -> None:
    (site / "products" / "count.txt").write_text("")


def _remove_database(site: Path) -> None:
    (site / "georef.gpkg").unlink()


@pytest.mark.parametrize(
    "change",
    [
        _edit_photo, _same_size_and_edge, _add_photo, _remove_photo, _change_parameter,
        _change_setting, _remove_product, _empty_product, _remove_database,
    ],
)  # fmt: skip
def test_change_makes_the_step_and_what_needs_it_run(
    toy: Registry, site: Path, change: Any
) -> None:
    run(toy, site)
    change(site)
    assert ran(run(toy, site)) == ["count", "double"]
    assert ran(run(toy, site)) == []


def test_settings_that_a_step_does_not_read_leave_it_alone(toy: Registry, site: Path) -> None:
    run(toy, site)
    with (site / "project.toml").open("a") as stream:
        stream.write("[gnss]\nsigma_h_m = 0.02\n[tools.double]\nfactor = 3\n")
    assert ran(run(toy, site)) == ["double"]


def test_new_version_of_a_tool_makes_it_stale(
    toy: Registry, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(toy, site)
    monkeypatch.setattr(toy.find("double").algorithm, "version", "2")
    reports = run(toy, site)
    assert ran(reports) == ["double"]
    assert reports[1].reason == "versions changed: tool"


def test_edited_product_is_left_alone_unless_verified(toy: Registry, site: Path) -> None:
    run(toy, site, verify=True)
    (site / "products" / "count.txt").write_text("3 by hand")
    assert ran(run(toy, site)) == []
    assert ran(run(toy, site, verify=True)) == ["count", "double"]
    assert ran(run(toy, site, verify=True)) == []


def test_verify_sees_a_change_between_the_edges_and_no_change_of_time(
    toy: Registry, site: Path
) -> None:
    photo = site / "photos" / "P1.JPG"
    photo.write_bytes(bytes(300_000))
    run(toy, site, verify=True)
    times = (photo.stat().st_atime_ns, photo.stat().st_mtime_ns)
    photo.write_bytes(bytes(150_000) + b"x" + bytes(149_999))
    os.utime(photo, ns=times)
    assert ran(run(toy, site)) == []
    assert ran(run(toy, site, verify=True)) == ["count", "double"]
    os.utime(photo, ns=(5, 5))
    assert ran(run(toy, site, verify=True)) == []


def test_moved_project_is_up_to_date(toy: Registry, site: Path, tmp_path: Path) -> None:
    run(toy, site)
    moved = tmp_path.parent / f"{tmp_path.name}_moved"
    site.rename(moved)
    assert ran(run(toy, moved)) == []


def test_command_line_goes_before_project_toml(toy: Registry, site: Path) -> None:
    _change_parameter(site)
    run(toy, site, values={"count": {"step": "7cm"}})
    assert "at 0.07 m" in (site / "products" / "count.txt").read_text()


def test_only_from_and_force(toy: Registry, site: Path) -> None:
    with pytest.raises(InputError, match="needs count, which count gives and which is not there"):
        run(toy, site, only=("double",))
    run(toy, site)
    assert ran(run(toy, site, only=("double",))) == []
    assert ran(run(toy, site, only=("double",), force=True)) == ["double"]
    assert ran(run(toy, site, start="count")) == ["count", "double"]
    assert ran(run(toy, site, force=True)) == ["count", "double"]
    with pytest.raises(InputError, match="look_at is no step of the run"):
        run(toy, site, only=("look_at",))


def test_unfit_parameter_of_a_late_step_stops_before_the_first(toy: Registry, site: Path) -> None:
    with pytest.raises(InputError, match="tool double: factor: 0 is not allowed"):
        run(toy, site, values={"double": {"factor": 0}})
    assert not (site / "products").exists()


def test_record_tells_what_went_in_and_came_out(toy: Registry, project: Project) -> None:
    (project.folder / "photos" / "P2.JPG").write_bytes(b"")
    run_pipeline(toy, project, CollectingFeedback())
    record = project.database.rows("run", {"tool": "toy:count"})[0]
    assert record["outcome"] == "done"
    assert record["parameters"] == {"step": 1.0, "pause": 0.0, "note": None}
    assert record["versions"] == {"tool": "1", "toy-georef": "0.3", "georef-gis": "0.1.0"}
    assert set(record["inputs"]) == {"photos/P0.JPG", "photos/P1.JPG", "photos/P2.JPG"}
    assert set(record["outputs"]) == {"products/count.txt"}
    assert record["warnings"] == ["a photo is empty"]


def test_failed_step_is_recorded_and_runs_again(toy: Registry, site: Path) -> None:
    class Fails(Algorithm[p.Parameters]):
        """Fail once."""

        id, name, group = "fails", "Fails", "ingest"
        in_run = True
        fail = True

        def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
            if Fails.fail:
                raise InputError("is dark", source="P0.JPG")
            return Result()

    toy.add("toy", (Fails,), "toy-georef", "0.3")
    with pytest.raises(InputError, match="is dark"):
        run(toy, site)
    with Project.open(site).database as database:
        row = database.last_rows("run", "tool")[-1]
    assert (row["outcome"], row["message"]) == ("failed", "P0.JPG: is dark")
    Fails.fail = False
    reports = run(toy, site)
    assert ran(reports) == ["fails", "double"]
    assert reports[1].reason == "its last run failed"


class Broken(Exception):
    """A bug."""


@pytest.mark.parametrize(
    ("makes", "error", "outcome"),
    [
        ({}, InputError("no such photo"), "refused"),
        ({}, ExportError("the disk is full"), "refused"),
        ({}, Broken("a bug"), "failed"),
        ({}, Cancelled("stopped by the user"), "cancelled"),
        ({"gives": ("answer",)}, InputError("no such photo"), "failed"),
        ({"in_run": True}, InputError("no such photo"), "failed"),
    ],
)
def test_a_refused_question_is_no_failure_of_the_project(
    toy: Registry, project: Project, makes: dict[str, Any], error: Exception, outcome: str
) -> None:
    class Ask(Algorithm[p.Parameters]):
        """Ask."""

        id, name, group = "ask", "Ask", "measure"

        def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
            raise error

    for name, value in makes.items():
        setattr(Ask, name, value)
    toy.add("toy", (Ask,), "toy-georef", "0.3")
    with pytest.raises(type(error)):
        run_tool(toy, "ask", {}, CollectingFeedback(), project=project)
    assert [row["outcome"] for row in project.database.rows("run")] == [outcome]


def test_cancelled_run_is_recorded_and_runs_again(toy: Registry, site: Path) -> None:
    project = Project.open(site)
    with pytest.raises(Cancelled):
        run_pipeline(toy, project, CollectingFeedback(stop_at=0.1))
    assert [row["outcome"] for row in project.database.rows("run")] == ["cancelled"]
    project.close()
    assert ran(run(toy, site)) == ["count", "double"]


def test_progress_covers_the_whole_run(toy: Registry, project: Project) -> None:
    feedback = CollectingFeedback()
    run_pipeline(toy, project, feedback)
    assert feedback.fractions == sorted(feedback.fractions)
    assert feedback.fractions[-1] == 1.0
    assert max(feedback.fractions[:-1]) < 0.5  # the first of two steps has three photos


def test_single_tool_of_the_run_is_skipped_too(toy: Registry, project: Project) -> None:
    feedback = CollectingFeedback()
    assert not run_tool(toy, "count", {"step": "2m"}, feedback, project=project).skipped
    assert run_tool(toy, "count", {"step": "200cm"}, feedback, project=project).skipped
    assert not run_tool(toy, "count", {"step": "3m"}, feedback, project=project).skipped


def test_full_disk_and_unknown_tool_table_are_told_to_the_user(
    toy: Registry, site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> Result:
        raise OSError(28, "No space left on device", "count.txt")

    monkeypatch.setattr(toy.find("count").algorithm, "run", full)
    (site / "project.toml").write_text("[tools.cuont]\nstep = 1\n")
    feedback, project = CollectingFeedback(), Project.open(site)
    with pytest.raises(ExportError, match=r"tool count: count\.txt: No space left on device; che"):
        run_pipeline(toy, project, feedback)
    project.close()
    assert (
        "[tools.cuont] is not used: there is no tool 'cuont'; did you mean count?"
        in (feedback.warnings[0])
    )


def test_folder_parameter_and_folder_product_are_watched(toy: Registry, site: Path) -> None:
    class CopyParameters(p.Parameters):
        source: p.Folder = p.folder(title="From")

    class Copy(Algorithm[CopyParameters]):
        """Copy a folder."""

        id, name, group = "copy", "Copy", "ingest"
        in_run = True

        def run(self, context: Context, parameters: CopyParameters, feedback: Feedback) -> Result:
            target = context.require_project().products / "copies"
            target.mkdir(exist_ok=True)
            for file in parameters.source.iterdir():
                (target / file.name).write_bytes(file.read_bytes())
            return Result(outputs={"copies": target})

    toy.add("toy", (Copy,), "toy-georef", "0.3")
    (site / "project.toml").write_text('[tools.copy]\nsource = "logs"\n')
    (site / "logs").mkdir()
    (site / "logs" / "imu.csv").write_text("1")
    run(toy, site)
    assert ran(run(toy, site, verify=True)) == ["count", "copy", "double"]  # first whole hashes
    assert ran(run(toy, site, verify=True)) == []
    (site / "products" / "copies" / "imu.csv").unlink()
    assert ran(run(toy, site)) == ["copy"]
    (site / "logs" / "gnss.csv").write_text("2")
    assert ran(run(toy, site)) == ["copy"]


def test_one_run_at_a_time(toy: Registry, site: Path) -> None:
    with project_lock(site), pytest.raises(InputError, match="another run works on this project"):
        run(toy, site)
    assert ran(run(toy, site)) == ["count", "double"]


class Preview(Algorithm[p.Parameters]):
    """Give what the first answer needs."""

    id, name, group = "preview", "Preview", "ingest"
    wants, gives, in_run, first_answer = ("better",), ("preview",), True, True

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        return Result()


class Answer(Preview):
    """Give the first answer."""

    id, name = "answer", "Answer"
    needs, gives = ("preview",), ()


class Better(Preview):
    """Better it."""

    id, name = "better", "Better"
    wants, gives, refines, first_answer = (), ("better",), True, False


@pytest.mark.parametrize("killed", ["preview", "answer"])
def test_run_killed_in_its_first_answer_goes_on_with_it(site: Path, killed: str) -> None:
    registry, told = Registry(), CollectingFeedback()
    registry.add("toy", (Preview, Answer, Better), "toy-georef", "0.3")
    project = Project.open(site)
    project.prepare()
    project.database.insert("run", {"tool": f"toy:{killed}", "outcome": "started"})
    reports = run_pipeline(registry, project, told)
    ids = [row["tool"] for row in project.database.rows("run")][1:]
    project.close()
    assert ran(reports) == ["better", "preview", "answer"]
    first = ["toy:preview", "toy:answer"]
    assert ids == [*first, "toy:better", *first]


def test_tools_that_need_each_other_are_refused(toy: Registry) -> None:
    class Circle(Algorithm[p.Parameters]):
        """Need what needs this."""

        id, name, group = "circle", "Circle", "ingest"
        needs, gives, in_run = ("double",), ("count",), True

        def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
            return Result()

    toy.add("toy", (Circle,), "toy-georef", "0.3")
    with pytest.raises(PluginError, match="in a circle: toy:circle, toy:double"):
        plan_steps(toy)


class Slow:
    """A `georef run` in a process of its own that is in the middle of counting."""

    def __init__(self, site: Path, plugins: Path) -> None:
        self.site = site
        self.command = [sys.executable, "-m", "georef_gis.app", "run", str(site)]
        self.command += ["--only", "count,double"]
        self.environment = {**os.environ, "PYTHONPATH": str(plugins)}

    def start(self) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*self.command, "--set", "count.pause=20"], env=self.environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        until = time.monotonic() + 20
        while time.monotonic() < until and not self.outcomes():
            time.sleep(0.02)
        return process

    def outcomes(self) -> list[str]:
        if not (self.site / "georef.gpkg").exists():
            return []
        try:
            with Project.open(self.site, read_only=True).database as database:
                return [row["outcome"] for row in database.rows("run")]
        except InputError:
            return []  # the file is only just being laid out

    def finish(self) -> subprocess.CompletedProcess[str]:
        return subprocess.run(self.command, env=self.environment, text=True, capture_output=True)


def test_killed_run_is_done_again(site: Path, plugins: Path) -> None:
    slow = Slow(site, plugins)
    process = slow.start()
    locked = slow.finish()
    process.kill()
    process.communicate()
    assert locked.returncode == 2
    assert f"another run works on this project (process {process.pid}" in locked.stderr
    assert slow.outcomes() == ["started"]
    done = slow.finish()
    assert done.returncode == 0, done.stderr
    assert "its last run was not finished" in done.stdout
    assert (site / "products" / "count.txt").read_text().startswith("3 at")
    assert slow.outcomes() == ["started", "done", "done"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_run_stops_at_once(site: Path, plugins: Path, number: int) -> None:
    slow = Slow(site, plugins)
    process = slow.start()
    began = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=10)
    assert process.returncode == 130
    assert errors.strip() == "georef: cancelled"
    assert time.monotonic() - began < 5.0  # s: the step itself would sleep 60 s
    assert slow.outcomes() == ["cancelled"]
