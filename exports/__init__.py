"""Our exporters, on the same contract as a third party's.

Importing them is light: lxml, cv2, rasterio and pyogrio are loaded when something is written.
"""

from typing import Any

from exports.cog import Cog
from exports.colmap import Colmap
from exports.geojson import GeoJson
from exports.geopackage import GeoPackage
from exports.kml import Kml, Kmz
from exports.mbtiles import Mbtiles
from exports.opensfm import OpenSfm
from exports.pmtiles import Pmtiles
from exports.pose_tables import MetashapeCsv, Pix4dMapperCsv, Pix4dMaticCsv
from exports.poses import OdmGeo, ReferenceCsv
from exports.tagged_photos import TaggedPhotos
from exports.xyz_tiles import XyzTiles
from georef_gis.toolbox import Exporter

EXPORTERS: tuple[type[Exporter[Any]], ...] = (
    Kmz,
    GeoPackage,
    Kml,
    GeoJson,
    Cog,
    XyzTiles,
    Mbtiles,
    Pmtiles,
    OdmGeo,
    ReferenceCsv,
    MetashapeCsv,
    Pix4dMapperCsv,
    Pix4dMaticCsv,
    OpenSfm,
    Colmap,
    TaggedPhotos,
)
