"""Our exporters, on the same contract as a third party's.

Importing them is light: lxml, cv2, rasterio and pyogrio are loaded when something is written.
"""

from typing import Any

from exports.kml.kml import Kml, Kmz
from exports.kml.light_kmz import LightKmz
from exports.metadata.metadata import CheckMetadata, Metadata
from exports.metadata.stac import Stac
from exports.poses.colmap import Colmap
from exports.poses.opensfm import OpenSfm
from exports.poses.pose_tables import MetashapeCsv, Pix4dMapperCsv, Pix4dMaticCsv
from exports.poses.poses import OdmGeo, ReferenceCsv
from exports.poses.tagged_photos import TaggedPhotos
from exports.tables.csv_layers import Csv
from exports.tables.dxf import Dxf
from exports.tables.filegdb import FileGdb
from exports.tables.flatgeobuf import FlatGeobuf
from exports.tables.geojson import GeoJson
from exports.tables.geopackage import GeoPackage
from exports.tables.geoparquet import GeoParquet
from exports.tables.postgis import PostGis
from exports.tables.shapefile import Shapefile
from exports.tiles.cog import Cog
from exports.tiles.mbtiles import Mbtiles
from exports.tiles.pmtiles import Pmtiles
from exports.tiles.xyz_tiles import XyzTiles
from georef_gis.toolbox import Algorithm, Exporter

EXPORTERS: tuple[type[Exporter[Any]], ...] = (
    Kmz,
    LightKmz,
    GeoPackage,
    Kml,
    GeoJson,
    Shapefile,
    FileGdb,
    Dxf,
    GeoParquet,
    FlatGeobuf,
    Csv,
    PostGis,
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
    Stac,
)
# What of export is no layer in one file; after the exporters, whose files it tells of.
TOOLS: tuple[type[Exporter[Any]] | type[Algorithm[Any]], ...] = (
    *EXPORTERS,
    Metadata,
    CheckMetadata,
)
