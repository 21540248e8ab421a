"""Interior orientation: order of the sources, resizing, calibrations, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from georef_gis.errors import InputError
from georef_gis.ingest.cameras import CameraOverride, camera_for, camera_id_of
from georef_gis.ingest.lens_profiles import fit_radial
from georef_gis.ingest.tags import Tags
from georef_gis.orient.adjustment.block import CAMERA_NAMES
from georef_gis.orient.adjustment.priors import camera_prior
from georef_gis.project.settings import Settings

SONY: Tags = {
    "File:FileType": "JPEG",
    "EXIF:Make": "SONY",
    "EXIF:Model": "ILCE-6000",
    "EXIF:LensModel": "E 20mm F2.8",
    "EXIF:FocalLength": 20.0,
    "EXIF:FNumber": 5.6,
    "EXIF:FocalLengthIn35mmFormat": 30.0,
}
P4R: Tags = {
    "File:FileType": "JPEG",
    "EXIF:Make": "DJI",
    "EXIF:Model": "FC6310R",
    "EXIF:FocalLength": 8.8,
    "EXIF:FocalLengthIn35mmFormat": 24.0,
    "XMP-drone-dji:CalibratedFocalLength": "3666.666504",
    "XMP-drone-dji:CalibratedOpticalCenterX": "2736.000000",
    "XMP-drone-dji:CalibratedOpticalCenterY": "1824.000000",
    "XMP-drone-dji:DewarpFlag": "0",
    "XMP-drone-dji:DewarpData": "2018-10-23;3654.47,3647.59,8.76,15.04,-0.267814,0.113473,"
    "0.000569248,-0.000558253,-0.034346",
}
FULL = (5472, 3648)


def test_dewarp_data_counts_the_principal_point_from_the_middle() -> None:
    camera = camera_for(P4R, FULL).camera
    assert (camera.fx, camera.fy) == (3654.47, 3647.59)
    assert (camera.cx, camera.cy) == (2735.5 + 8.76, 1823.5 + 15.04)
    assert (camera.k1, camera.k2, camera.k3) == (-0.267814, 0.113473, -0.034346)
    assert (camera.p1, camera.p2) == (0.000569248, -0.000558253)
    assert camera.sigma_f == pytest.approx(3.65, abs=0.01)


def test_a_dewarped_picture_has_no_distortion_left() -> None:
    camera = camera_for(P4R | {"XMP-drone-dji:DewarpFlag": "1"}, FULL).camera
    assert (camera.k1, camera.k2, camera.k3, camera.p1, camera.p2) == (0.0,) * 5
    assert camera.fx == 3654.47


def test_nominal_centre_of_dji_is_the_middle() -> None:
    tags = {k: v for k, v in P4R.items() if "Dewarp" not in k}
    camera = camera_for(tags, FULL).camera
    assert (camera.cx, camera.cy) == (2735.5, 1823.5)


def test_a_resized_calibrated_picture_sees_the_same_rays() -> None:
    small = camera_for(
        P4R | {"EXIF:ExifImageWidth": 5472.0, "EXIF:ExifImageHeight": 3648.0}, (1368, 912)
    )
    full = camera_for(P4R, FULL).camera
    uv = np.array([[0.0, 0.0], [3000.0, 200.0], [5471.0, 3647.0]])
    # uv' = s (uv + 0.5) - 0.5
    rays = small.camera.ray(0.25 * (uv + 0.5) - 0.5)
    assert rays == pytest.approx(full.ray(uv), abs=1e-12)
    assert "same proportions" in small.doubts[0]


def test_a_cropped_calibrated_picture_sees_the_same_rays() -> None:
    tags = P4R | {"EXIF:ExifImageWidth": 5472.0, "EXIF:ExifImageHeight": 3648.0}
    crop = camera_for(tags, (5472, 3078))
    full = camera_for(P4R, FULL).camera
    uv = np.array([[0.0, 0.0], [3000.0, 200.0]])
    # 285 rows less at the top
    assert crop.camera.ray(uv) == pytest.approx(full.ray(uv + np.array([0.0, 285.0])), abs=1e-12)
    assert "other proportions" in crop.doubts[0]


def test_the_user_comes_first() -> None:
    own = CameraOverride(focal_px=3600.0, k1=-0.01, sigma_focal_percent=0.2)
    camera = camera_for(P4R, FULL, override=own).camera
    assert (camera.fx, camera.fy, camera.k1, camera.k2) == (3600.0, 3600.0, -0.01, 0.0)
    assert camera.sigma_f == pytest.approx(7.2)
    assert camera.source == "project.toml"


def test_the_sigma_of_the_principal_point_reaches_the_adjustment() -> None:
    """Stated, it is the prior of both coordinates; else a share of the width stands in."""
    own = CameraOverride(focal_px=3600.0, cx=2740.0, cy=1820.0, sigma_principal_point_px=1.5)
    camera = camera_for(P4R, FULL, override=own).camera
    assert camera.sigma_c == 1.5
    assert (camera.cx, camera.cy) == (2740.0, 1820.0)
    at = [CAMERA_NAMES.index(name) for name in ("cx", "cy")]
    assert camera_prior(camera).sigma[at].tolist() == [1.5, 1.5]
    untold = camera_for(P4R, FULL, override=CameraOverride(focal_px=3600.0)).camera
    assert camera_prior(untold).sigma[at].min() > 20.0


def test_project_toml_states_the_sigma_of_the_principal_point() -> None:
    section = Settings.model_validate({"camera": {"sigma_principal_point_px": 1.5}}).camera
    own = CameraOverride(**section.model_dump(exclude_none=True))
    assert camera_for(P4R, FULL, override=own).camera.sigma_c == 1.5
    with pytest.raises(ValidationError):
        Settings.model_validate({"camera": {"sigma_principal_point_px": 0.0}})


def test_focal_and_sensor_width_of_the_user() -> None:
    own = CameraOverride(focal_mm=8.8, sensor_width_mm=13.2)
    assert camera_for({}, FULL, override=own).camera.fx == pytest.approx(3648.0)


def test_the_user_settles_resized_or_cropped() -> None:
    tags: Tags = {
        "EXIF:FocalLength": 4.3,
        "EXIF:FocalPlaneXResolution": 1e6 / 61,
        "EXIF:FocalPlaneResolutionUnit": 2.0,
        "EXIF:ExifImageWidth": 4000.0,
        "EXIF:ExifImageHeight": 3000.0,
    }
    open_question = camera_for(tags, (3600, 2700))
    assert open_question.camera.fx == pytest.approx(2497.74, abs=0.01)
    assert len(open_question.doubts) == 1
    settled = camera_for(tags, (3600, 2700), override=CameraOverride(resized_from=(4000, 3000)))
    assert settled.doubts == ()
    assert settled.camera.fx == open_question.camera.fx
    assert settled.camera.sigma_f < open_question.camera.sigma_f
    crop = CameraOverride(cropped_from=(4000, 3000, 200, 150))
    cropped = camera_for(tags, (3600, 2700), override=crop)
    assert cropped.camera.fx == pytest.approx(2775.27, abs=0.01)
    assert (cropped.camera.cx, cropped.camera.cy) == (1799.5, 1349.5)
    assert cropped.doubts == ()


@pytest.mark.parametrize(
    ("unit", "resolution"), [(2.0, 254000.0 / 17.0), (3.0, 1e5 / 17.0), (4.0, 1e4 / 17.0)]
)
def test_units_of_the_focal_plane(unit: float, resolution: float) -> None:
    # 12 mm over a pitch of 1.7 um
    tags: Tags = {
        "EXIF:FocalLength": 12.0,
        "EXIF:FocalPlaneXResolution": resolution,
        "EXIF:FocalPlaneResolutionUnit": unit,
    }
    assert camera_for(tags, (4000, 3000)).camera.fx == pytest.approx(12.0 / 0.0017)


@pytest.mark.parametrize("name", ["cylindrical", "fisheye624"])
def test_an_unknown_model_is_refused_by_name(name: str) -> None:
    with pytest.raises(InputError, match=f"'{name}' is not known"):
        camera_for({"XMP-Camera:ModelType": name}, (100, 80))
    with pytest.raises(InputError, match=f"'{name}' is not known"):
        camera_for(P4R, FULL, override=CameraOverride(model=name))


def test_pix4d_fisheye_with_a_skew_is_not_used() -> None:
    tags: Tags = {
        "XMP-Camera:ModelType": "fisheye",
        "XMP-Camera:FisheyeAffineMatrix": "1671.5,0,2.5,1671.5",
        "XMP-Camera:FisheyePolynomial": "0,1,0.01,-0.147",
        "EXIF:FocalLengthIn35mmFormat": 30.0,
    }
    camera = camera_for(tags, (1280, 960)).camera
    assert camera.model == "brown"
    assert any("skew" in note for note in camera.notes)


def test_lens_profile_of_an_interchangeable_lens_is_applied() -> None:
    found = camera_for(SONY, (6000, 4000))
    camera = found.camera
    assert camera.source == "lens profile"
    # 20 mm on a sensor of crop factor 1.534; the profile enlarges the middle by 1.6 %
    nominal = 20.0 / 43.2666 * 1.534 * math.hypot(6000, 4000)
    assert camera.fx == pytest.approx(1.016 * nominal, rel=0.01)
    corner = camera.distort(np.array([3000.0, 2000.0]) / nominal)
    pulled_in = camera.fx * np.linalg.norm(corner) / math.hypot(3000.0, 2000.0)
    # ptlens at r = 1.803: 0.01609 r^3 - 0.05179 r^2 + 0.01925 r + 1.01645
    r = math.hypot(3000.0, 2000.0) / 2000.0
    expected = 0.01609 * r**3 - 0.05179 * r**2 + 0.01925 * r + 1.01645
    # 0.65 px of 3606 px in the corner: the fit of our model to ptlens
    assert pulled_in == pytest.approx(expected, abs=2e-4)
    assert "followed to 0.6 px only" in found.doubts[0]


def test_firmware_corrects_fixed_lenses() -> None:
    tags = {k: v for k, v in P4R.items() if not k.startswith("XMP")} | {"EXIF:Model": "FC6310"}
    camera = camera_for(tags, FULL).camera
    assert camera.k1 == 0.0
    assert any("firmware" in note for note in camera.notes)


def test_radial_fit_finds_its_own_model() -> None:
    r = np.linspace(0.0, 0.9, 50)
    focal, k, error = fit_radial(r, 3000.0 * r * (1 - 0.2 * r**2 + 0.07 * r**4 - 0.01 * r**6))
    assert focal == pytest.approx(3000.0)
    assert k == pytest.approx((-0.2, 0.07, -0.01))
    assert error < 1e-6


def test_camera_ids_tell_bodies_lenses_and_bands_apart() -> None:
    base = camera_id_of(SONY, 6000, 4000)
    assert base == "SONY ILCE-6000 20mm 6000x4000"
    others = [
        camera_id_of(SONY | {"EXIF:SerialNumber": "77"}, 6000, 4000),
        camera_id_of(SONY | {"EXIF:FocalLength": 35.0}, 6000, 4000),
        camera_id_of(SONY | {"XMP-Camera:RigCameraIndex": "3"}, 6000, 4000),
        camera_id_of(SONY, 3000, 2000),
    ]
    assert len({base, *others}) == 5


def test_wide_angles_without_calibration_are_doubted() -> None:
    tags: Tags = {"EXIF:FocalLength": 3.0, "EXIF:FocalLengthIn35mmFormat": 15.0}
    assert "wide angle" in camera_for(tags, (4000, 3000)).doubts[0]
