"""How bright a mosaic is as a whole: what overlaps cannot tell, and the range of values bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.coarse import Mask
from georef_gis.mosaic.colour import ColourModel
from georef_gis.mosaic.colour_normals import DARKEST
from georef_gis.mosaic.tone import tone_of

# part of the range beyond which detail is lost, and share of the pixels that may come to lie there
NEARLY_WHITE = 0.98
SHARE = 0.005


def common_level(model: ColourModel, samples: Samples, top: float) -> float:
    """Natural logarithm of the factor that all photos are to be multiplied by, 0 or less.

    No more than `SHARE` of the pixels come to exceed `NEARLY_WHITE` of the range by their
    correction, and the photo in the middle of all is not made brighter.

    Parameters
    ----------
    samples
        Pixels of the photos. Those near the top already do not count: nothing brings them back.
    top
        Largest grey value of the range.
    """
    white = NEARLY_WHITE * top
    middle = float(np.median(model.gain.mean(axis=1))) if len(model.gain) else 0.0
    room = _room(model, samples, white)
    if not room.size:
        return min(0.0, -middle)
    return min(0.0, -middle, float(np.quantile(room, SHARE)))


def with_level(model: ColourModel, level: float, bands: Mask) -> ColourModel:
    """The same colours, some bands (bands,) brighter by a logarithm in all photos."""
    offsets = model.offsets * np.where(bands, np.exp(level), 1.0)
    return replace(model, gain=model.gain + level * bands, offsets=offsets)


def _room(model: ColourModel, samples: Samples, white: float) -> Array:
    """Logarithm by which pixels may grow before any of their bands exceeds a value; (s,)."""
    out = np.full(samples.photo.size, np.inf)
    # samples are sorted by photo
    for part in np.split(np.arange(out.size), np.flatnonzero(np.diff(samples.photo)) + 1):
        if not part.size:
            continue
        photo, value = int(samples.photo[part[0]]), samples.value[part].astype(np.float64)
        log = np.log(model.factor(photo, samples.xy[part], samples.view[part]))
        darkest = DARKEST * white
        end = tone_of(white - model.offset(photo), darkest, model.knee)
        room = end - tone_of(value, darkest, model.knee) - log
        out[part] = np.where(value <= white, room, np.inf).min(axis=1)
    return out
