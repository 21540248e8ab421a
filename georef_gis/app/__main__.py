"""``python -m georef_gis.app``: the command line where the script is not on the path."""

from georef_gis.app.cli import main

main()
