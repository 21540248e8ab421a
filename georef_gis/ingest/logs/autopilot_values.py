"""What the logs of ArduPilot and PX4 have in common."""

from __future__ import annotations

from georef_gis.model.logs import FIX_2D, FIX_DGNSS, FIX_FIXED, FIX_FLOAT, FIX_NONE, FIX_SINGLE

# MAVLink's GPS_FIX_TYPE -> our quality; from 7 on each autopilot has meanings of its own
FIX_OF_TYPE = {0: FIX_NONE, 1: FIX_NONE, 2: FIX_2D, 3: FIX_SINGLE, 4: FIX_DGNSS, 5: FIX_FLOAT,
               6: FIX_FIXED}  # fmt: skip
# m: the receiver's own geoid may differ from EGM96 by this
GEOID_TOLERANCE = 15.0
# s, one sigma: timing of the feedback of a camera and of the trigger pins
SIGMA_FEEDBACK, SIGMA_TRIGGER = 0.001, 0.05
