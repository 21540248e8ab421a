"""Tie points: features, pairs, guided matches, geometric checks, headings, tracks."""

from georef_gis.orient.ties.find import find_ties
from georef_gis.orient.ties.results import TiePair, TieResult, TieSettings, Turn

__all__ = ["TiePair", "TieResult", "TieSettings", "Turn", "find_ties"]
