"""Examples for the pages of commands whose chapter shows none that may be typed as it is."""

from __future__ import annotations

LINES = """
georef accuracy --project my_site
georef accuracy-table residuals.csv --target-rmse-h 5cm --target-rmse-v 10cm
georef calibrate-mount exposures.csv --camera camera.json --targets targets.csv --marks marks.csv --target mount.toml
georef check photos --target fly_again.kml
georef export-cog --project my_site --layer mosaic --compression webp
georef export-tagged-photos --project my_site --heights ellipsoidal
georef export-xyz-tiles --project my_site
georef intersect --project my_site --marks marks.csv --target points.csv
georef locate --project sample_project --pixel IMG_0013.JPG:421.8,249.7
georef match-clicks --project sample_project --pixel IMG_0013.JPG:410.7,690
georef measure-photo DJI_0042.JPG --pixel 100,200 --pixel 300,400
georef mosaic-sheets --project my_site --line road.gpkg --length 500ft
georef orthos --project my_site --photos IMG_0013.JPG --photos IMG_0014.JPG
georef profile --project sample_project --corner 1694000,219080 --corner 1694080,219110
georef simulate my_flight
georef surface --project my_site --cell 25cm
georef undistort photos --camera camera.toml --target undistorted
georef volume --project sample_project --corner 1694000,219060 --corner 1694060,219060 --corner 1694030,219110
georef who-sees --project sample_project --place 1694042.5,219075.0
""".strip().splitlines()  # noqa: E501
