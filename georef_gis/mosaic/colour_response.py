"""Whether a camera's response bends towards white, told by photos of different exposure."""

from __future__ import annotations

from dataclasses import replace

from georef_gis.mosaic.colour_normals import Layout, chosen
from georef_gis.mosaic.colour_settings import ColourSettings
from georef_gis.mosaic.colour_solution import noise_of, solve
from georef_gis.mosaic.overlaps import Overlaps

# every so many blocks are looked at
EVERY = 4
# iterations; where the noise lies shows early
ITERATIONS = 6
# of the noise that a straight response leaves; pictures of real cameras leave 0.6 to 0.8, linear
# data 1.1 and more
BETTER = 0.98


def response_bends(
    overlaps: Overlaps, layout: Layout, settings: ColourSettings, knee: float
) -> bool:
    """Whether photos agree better with gains that spare what is near white than with plain ones.

    Parameters
    ----------
    settings
        Of the solution to be.
    knee
        One over the grey value that stays, see `tone.py`.
    """
    if not len(overlaps):
        return False
    few = chosen(overlaps, slice(None, None, EVERY))
    fast = replace(settings, sigma_spot=0.0, sigma_surface=0.0, iterations=ITERATIONS)

    def noise(own: float) -> float:
        solution = solve(few, layout, replace(fast, knee=own), None)
        if solution.equations is None:
            return 0.0
        residual, _ = solution.equations.differences(solution.x)
        return float(noise_of(residual, solution.equations.overlaps.weight > 0.0).mean())

    return noise(knee) < BETTER * noise(0.0)
