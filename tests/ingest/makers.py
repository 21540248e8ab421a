"""What the tags of 32 makers' photos mean, worked out by hand before the readers were written.

roll, pitch, yaw in degrees in the dialect's own sense; focal length in px of the stored picture.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    dialect: str | None = None
    rpy: tuple[float, float, float] | None = None
    vehicle_yaw: float | None = None
    position: tuple[float, float] | None = None
    height: float | None = None
    kind: str | None = None
    above_takeoff: float | None = None
    # (px, tolerance px, source) or None where nothing gives it
    focal: tuple[float, float, str] | None = None
    doubts: tuple[str, ...] = ()


MAKERS: dict[str, Expected] = {
    "dji__FC3170_MavicAir2_DJI_0693": Expected(
        dialect="drone-dji", rpy=(0.0, -89.9, 122.8), vehicle_yaw=87.8,
        position=(4.7126503, -74.0687436), height=60.2, kind="unknown", above_takeoff=60.2,
        # 24 mm of 43.2666 mm on the 4:3 frame 4000 x 3000, diagonal 5000 px
        focal=(24 / 43.2666 * 5000, 0.1, "35 mm"),
        doubts=("repeats RelativeAltitude", "differ by 35 deg"),
    ),
    "dji__FC3170_onground_pitch-163.9_DJI_0740": Expected(
        dialect="drone-dji", rpy=(14.6, -163.9, -31.2), vehicle_yaw=128.7,
        position=(4.7125504, -74.0687785), height=None, above_takeoff=None,
        focal=(2773.5, 0.1, "35 mm"),
        doubts=("RelativeAltitude] is 0 m", "GPSAltitude] is 0 m", "away from straight down"),
    ),
    "dji__FC350_X3_makernote_DJI_0068": Expected(
        dialect="dji-makernote", rpy=(100.0, -89.9, -5.3), vehicle_yaw=95.9,
        position=(41.5485438, -83.6977021), height=119.5, kind="unknown",
        focal=(20 / 43.2666 * 3000, 0.1, "35 mm"), doubts=("gimbal lock",),
    ),
    "dji__FC6310_gimp_thumb_DJI_0004": Expected(
        dialect="dji-makernote", rpy=(0.0, -89.9, -2.7), vehicle_yaw=-2.3,
        position=(19.1552494, 73.0053162), height=63.739, kind="unknown",
        # 3:2 frame 5472 x 3648 around the 4864 x 3648 picture, times 40 / 4864
        focal=(24 / 43.2666 * 6576.55 * 40 / 4864, 0.02, "35 mm"), doubts=("Created with GIMP",),
    ),
    "dji__H20N_DJI_0006_R": Expected(
        dialect="drone-dji", rpy=(0.0, -32.9, -106.6), vehicle_yaw=-86.0,
        position=(22.5961964, 114.007268), height=90.337, kind="unknown", above_takeoff=42.602,
        focal=(29 / 43.2666 * 819.61, 0.1, "35 mm"), doubts=("oblique", "DigitalZoomRatio"),
    ),
    "dji__H20T_nogps_DJI_0001_R": Expected(
        focal=(58 / 43.2666 * 819.61, 0.1, "35 mm"), doubts=("GPSLatitude] is missing",),
    ),
    "dji__M2EA_nogps_DJI_0001_R": Expected(
        dialect="dji-makernote", rpy=(0.0, 9.4, 93.7), vehicle_yaw=81.0,
        doubts=("GPSLatitude] is missing", "away from straight down"),
    ),
    "dji__M30T_nogps_DJI_0011_R": Expected(
        focal=(40 / 43.2666 * 819.61, 0.1, "35 mm"), doubts=("GPSLatitude] is missing",),
    ),
    "dji__M3T_DJI_0001_R": Expected(
        dialect="drone-dji", rpy=(0.0, -6.9, -78.1), vehicle_yaw=-76.8,
        position=(22.6939925, 114.9658661), height=94.182, kind="unknown", above_takeoff=87.243,
        focal=(757.7, 0.1, "35 mm"), doubts=("away from straight down",),
    ),
    "dji__dji_phantom4": Expected(
        dialect="drone-dji", rpy=(0.0, -89.9, 51.7), vehicle_yaw=49.2,
        position=(55.26133283, -1.87766239), height=289.405, kind="ellipsoidal",
        above_takeoff=54.89, focal=(3654.47 * 274 / 5472, 0.01, "DewarpData"),
    ),
    "dji__dji_phantom4_2": Expected(
        dialect="drone-dji", rpy=(0.0, -90.0, -58.8), vehicle_yaw=-59.0,
        position=(33.88749922, -5.42209932), height=706.247, kind="ellipsoidal",
        above_takeoff=61.07, focal=(3666.666504 * 274 / 5472, 0.01, "CalibratedFocalLength"),
    ),
    "flir__20190402_154718": Expected(
        position=(35.2457983, 129.1423133), height=969.86, kind="unknown", above_takeoff=599.79,
        # 9 mm over a pitch of 17 um
        focal=(9 / 0.017, 0.5, "focal-plane"), doubts=("placeholders",),
    ),
    "flir__DuoProR_20181018_160439_346": Expected(
        position=(37.5831681, 127.058365), height=61.023, kind="unknown",
        focal=(13 / 0.017, 0.5, "focal-plane"), doubts=("convention is not known",),
    ),
    "flir__FLIR_Vue_Pro_640": Expected(doubts=("0, 0, which a receiver without a fix",)),
    "gopro__GoPro": Expected(
        position=(40.6584192, -73.9933543), height=-3.983, kind="unknown",
        focal=(15 / 43.2666 * 5000, 0.1, "35 mm"),
    ),
    "micasense__IMG_0207_4": Expected(
        position=(39.2648944, -1.9303445), height=744.961, kind="unknown",
        focal=(5.448118711620255 * 266.666667, 0.01, "Pix4D"), doubts=("light sensor",),
    ),
    "parrot__Anafi": Expected(
        dialect="drone-parrot", rpy=(0.0, -12.041464, -10.7827), vehicle_yaw=-65.409592,
        doubts=("0, 0, which", "Photoshop", "away from straight down"),
    ),
    "parrot__Bebop_2": Expected(
        position=(47.2061071, -1.5647862), height=29.9, kind="unknown",
        focal=(6 / 43.2666 * 1318.13, 0.2, "35 mm"), doubts=("convention is not known", "DxO"),
    ),
    "parrot__Bebop_2_1": Expected(
        position=(47.2053851, -1.566524), height=31.6, kind="unknown",
        focal=(6 / 43.2666 * 1318.13, 0.2, "35 mm"), doubts=("convention is not known", "DxO"),
    ),
    "parrot__Disco_parrot-1": Expected(
        position=(57.9995323, 25.5496375), height=78.98716, kind="unknown",
        # 4:3 frame 1920 x 1440
        focal=(6 / 43.2666 * 2400, 0.1, "35 mm"), doubts=("convention is not known", "on or near"),
    ),
    "parrot__Sequoia_NIR": Expected(
        dialect="pix4d-camera", rpy=(0.0154285, 5.1846, -16.7996),
        position=(41.4286811, -81.6058854), height=347.723, kind="unknown",
        focal=(1671.556624, 0.001, "fisheye"),
    ),
    "parrot__Sequoia_RGB": Expected(
        dialect="pix4d-camera", rpy=(0.0154285, 5.1846, -16.7996),
        position=(41.4286811, -81.6058854), height=347.723, kind="unknown",
        focal=(4.812073 * 746.2686793, 0.01, "Pix4D"),
    ),
    "phone_generic__DSCN0010": Expected(
        position=(43.4674483, 11.8851267), height=None,
        focal=(112 / 43.2666 * 800, 0.2, "35 mm"), doubts=("GPSAltitude] is missing",),
    ),
    "phone_generic__iPhone5s_IMG_6785": Expected(
        dialect="ypr", rpy=(0.0, 0.0, 133.1431452),
        position=(38.2422528, 140.9360056), height=15.20611702, kind="unknown",
        focal=(29 / 43.2666 * 4080, 0.1, "35 mm"), doubts=("magnetic",),
    ),
    "sensefly__eBee_IXUS125HS_IMG_2312": Expected(
        dialect="sensefly", rpy=(1.82811164855957, 0.171965107321739, 8.051180839538574),
        position=(35.3883406, 139.4325378), height=204.9494624, kind="unknown",
        # 4.3 mm at 18962.96 and 18989.01 pixels to the inch
        focal=(4.3 * (18962.96296 * 18989.01099) ** 0.5 / 25.4, 0.01, "focal-plane"),
    ),
    "sensefly__senseFly_SODA_rtk": Expected(
        dialect="pix4d-camera", rpy=(10.2135, 2.25634, 19.5534),
        position=(30.4917275, -96.8485162), height=235.464, kind="unknown",
        focal=(28 / 43.2666 * 1644.12, 0.1, "35 mm"),
    ),
    "skydio__Skydio2_skydio-catilina": Expected(
        dialect="skydio", rpy=(0.186841, -7.468572, 127.444323), vehicle_yaw=126.820102,
        position=(32.5189354, -110.924547), height=1034.441, kind="unknown",
        focal=(2378.525221 * 1500 / 4056, 0.01, "Skydio"), doubts=("Photoshop",),
    ),
    "skydio__SkydioX2_IR_S1008521": Expected(
        dialect="skydio", rpy=(-0.519399, -59.679573, 0.10035), vehicle_yaw=-0.003376,
        position=(29.785934, -95.635417), height=46.021, kind="unknown",
    ),
    "sony__HDR-AS300_DSC00001": Expected(
        position=(45.5169031, -122.572765), height=70.3, kind="unknown",
    ),
    "sony__ILCE-QX1_20191011_074853": Expected(
        position=(33.203728, 126.277475), height=-249.0, kind="unknown",
        focal=(30 / 43.2666 * 6554.4, 0.2, "35 mm"), doubts=("below sea level", "Orientation] 3"),
    ),
    "teal_flir_hadron__teal2_img_eo_00015": Expected(
        position=(40.710335, -111.89434), height=1320.454956, kind="unknown",
        # half the width over the tangent of half of 67.986198 deg
        focal=(3428.6, 1.0, "field of view"), doubts=("Teal/FLIR Hadron",),
    ),
    "teal_flir_hadron__teal2_img_ir_00015": Expected(
        position=(40.710335, -111.89434), height=1320.454956, kind="unknown",
        # 13.6 mm over a pitch of 12 um
        focal=(13.6 / 0.012, 1.0, "field of view"), doubts=("Teal/FLIR Hadron",),
    ),
}  # fmt: skip
