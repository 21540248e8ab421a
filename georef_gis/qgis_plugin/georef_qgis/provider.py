# SPDX-License-Identifier: GPL-2.0-or-later
# mypy: disable-error-code="import-not-found, misc"
"""The provider: one algorithm for every tool in georef's manifest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from qgis.core import QgsApplication, QgsMessageLog, QgsProcessingProvider, QgsSettings
from qgis.PyQt.QtGui import QIcon

from . import compat
from .algorithm import HERE, GeorefAlgorithm, ShowProject
from .manifest import CACHE, find_command, load_manifest, read_config
from .tools import ManifestError, read_tools

SETTING = "GEOREF_PROGRAM"
SETTING_TITLE = "georef program, or the Python it is installed in (empty: as installed)"


class GeorefProvider(QgsProcessingProvider):
    """Tools of georef; `problem` says in one line why there are none, empty if all is well."""

    def __init__(self) -> None:
        super().__init__()
        self.problem = ""
        self._program = ""
        self._config: Any = None

    def id(self) -> str:
        """Id, which begins those of the algorithms."""
        return "georef"

    def name(self) -> str:
        """Name in the toolbox."""
        return "georef"

    def longName(self) -> str:
        """Name with the version of georef."""
        version = read_config(HERE).get("version", "")
        return f"georef {version}".strip()

    def icon(self) -> Any:
        """Icon of georef."""
        return QIcon(self.svgIconPath())

    def svgIconPath(self) -> str:
        """File of the icon."""
        return str(HERE / "icon.svg")

    def warningMessage(self) -> str:
        """What the toolbox shows above the algorithms: why there are none."""
        return self.problem

    def load(self) -> bool:
        """Declare the setting and make the algorithms."""
        try:
            from processing.core.ProcessingConfig import (
                ProcessingConfig,
                Setting,
                settingsWatcher,
            )
        except ImportError:
            # QGIS without its Processing plug-in, as in a script of one's own
            ProcessingConfig = None
        if ProcessingConfig is not None:
            ProcessingConfig.settingIcons[self.name()] = self.icon()
            ProcessingConfig.addSetting(
                Setting(self.name(), SETTING, SETTING_TITLE, "", valuetype=Setting.FILE)
            )
            ProcessingConfig.readSettings()
            settingsWatcher.settingsChanged.connect(self._refresh)
            self._config = (ProcessingConfig, settingsWatcher)
        self.refreshAlgorithms()
        return True

    def unload(self) -> None:
        """Take the setting away."""
        if self._config is not None:
            config, watcher = self._config
            watcher.settingsChanged.disconnect(self._refresh)
            config.settingIcons.pop(self.name(), None)
            config.settings.pop(SETTING, None)
            self._config = None

    def loadAlgorithms(self) -> None:
        """Make the algorithms; without georef the provider has none and says why."""
        self.problem, self._program = "", _chosen()
        self.addAlgorithm(ShowProject())
        try:
            config = read_config(HERE)
            command = find_command(config, self._program)
            for tool in read_tools(load_manifest(command, config, _cache())):
                self.addAlgorithm(GeorefAlgorithm(tool, command))
        except ManifestError as error:
            self.problem = str(error)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            self.problem = f"the list of tools of georef cannot be read ({error!r}); {_AGAIN}"
        if self.problem:
            QgsMessageLog.logMessage(self.problem, "georef", compat.WARNING)

    def _refresh(self) -> None:
        if _chosen() != self._program:
            self.refreshAlgorithms()


_AGAIN = "run `georef qgis install` again"


def _chosen() -> str:
    """Program that the user named in the settings."""
    return str(QgsSettings().value(f"Processing/Configuration/{SETTING}", "") or "")


def _cache() -> Path:
    """File for the manifest, in the profile: the plug-in's own folder may be read-only."""
    return Path(QgsApplication.qgisSettingsDirPath()) / "cache" / "georef_qgis" / CACHE
