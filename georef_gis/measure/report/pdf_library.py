"""Whether reportlab, which lays out the PDF, can be used here."""

from __future__ import annotations

import importlib
from importlib.util import find_spec

from georef_gis.errors import InputError

# all of it that the PDF takes, so that a broken part is found before the work begins
_PARTS = ("rl_config", "lib.pagesizes", "lib.styles", "pdfbase.pdfmetrics", "pdfbase.ttfonts",
          "platypus", "platypus.tableofcontents")  # fmt: skip
_INSTALL = 'pip install "georef-gis[pdf]"'
_AGAIN = 'pip install --force-reinstall "georef-gis[pdf]"'
_MOST_SAID = 120


def require_reportlab(*, beside: str) -> None:
    """Import reportlab.

    Parameters
    ----------
    beside
        Name of the page that was written without it.

    Raises
    ------
    InputError
        If it is not installed, or its import fails in any way.
    """
    try:
        is_there = find_spec("reportlab") is not None
    except ValueError:
        # in sys.modules without a spec: import tells
        is_there = True
    if not is_there:
        raise InputError(
            f"a PDF needs reportlab, which is not installed; {_INSTALL}; {beside} is written",
            field="pdf",
        )
    for part in _PARTS:
        try:
            importlib.import_module(f"reportlab.{part}")
        # a broken installation raises whatever its first line that fails does
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())[:_MOST_SAID]
            raise InputError(
                f"a PDF needs reportlab, which is installed but cannot be loaded ({said}); "
                f"{_AGAIN}; {beside} is written",
                field="pdf",
            ) from error
