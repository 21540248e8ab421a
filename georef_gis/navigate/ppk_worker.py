"""RTKLIB in a process of its own: it keeps global state, and a crash takes its process along.

Run as a script with one argument, a JSON file that `ppk.py` writes. Imports nothing of ours.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any


def main(job_file: str) -> None:
    """Do the job of a file and write what came of it beside it."""
    with open(job_file, encoding="utf-8") as stream:
        job = json.load(stream)
    done = convert(job) if job["task"] == "convert" else solve(job)
    with open(job["report"], "w", encoding="utf-8") as stream:
        json.dump(done, stream)


def convert(job: dict[str, Any]) -> dict[str, Any]:
    """Turn UBX into RINEX 3.03 by RTKLIB's `convrnx`."""
    import pyrtklib as rtk

    options = rtk.rnxopt_t()
    options.rnxver = 303
    options.navsys = rtk.SYS_ALL
    options.obstype = rtk.OBSTYPE_ALL
    options.freqtype = rtk.FREQTYPE_ALL
    for i in range(7):
        for j in range(rtk.MAXCODE):
            options.mask[i, j] = "1"
    # An approximate week for streams that carry none, and no limits.
    options.ttol = 0.005
    # obs, then one file for each kind of navigation message; RTKLIB wants nine names.
    names = [job["obs"], job["nav"], *([""] * 7)]
    status = rtk.convrnx(rtk.STRFMT_UBX, options, job["raw"], names)
    return {"status": int(status), "version": f"{rtk.VER_RTKLIB} {rtk.PATCH_LEVEL}"}


def solve(job: dict[str, Any]) -> dict[str, Any]:
    """Run `postpos` over rover, base and navigation files."""
    import pyrtklib as rtk

    files = [job["rover"], *([job["base"]] if job["base"] else []), *job["nav"]]
    solution = _solution_options(rtk)
    out = rtk.Arr1Dchar(job["out"])
    status = rtk.postpos(
        rtk.gtime_t(), rtk.gtime_t(), 0.0, 0.0, _processing_options(rtk, job), solution,
        rtk.filopt_t(), files, len(files), out, "", "",
    )  # fmt: skip
    return {"status": int(status), "version": f"{rtk.VER_RTKLIB} {rtk.PATCH_LEVEL}"}


def _processing_options(rtk: Any, job: dict[str, Any]) -> Any:
    options = rtk.prcopt_default
    options.mode = rtk.PMODE_KINEMA if job["base"] else rtk.PMODE_SINGLE
    # forward, backward, combined
    options.soltype = job["direction"]
    options.nf = job["bands"]
    options.navsys = sum(getattr(rtk, f"SYS_{name}") for name in job["systems"])
    options.elmin = math.radians(job["elevation_mask_deg"])
    options.dynamics = int(job["dynamics"])
    options.modear = rtk.ARMODE_FIXHOLD if job["hold"] else rtk.ARMODE_CONT
    if not job["fix"]:
        options.modear = rtk.ARMODE_OFF
    options.thresar[0] = job["ratio"]
    options.ionoopt, options.tropopt = rtk.IONOOPT_BRDC, rtk.TROPOPT_SAAS
    options.sateph = rtk.EPHOPT_BRDC
    options.maxtdiff = job["max_age_s"]
    options.prn[3], options.prn[4] = job["accel_noise"]
    options.err[1] = options.err[2] = job["phase_sigma_m"]
    options.eratio[0] = options.eratio[1] = job["code_phase_ratio"]
    if job["base_ecef"] is None:
        options.refpos = rtk.POSOPT_SINGLE
    else:
        options.refpos = rtk.POSOPT_POS
        for i, value in enumerate(job["base_ecef"]):
            options.rb[i] = value
    return options


def _solution_options(rtk: Any) -> Any:
    options = rtk.solopt_default
    options.posf, options.times = rtk.SOLF_LLH, rtk.TIMES_GPST
    # Week and seconds of the week, to a microsecond; degrees; ellipsoidal heights.
    options.timef, options.timeu, options.degf = 0, 6, 0
    options.datum = options.height = options.geoid = 0
    options.outhead = options.outopt = 1
    options.outvel = 1
    options.trace = 1
    return options


if __name__ == "__main__":
    main(sys.argv[1])
