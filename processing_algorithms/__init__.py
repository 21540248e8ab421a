"""Our tools, on the same contract as a third party's. Their heavy libraries load when they run."""

from processing_algorithms.assets.assets import Assets
from processing_algorithms.assets.screen_work_zone import ScreenWorkZone
from processing_algorithms.assets.wzdx import Wzdx
from processing_algorithms.change.change import ChangeTool
from processing_algorithms.ingest.check import Check
from processing_algorithms.ingest.init import Init
from processing_algorithms.ingest.photos import ReadPhotos
from processing_algorithms.ingest.sync_board import SYNC_BOARD_TOOLS
from processing_algorithms.measure.accuracy import Accuracy
from processing_algorithms.measure.accuracy_table import AccuracyTable
from processing_algorithms.measure.control import ControlPoints
from processing_algorithms.measure.error_budget import ErrorBudget
from processing_algorithms.measure.intersect import Intersect
from processing_algorithms.measure.locate import Locate
from processing_algorithms.measure.match_clicks import MatchClicks
from processing_algorithms.measure.measure_lines import MeasureLines
from processing_algorithms.measure.measure_photo import MeasurePhoto
from processing_algorithms.measure.report import Report
from processing_algorithms.measure.where_to_click import WhereToClick
from processing_algorithms.measure.who_sees import WhoSees
from processing_algorithms.mosaic.band_index import BandIndex
from processing_algorithms.mosaic.mosaic import MosaicTool
from processing_algorithms.mosaic.sheets import MosaicSheets
from processing_algorithms.navigate.compare_trajectory import CompareTrajectory
from processing_algorithms.navigate.navigate import Navigate
from processing_algorithms.navigate.orient import OrientNavigation
from processing_algorithms.navigate.ppk import Ppk
from processing_algorithms.orient.adjust import Adjust
from processing_algorithms.orient.calibrate_camera import CalibrateCamera
from processing_algorithms.orient.calibrate_mount import CalibrateMount
from processing_algorithms.orient.direct import OrientDirect
from processing_algorithms.orient.match import Match
from processing_algorithms.orient.undistort import Undistort
from processing_algorithms.plan.plan_flight import PlanFlight
from processing_algorithms.rectify.footprints import Footprints
from processing_algorithms.rectify.orthos import Orthos
from processing_algorithms.simulate import Simulate
from processing_algorithms.surface.profile import ProfileTool
from processing_algorithms.surface.surface import SurfaceTool
from processing_algorithms.surface.volume import VolumeTool

ALGORITHMS = (
    Init,
    Simulate,
    Check,
    ReadPhotos,
    *SYNC_BOARD_TOOLS,
    Ppk,
    Navigate,
    OrientDirect,
    CalibrateCamera,
    CalibrateMount,
    Undistort,
    OrientNavigation,
    CompareTrajectory,
    Match,
    Adjust,
    Footprints,
    Orthos,
    MosaicTool,
    MosaicSheets,
    BandIndex,
    ControlPoints,
    WhereToClick,
    Accuracy,
    AccuracyTable,
    Report,
    MeasurePhoto,
    Locate,
    Intersect,
    MatchClicks,
    MeasureLines,
    WhoSees,
    Assets,
    ScreenWorkZone,
    Wzdx,
    SurfaceTool,
    ProfileTool,
    VolumeTool,
    ChangeTool,
    ErrorBudget,
    PlanFlight,
)
