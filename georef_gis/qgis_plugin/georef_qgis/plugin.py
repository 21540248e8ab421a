# SPDX-License-Identifier: GPL-2.0-or-later
# mypy: disable-error-code="import-not-found"
"""The plug-in as QGIS loads it: it adds the provider, and takes it away again."""

from __future__ import annotations

from typing import Any

from qgis.core import QgsApplication

from . import compat
from .provider import GeorefProvider


class GeorefPlugin:
    """Plug-in without windows of its own."""

    def __init__(self, iface: Any) -> None:
        self.iface = iface
        self.provider: GeorefProvider | None = None

    def initProcessing(self) -> None:
        """Add the provider; all that `qgis_process` calls."""
        if self.provider is None:
            self.provider = GeorefProvider()
            QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self) -> None:
        """Add the provider, and say so if georef is not there."""
        self.initProcessing()
        if self.provider is not None and self.provider.problem and self.iface is not None:
            self.iface.messageBar().pushMessage("georef", self.provider.problem, compat.WARNING, 0)

    def unload(self) -> None:
        """Take the provider away."""
        if self.provider is not None:
            QgsApplication.processingRegistry().removeProvider(self.provider)
            self.provider = None
