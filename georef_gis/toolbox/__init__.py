"""The contract between tools and the faces that run them: parameters, tools, exporters, runs."""

from georef_gis.toolbox.algorithm import Algorithm, Output, Result, manifest
from georef_gis.toolbox.context import CollectingFeedback, Context, Feedback, check_cancelled
from georef_gis.toolbox.exporter import Exporter, ExportReport, LayerSource, Sender

__all__ = [
    "Algorithm",
    "CollectingFeedback",
    "Context",
    "ExportReport",
    "Exporter",
    "Feedback",
    "LayerSource",
    "Output",
    "Result",
    "Sender",
    "check_cancelled",
    "manifest",
]
