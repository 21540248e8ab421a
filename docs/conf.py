"""Settings of the site, for Sphinx; `build_site.py` makes it."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "Georef GIS"
author = "the authors of Georef GIS"
version = release = version_of("georef-gis")
extensions = ["myst_parser", "site_builder.links"]
root_doc = "index"
source_suffix = {".md": "markdown"}
language = "en"
# the same pages give the same bytes
html_last_updated_fmt = None
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_show_sourcelink = False

myst_heading_anchors = 4
# straight quotes and two minus signs are options and units here
smartquotes = False
# blocks without a language are commands, tables of numbers, trees of folders
highlight_language = "none"
nitpicky = True
pygments_style = "friendly"
pygments_dark_style = "native"

html_theme = "furo"
html_title = "Georef GIS"
html_static_path = ["site_builder/static"]
html_css_files = ["site.css"]
# after Sphinx's own settings, which it mends
html_js_files = [("from_disk.js", {"priority": 300})]
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#0b5c7a",
        "color-brand-content": "#0b5c7a",
        "color-brand-visited": "#5b3f86",
    },
    "dark_css_variables": {
        "color-brand-primary": "#6cc3e0",
        "color-brand-content": "#6cc3e0",
        "color-brand-visited": "#b79be0",
    },
    # the system's own: nothing is fetched
    "top_of_page_buttons": [],
}
