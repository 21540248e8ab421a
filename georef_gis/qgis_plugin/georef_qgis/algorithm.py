# SPDX-License-Identifier: GPL-2.0-or-later
# mypy: disable-error-code="import-not-found, misc"
"""A tool of georef as an algorithm of Processing."""

from __future__ import annotations

import html
import os
import re
from pathlib import Path
from typing import Any

from qgis.core import (
    QgsApplication,
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputFile,
    QgsProcessingOutputFolder,
    QgsProcessingOutputRasterLayer,
    QgsProcessingOutputVectorLayer,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterFile,
    QgsProcessingParameterNumber,
    QgsProcessingUtils,
    QgsProject,
)
from qgis.PyQt.QtGui import QIcon

from . import child, compat, products
from .help_page import write_page
from .loading import show_on_completion
from .parameters import Reader, is_given, make_parameters, temporary
from .telling import tell, tell_result
from .tools import RUN, Tool, arguments

HERE = Path(__file__).parent
PROJECT, SHOW, FORCE, WORKERS = "PROJECT", "SHOW_LAYERS", "FORCE", "WORKERS"
SETTINGS = "project.toml"
GROUPS = {
    "project": "1 Project",
    "ingest": "2 Photos and logs",
    "navigate": "3 Trajectory",
    "orient": "4 Orientation and calibration",
    "rectify": "5 Footprints and orthos",
    "mosaic": "6 Mosaic",
    "measure": "7 Measuring",
    "export": "8 Export",
}
OUTPUTS = {
    "File": QgsProcessingOutputFile,
    "Folder": QgsProcessingOutputFolder,
    "RasterLayer": QgsProcessingOutputRasterLayer,
    "VectorLayer": QgsProcessingOutputVectorLayer,
}


class GeorefBase(QgsProcessingAlgorithm):
    """What all algorithms of georef share."""

    def icon(self) -> Any:
        """Icon of georef."""
        return QIcon(str(HERE / "icon.svg"))

    def svgIconPath(self) -> str:
        """File of the icon."""
        return str(HERE / "icon.svg")

    def add_project(self) -> None:
        """Add the parameter for the folder of a project."""
        made = QgsProcessingParameterFile(
            PROJECT, "Folder of the project", compat.FOLDER, "", _project_nearby()
        )
        made.setHelp(f"The folder that holds {SETTINGS}; `New project` makes one")
        self.addParameter(made)

    def add_flag(self, name: str, title: str, default: bool, *, advanced: bool = False) -> None:
        """Add a parameter that is on or off."""
        made = QgsProcessingParameterBoolean(name, title, default)
        if advanced:
            made.setFlags(made.flags() | compat.ADVANCED)
        self.addParameter(made)

    def project_folder(self, parameters: Any, context: Any) -> str:
        """Folder of the project that was given."""
        folder = self.parameterAsFile(parameters, PROJECT, context)
        return os.path.abspath(folder) if folder else ""

    def check_project(self, parameters: Any, context: Any) -> str:
        """What is wrong with the folder of the project, in one line; empty if nothing is."""
        folder = self.project_folder(parameters, context)
        if folder and os.path.isfile(os.path.join(folder, SETTINGS)):
            return ""
        return f"{folder or 'no folder'}: holds no {SETTINGS}; make a project with `New project`"


class GeorefAlgorithm(GeorefBase):
    """One tool, run as a process."""

    def __init__(self, tool: Tool, command: list[str]) -> None:
        super().__init__()
        self.tool = tool
        self.command = command

    def createInstance(self) -> GeorefAlgorithm:
        """Another one of the same tool."""
        return GeorefAlgorithm(self.tool, self.command)

    def name(self) -> str:
        """Id within the provider."""
        return self.tool.name

    def displayName(self) -> str:
        """Name in the toolbox."""
        return self.tool.title

    def group(self) -> str:
        """Group in the toolbox, numbered in the order of the work."""
        return GROUPS.get(self.tool.group, self.tool.group.capitalize())

    def groupId(self) -> str:
        """Id of the group."""
        return self.tool.group

    def tags(self) -> list[str]:
        """Words by which the toolbox finds it too."""
        return ["georef", *self.tool.words, *self.tool.name.split("_")]

    def shortDescription(self) -> str:
        """First line of the help."""
        return self.tool.help.partition("\n")[0]

    def shortHelpString(self) -> str:
        """Help beside the dialog: that of the tool, then that of each parameter."""
        parts = [f"<p>{_flowing(part)}</p>" for part in self.tool.help.split("\n\n")]
        hints = [(field.title, field.hint()) for field in self.tool.fields if field.hint()]
        if hints:
            items = (f"<p><b>{html.escape(t)}</b><br>{_flowing(h)}</p>" for t, h in hints)
            parts += ["<h3>Parameters</h3>", *items]
        if self.tool.needs_project:
            parts.append("<p>Parameters that are left as they are give way to project.toml.</p>")
        return "".join(parts)

    def helpUrl(self) -> str:
        """Page of the tool: that of the documentation, or one made from the manifest."""
        return self.tool.page or write_page(self.tool, help_folder())

    def initAlgorithm(self, configuration: Any = None) -> None:
        """Declare parameters and outputs."""
        if self.tool.needs_project:
            self.add_project()
        for field in self.tool.fields:
            for definition in make_parameters(field):
                self.addParameter(definition)
        if self.tool.in_run or self.tool.is_run:
            self.add_flag(FORCE, "Run what is up to date too", False, advanced=True)
        workers = QgsProcessingParameterNumber(
            WORKERS, "Processes to use (all processors if not set)", compat.INTEGER, None, True, 1
        )
        workers.setFlags(workers.flags() | compat.ADVANCED)
        self.addParameter(workers)
        taken = {definition.name() for definition in self.outputDefinitions()}
        for field in self.tool.fields:
            if field.writes and field.name not in taken:
                self.addOutput(QgsProcessingOutputFolder(field.name, field.title))
        for out in self.tool.outputs:
            if out.name not in taken and out.type in OUTPUTS:
                self.addOutput(OUTPUTS[out.type](out.name, out.title))
        if self.tool.needs_project:
            # So that a model can hand the project on to its next step.
            self.addOutput(QgsProcessingOutputFolder("project_folder", "Folder of the project"))
        if self.outputDefinitions():
            self.add_flag(SHOW, "Show the results on the map", True)

    def checkParameterValues(self, parameters: Any, context: Any) -> tuple[bool, str]:
        """Whether the parameters can be used, and what is wrong."""
        fine, message = super().checkParameterValues(parameters, context)
        if not fine:
            wrong = (f for f in self.tool.fields if message.endswith(f" {f.name}") and f.limits())
            return fine, message + "".join(f"; give {field.limits()}" for field in wrong)
        if self.tool.needs_project:
            message = self.check_project(parameters, context)
        return not message, message

    def processAlgorithm(self, parameters: Any, context: Any, feedback: Any) -> dict[str, Any]:
        """Run georef and hand on what it tells."""
        project = self.project_folder(parameters, context) if self.tool.needs_project else ""
        values = self._values(parameters, context, feedback)
        words = arguments(self.tool, values, self._extra(parameters, context), project)
        feedback.pushCommandInfo(child.typed([*self.command, *words]))
        warned: set[str] = set()
        outcome = child.run(
            [*self.command, *words],
            lambda event: tell(event, feedback, warned),
            feedback.isCanceled,
            project or QgsProcessingUtils.tempFolder(),
        )
        if outcome.cancelled:
            feedback.pushInfo(
                "Cancelled; what was finished before is there, nothing is half-written."
            )
            return {}
        if outcome.error:
            raise QgsProcessingException(outcome.error.replace("`georef run`", f"`{RUN['name']}`"))
        for result in outcome.results:
            tell_result(result, feedback, warned)
        return self._finish(outcome.results, values, project, parameters, context)

    def _values(self, parameters: Any, context: Any, feedback: Any) -> dict[str, Any]:
        reader = Reader(self, parameters, context, feedback)
        return {field.name: reader.value(field) for field in self.tool.fields}

    def _extra(self, parameters: Any, context: Any) -> list[str]:
        """Options that every tool has."""
        extra = []
        if self.parameterAsBool(parameters, FORCE, context):
            extra.append("--force")
        if is_given(parameters, WORKERS):
            extra.append(f"--workers={self.parameterAsInt(parameters, WORKERS, context)}")
        return extra

    def _finish(
        self, results: Any, values: dict[str, Any], project: str, parameters: Any, context: Any
    ) -> dict[str, Any]:
        """Outputs by name; their layers are shown at the end if the user wants to."""
        names = [out.name for out in self.tool.outputs]
        folder = Path(project) if project else None
        outputs: dict[str, Any] = dict(products.outputs_by_name(names, results, folder))
        told = [Path(path) for path in outputs.values()]
        written = {f.name: values[f.name] for f in self.tool.fields if f.writes and values[f.name]}
        outputs.update(written)
        if project:
            outputs["project_folder"] = project
        if self.parameterAsBool(parameters, SHOW, context):
            told += [Path(path) for path in written.values()]
            # QGIS calls a temporary file by its parameter: `target` for all of them.
            titles = {
                Path(path): self.tool.title
                for name, path in written.items()
                if Path(path).stem == name
            }
            show_on_completion(self._files_to_show(results, told, project), folder, context, titles)
        return outputs

    def _files_to_show(self, results: Any, told: list[Path], project: str) -> list[Path]:
        """Files whose layers are shown; places that were only told get a temporary one."""
        if self.tool.is_run:
            return products.project_products(Path(project))
        files = products.without_copies(products.all_products(results) or told)
        places = products.measured_places(results)
        if places and not any(path.suffix.lower() == ".csv" for path in files):
            files.append(Path(temporary(f"{self.tool.name}.csv")))
            products.write_places(files[-1], places)
        return files


class ShowProject(GeorefBase):
    """Adds the layers of a project to the map; georef itself does not run."""

    def createInstance(self) -> ShowProject:
        """Another one."""
        return ShowProject()

    def name(self) -> str:
        """Id within the provider."""
        return "show_project"

    def displayName(self) -> str:
        """Name in the toolbox."""
        return "Show a project on the map"

    def group(self) -> str:
        """Group in the toolbox."""
        return GROUPS["project"]

    def groupId(self) -> str:
        """Id of the group."""
        return "project"

    def shortHelpString(self) -> str:
        """Help beside the dialog."""
        return (
            "<p>Add mosaic, footprints, photos, control points and assets of a project to the map, "
            "with their styles. They are those that the last run wrote.</p>"
        )

    def initAlgorithm(self, configuration: Any = None) -> None:
        """Declare parameters and outputs."""
        self.add_project()
        self.addOutput(QgsProcessingOutputFolder("project_folder", "Folder of the project"))

    def checkParameterValues(self, parameters: Any, context: Any) -> tuple[bool, str]:
        """Whether the parameters can be used, and what is wrong."""
        fine, message = super().checkParameterValues(parameters, context)
        message = message or self.check_project(parameters, context)
        return fine and not message, message

    def processAlgorithm(self, parameters: Any, context: Any, feedback: Any) -> dict[str, Any]:
        """Find the layers."""
        folder = Path(self.project_folder(parameters, context))
        files = products.project_products(folder)
        if not files:
            raise QgsProcessingException(
                f"{folder}: has no products yet; run `Make the products of a project` first"
            )
        show_on_completion(files, folder, context, {})
        return {"project_folder": str(folder)}


def _flowing(text: str) -> str:
    """Text as HTML in one line: QGIS makes a paragraph of every one."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(" ".join(text.split())))


def help_folder() -> Path:
    """Folder for help pages, in the profile."""
    return Path(QgsApplication.qgisSettingsDirPath()) / "cache" / "georef_qgis" / "help"


def _project_nearby() -> str | None:
    """Folder of the QGIS project, if a project of georef lies there too."""
    home = QgsProject.instance().homePath()
    return home if home and os.path.isfile(os.path.join(home, SETTINGS)) else None
