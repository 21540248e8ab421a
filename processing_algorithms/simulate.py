"""Tool `simulate`: a flight over a work zone, what it leaves behind, and the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p


class SimulateParameters(p.Parameters):
    """Parameters of `simulate`."""

    folder: p.Folder = p.folder(title="Folder to write", positional=True, writes=True)
    flight_seed: p.Integer = p.integer(2009, title="Seed of the flight", ge=0, le=2**31)
    gnss: Literal["coloured", "white"] = p.choice(
        "coloured",
        title="Errors of the GNSS",
        help="coloured: white 0.7 m and Gauss-Markov 2 m with 100 s; white: 2.5 m CEP",
    )
    attitude: Literal["camera", "none"] = p.choice(
        "camera", title="Angles in the tags: XMP Camera, or none"
    )
    photos: p.Flag = p.flag(True, title="Render the photos")
    quality: p.Integer = p.integer(85, title="JPEG quality", ge=10, le=100, advanced=True)
    truth_imu: p.Flag = p.flag(False, title="Write the error-free IMU log", advanced=True)


class Simulate(Algorithm[SimulateParameters]):
    """Simulate a flight of 16 photos over a work zone beside a road.

    Photos with tags, IMU and GNSS logs, a sync-board log with a missed and a spurious trigger,
    control points with their pixels, a DEM, and the truth of all that beside it. The same seed
    gives the same bytes.
    """

    id, name, group = "simulate", "Simulate a flight", "project"
    needs_project = False
    outputs = (Output(name="folder", title="Flight", type="Folder"),)

    def run(self, context: Context, parameters: SimulateParameters, feedback: Feedback) -> Result:
        """Write the flight."""
        from georef_gis.simulate import FlightSettings, simulate_flight, write_flight

        settings = FlightSettings(gnss=parameters.gnss, attitude_tag=parameters.attitude)

        def progress(fraction: float, message: str) -> None:
            check_cancelled(feedback)
            feedback.progress(fraction, message)

        flight = simulate_flight(settings, seed=parameters.flight_seed)
        files = write_flight(
            flight,
            parameters.folder,
            photos=None if parameters.photos else (),
            truth_imu=parameters.truth_imu,
            quality=parameters.quality,
            progress=progress,
        )
        size = sum(Path(file).stat().st_size for file in files)
        summary = {
            "products": [str(parameters.folder)],
            "files": len(files),
            "size_mb": round(size / 1e6, 2),
        }
        return Result(outputs={"folder": parameters.folder}, summary=summary)
