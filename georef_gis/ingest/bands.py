"""Bands of a photo's file as its tags state them: how many, of which type, beside which alpha."""

from __future__ import annotations

from collections.abc import Mapping

from georef_gis.ingest.tags import TagValue, number, numbers

# ExtraSamples (TIFF 6.0, p. 31): alpha by which colours are multiplied already, and alpha apart
_ALPHA = frozenset({1.0, 2.0})
# SampleFormat (TIFF 6.0, p. 80); what is undefined is read as unsigned
_FORMATS = {1: "uint", 2: "int", 3: "float", 4: "uint", 5: "complex int", 6: "complex"}


def band_count(tags: Mapping[str, TagValue]) -> int:
    """Number of bands that show something; an alpha channel is none."""
    colours = number(tags, "File:ColorComponents")
    samples = int(colours or number(tags, "EXIF:SamplesPerPixel") or 3)
    return max(samples - alpha_count(tags), 1)


def alpha_count(tags: Mapping[str, TagValue]) -> int:
    """Number of alpha channels of a TIFF; a JPEG has none."""
    if "File:ColorComponents" in tags:
        return 0
    return sum(value in _ALPHA for value in numbers(tags, "EXIF:ExtraSamples"))


def band_type(tags: Mapping[str, TagValue]) -> str:
    """Type of the first band, such as uint16; a JPEG's is uint8."""
    if "File:ColorComponents" in tags:
        return "uint8"
    bits, formats = numbers(tags, "EXIF:BitsPerSample"), numbers(tags, "EXIF:SampleFormat")
    kind = _FORMATS.get(int(formats[0]), "uint") if formats else "uint"
    return f"{kind}{int(bits[0]) if bits else 8}"
