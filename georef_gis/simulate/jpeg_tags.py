"""JPEG files as a reduced Canon photo carries them: EXIF, GPS position and Pix4D's Camera XMP."""

from __future__ import annotations

import io
from datetime import datetime

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from georef_gis.simulate.flight import SimulatedFlight

EXIF_IFD, GPS_IFD = 0x8769, 0x8825
SENSOR_WIDTH_MM, SENSOR_HEIGHT_MM = 22.2, 14.8  # Rebel XTi; table 2 of the report
FOCAL_MM = 18

XMP_TEMPLATE = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about="" xmlns:Camera="http://pix4d.com/camera/1.0/">
{fields}
  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>
<?xpacket end="w"?>"""


def encode_jpeg(
    flight: SimulatedFlight, index: int, rgb: NDArray[np.uint8], *, quality: int
) -> bytes:
    """JPEG bytes of a photo with the flight's tags."""
    out = io.BytesIO()
    xmp = _xmp(flight, index)
    Image.fromarray(rgb).save(
        out, format="JPEG", quality=quality, subsampling=2, optimize=True,
        exif=_exif(flight, index), **({"xmp": xmp} if xmp else {}),
    )  # fmt: skip
    return out.getvalue()


def _exif(flight: SimulatedFlight, index: int) -> Image.Exif:
    camera, clock = flight.settings.camera, flight.tags.camera_clock[index]
    exif = Image.Exif()
    exif[0x010F] = "Canon"
    exif[0x0110] = "Canon EOS DIGITAL REBEL XTi"
    exif[0x0112] = 1
    exif[0x011A] = exif[0x011B] = IFDRational(72, 1)
    exif[0x0128] = 2
    exif[0x0132] = _stamp(clock)
    exif.get_ifd(EXIF_IFD).update(
        {
            0x829A: IFDRational(1, 1000),
            0x829D: IFDRational(56, 10),
            0x8827: 200,
            0x9000: b"0221",
            0x9003: _stamp(clock),
            0x9004: _stamp(clock),
            0x920A: IFDRational(FOCAL_MM, 1),
            0xA002: camera.width,
            0xA003: camera.height,
            0xA20E: _rational(camera.width / SENSOR_WIDTH_MM * 25.4, 10000),
            0xA20F: _rational(camera.height / SENSOR_HEIGHT_MM * 25.4, 10000),
            0xA210: 2,
        }
    )
    tags = flight.tags
    lat, lon = float(tags.lat_deg[index]), float(tags.lon_deg[index])
    height = float(tags.height_orthometric[index])
    exif.get_ifd(GPS_IFD).update(
        {
            0: b"\x02\x02\x00\x00",
            1: "N" if lat >= 0 else "S",
            2: _sexagesimal(abs(lat)),
            3: "E" if lon >= 0 else "W",
            4: _sexagesimal(abs(lon)),
            5: b"\x00" if height >= 0 else b"\x01",
            6: _rational(abs(height), 1000),
            18: "WGS-84",
        }
    )
    return exif


def _stamp(clock: datetime) -> str:
    return clock.strftime("%Y:%m:%d %H:%M:%S")


def _rational(value: float, denominator: int) -> IFDRational:
    return IFDRational(round(value * denominator), denominator)


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees, minutes and seconds to 1e-6 arc second (0.03 mm)."""
    micro = round(degrees * 3600e6)
    whole, rest = divmod(micro, 3600 * 10**6)
    minutes, seconds = divmod(rest, 60 * 10**6)
    return IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(seconds, 10**6)


def _xmp(flight: SimulatedFlight, index: int) -> bytes:
    settings, tags = flight.settings, flight.tags
    if settings.attitude_tag == "none":
        return b""
    fields = {
        "Yaw": f"{tags.yaw_deg[index]:.3f}",
        "Pitch": f"{tags.pitch_deg[index]:.3f}",
        "Roll": f"{tags.roll_deg[index]:.3f}",
        "GPSXYAccuracy": f"{settings.tag_sigma_h:.2f}",
        "GPSZAccuracy": f"{settings.tag_sigma_v:.2f}",
        "IMUYawAccuracy": f"{settings.tag_sigma_yaw_deg:.2f}",
        "IMUPitchAccuracy": f"{settings.attitude_sigma_deg:.2f}",
        "IMURollAccuracy": f"{settings.attitude_sigma_deg:.2f}",
    }
    lines = (f"   <Camera:{name}>{value}</Camera:{name}>" for name, value in fields.items())
    return XMP_TEMPLATE.format(fields="\n".join(lines)).encode("utf-8")
