# SPDX-License-Identifier: GPL-2.0-or-later
"""QGIS plug-in: the tools of georef in the Processing toolbox.

Standard library and qgis only; it runs georef in a process of its own. Python 3.8 and later, as
QGIS 3.22 brings it.
"""

from __future__ import annotations

from typing import Any


def classFactory(iface: Any) -> Any:
    """Plug-in, as QGIS asks for it; `iface` is None without a window."""
    from .plugin import GeorefPlugin

    return GeorefPlugin(iface)
