"""Names of columns in text logs: what each quantity is called, and the unit in a header."""

from __future__ import annotations

import re
from dataclasses import dataclass

from georef_gis.ingest.logs.column_units import Dimension, Unit, unit_of, units_of

# Quantities a text log may hold, as a mapping names them, and what each measures.
TARGETS: dict[str, Dimension] = {
    "gps_week": "count", "tow": "time", "gps_time": "time", "utc": "text", "utc_date": "text",
    "unix_time": "time", "boot_time": "time", "time": "time",
    **{f"gyro_{a}": "rate" for a in "xyz"},
    **{f"accel_{a}": "acceleration" for a in "xyz"},
    **{f"mag_{a}": "field" for a in "xyz"},
    "lat": "angle", "lon": "angle",
    "height_ellipsoidal": "length", "height_orthometric": "length",
    "height_above_ground": "length", "height": "length", "geoid_separation": "length",
    "v_north": "speed", "v_east": "speed", "v_down": "speed", "v_up": "speed",
    "ground_speed": "speed", "course": "angle",
    "sigma_north": "length", "sigma_east": "length", "sigma_down": "length",
    "sigma_h": "length",
    "sigma_v_north": "speed", "sigma_v_east": "speed", "sigma_v_down": "speed",
    "sigma_speed": "speed",
    "fix": "count", "nmea_quality": "count", "rtklib_quality": "count", "satellites": "count",
    "roll": "angle", "pitch": "angle", "yaw": "angle",
    "sigma_roll": "angle", "sigma_pitch": "angle", "sigma_yaw": "angle",
    "baro_height": "length", "airspeed": "speed", "heading": "angle",
    "event": "count", "photo": "text", "sigma_time": "time", "flags": "count", "pulse": "time",
}  # fmt: skip
# Quantities whose x, y and z belong together.
TRIPLETS = ("gyro", "accel", "mag")
# Texts in cells rather than numbers; a fix may be either.
TEXTS = frozenset({"utc", "utc_date", "photo", "fix"})

_AXIS_BASES = {
    "gyro": "gyro gyr gyroscope g w omega rate angularrate angularvelocity angvel rotationrate "
    "imugyro gyrorate bodyrate angularspeed gyrob gyroraw gyrorotation",
    "accel": "accel acc a f acceleration accelerometer linearacceleration specificforce sf "
    "imuaccel imuacc accelb force linacc accelerometeracceleration",
    "mag": "mag m magnetometer magneticfield magfield compass imumag",
}
# Target -> other names, letters and digits only.
_OTHERS = {
    "gps_week": "gpsweek week wn weekno weeknumber gpswk gpsweekno gpswno",
    "tow": "tow gpstow timeofweek secondsofweek secofweek gpssow sow itow gpssecondsofweek "
    "weekseconds gpstimeofweek gpstows towgps gpsms",
    "gps_time": "gpstime gpsseconds gpst timegps gpsepoch gpstimestamp",
    "utc": "utc datetime utcdatetime timeutc utctime isotime datetimeutc iso8601 timestamputc "
    "gpsutc dateandtime timeiso gpsdatetime utctimestamp",
    "utc_date": "date utcdate gpsdate dateutc",
    "unix_time": "unixtime unix epoch epochtime posixtime unixtimestamp timeunix timestampunix "
    "posix utcunix",
    "boot_time": "boottime timeboot uptime timesinceboot timesincestart timesincestartup "
    "sincepowerup timefromboot elapsed elapsedtime timesincepoweron",
    "time": "time t timestamp stamp sampletime logtime recordtime clock imutime timetag tstamp",
    "lat": "lat latitude gpslat gpslatitude latdeg gnsslat positionlat",
    "lon": "lon long lng longitude gpslon gpslong gpslng gpslongitude gnsslon positionlon",
    "height_ellipsoidal": "heightellipsoidal ellipsoidalheight hae altellipsoidal "
    "altitudeellipsoidal altellipsoid altitudeellipsoid ellipsoidheight heightellipsoid hell "
    "heightaboveellipsoid altitudehae althae altwgs84 heightwgs84 hgtwgs84 heighthae ellh",
    "height_orthometric": "heightorthometric orthometricheight altmsl altitudemsl msl amsl "
    "altamsl altitudeamsl hmsl heightmsl mslalt mslaltitude gpsaltmsl altitudeabovesealevel "
    "heightabovesealevel gpshmsl elevationmsl altitudemeansealevel",
    "height_above_ground": "heightaboveground agl altagl altitudeagl heightagl relalt "
    "relativealtitude altrel heightabovetakeoff relativealt altrelative",
    "height": "height alt altitude gpsalt gpsaltitude elevation ele hgt gpsheight gnssheight "
    "gnssalt elev heightz",
    "geoid_separation": "geoidseparation undulation geoidheight geoidsep geoid geoidundulation",
    "v_north": "vnorth vn velnorth velocitynorth northvelocity veln gpsveln gpsvn vnedn velnedx "
    "gpsvelnorth speednorth northspeed velnednorth gpsnorthv",
    "v_east": "veast ve veleast velocityeast eastvelocity vele gpsvele gpsve vnede velnedy "
    "gpsveleast speedeast eastspeed velnedeast gpseastv",
    "v_down": "vdown vd veldown velocitydown downvelocity veld gpsveld gpsvd vnedd velnedz "
    "gpsveldown speeddown downspeed velneddown gpsdownv",
    "v_up": "vup vu velup velocityup upvelocity climb climbrate verticalspeed vspeed vario vv",
    "ground_speed": "groundspeed gspeed gspd gpsspeed speed sog speedoverground gpsspd spd "
    "gpsgroundspeed velocity horizontalspeed hspeed",
    "course": "course cog courseoverground track gpscourse gpstrack headmot headingmotion gcrs "
    "trackangle coursetrue gpscog groundtrack headingofmotion bearing",
    "sigma_north": "sigmanorth sdn stdnorth northsigma sdnorth stdn sigman northstd",
    "sigma_east": "sigmaeast sde stdeast eastsigma sdeast stde sigmae eaststd",
    "sigma_down": "sigmadown sigmaup sdu sdd stdup stdu upsigma sigmavertical vacc epv stdheight "
    "verticalaccuracy vaccuracy sigmaheight sigmaz downstd upstd verticalsigma",
    "sigma_h": "sigmah hacc eph horizontalaccuracy haccuracy sigmahorizontal accuracyh gpshacc",
    "sigma_v_north": "sigmavnorth sdvn stdvn sigmavn sigmavelnorth",
    "sigma_v_east": "sigmaveast sdve stdve sigmave sigmaveleast",
    "sigma_v_down": "sigmavdown sigmavup sdvu sdvd stdvu stdvd sigmavd sigmaveldown",
    "sigma_speed": "sigmaspeed sacc speedaccuracy sigmavelocity svariance velocityaccuracy",
    "fix": "fix fixtype gpsfix gpsfixtype gnssfix gpsstatus",
    "nmea_quality": "nmeaquality ggaquality",
    "rtklib_quality": "rtklibquality q",
    "satellites": "satellites sats numsats nsats numsv satellitesused nsat numsat ns satcount "
    "gpssats nsv numsatellites gpsnumsats",
    "roll": "roll phi bank rollangle attroll bankangle",
    "pitch": "pitch theta pitchangle attpitch",
    "yaw": "yaw psi yawangle attyaw trueheading headingtrue azimuth",
    "sigma_roll": "sigmaroll sdroll stdroll rollsigma",
    "sigma_pitch": "sigmapitch sdpitch stdpitch pitchsigma",
    "sigma_yaw": "sigmayaw sdyaw stdyaw sigmaheading yawsigma",
    "baro_height": "baroheight baroalt barometricaltitude baroaltitude pressurealtitude altbaro "
    "barometricheight baro",
    "airspeed": "airspeed tas trueairspeed",
    "heading": "heading hdg compassheading",
    "event": "event eventid trigger shot photonumber imageindex imgidx exposure exposureid "
    "triggerid eventno eventnumber shotnumber triggernumber eventseq shotid",
    "photo": "photo image filename photoname imagename img imagefile file photofile imageid name",
    "sigma_time": "sigmatime sigmat timesigma timeaccuracy accest tacc sigma",
    "flags": "flags eventflags triggerflags",
    "pulse": "pulse pulsewidth",
}
# Headers that name their unit: key -> (target, unit).
_WITH_UNIT = {
    "millis": ("boot_time", "ms"), "milliseconds": ("boot_time", "ms"),
    "micros": ("boot_time", "us"), "microseconds": ("boot_time", "us"),
    "millisecond": ("boot_time", "ms"), "ms": ("boot_time", "ms"),
    "bootms": ("boot_time", "ms"), "bootus": ("boot_time", "us"), "boots": ("boot_time", "s"),
    "itow": ("tow", "ms"), "gpsms": ("tow", "ms"), "seconds": ("time", "s"),
    "secs": ("time", "s"), "sec": ("time", "s"), "unixms": ("unix_time", "ms"),
    "unixus": ("unix_time", "us"), "unixs": ("unix_time", "s"), "unixns": ("unix_time", "ns"),
    "epochms": ("unix_time", "ms"), "pulseus": ("pulse", "us"), "sow": ("tow", "s"),
}  # fmt: skip
# Letters that mean a rate only where all three stand in the file.
WEAK_TRIPLETS = {("p", "q", "r"): "gyro", ("u", "v", "w"): ""}


def _synonyms() -> dict[str, str]:
    table: dict[str, str] = {}
    for quantity, bases in _AXIS_BASES.items():
        for base in bases.split():
            for axis in "xyz":
                for key in (base + axis, axis + base if len(base) > 1 else base + axis):
                    table[key] = f"{quantity}_{axis}"
    for target, names in _OTHERS.items():
        for name in names.split():
            table[name] = target
    return table


SYNONYMS = _synonyms()
_BRACKET = re.compile(r"^(.*?)[\s_]*[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


@dataclass(frozen=True, slots=True, kw_only=True)
class Heading:
    """A header as understood: its quantity, and its unit where the header says it."""

    text: str
    target: str
    unit: Unit | None
    # unit that the header states but that does not measure the quantity
    unfit: str = ""


def compact(text: str) -> str:
    """Letters and digits of a name in lower case."""
    return re.sub(r"[^a-z0-9]", "", text.lower())


def base_name(header: str) -> str:
    """Header without a unit in brackets."""
    found = _BRACKET.match(header)
    return found[1] if found and (units_of(found[2]) or not found[2]) else header


def understand(header: str, unit_text: str = "") -> Heading | None:
    """What a header means, or None.

    Parameters
    ----------
    header
        Text of the header such as `gyro_x_deg_s`, `ax[g]`, `Lat (deg)`, `TimeUS`.
    unit_text
        Unit that a line of units below the header states.
    """
    text, stated = header.strip(), unit_text
    found = _BRACKET.match(text)
    if found and units_of(found[2]):
        text, stated = found[1], found[2]
    # "angular_velocity.x", "imu/gyro/x": dots and bars part names as underscores do
    tokens = [t for t in re.split(r"[^a-z0-9]+", _CAMEL.sub("_", text).lower()) if t]
    key = "".join(tokens)
    if key in _WITH_UNIT and not stated:
        target, unit = _WITH_UNIT[key]
        return Heading(text=header, target=target, unit=unit_of(unit, TARGETS[target]))
    if key in SYNONYMS:
        return _heading(header, SYNONYMS[key], stated)
    for count in (3, 2, 1):
        base = SYNONYMS.get("".join(tokens[:-count])) if len(tokens) > count else None
        unit_here = unit_of("".join(tokens[-count:]), TARGETS[base]) if base else None
        if base and unit_here:
            return Heading(text=header, target=base, unit=unit_here)
    return None


def _heading(header: str, target: str, stated: str) -> Heading:
    unit = unit_of(stated, TARGETS[target]) if stated else None
    unfit = stated if stated and unit is None and units_of(stated) else ""
    if TARGETS[target] in {"count", "text", "field"}:
        unfit = ""
    return Heading(text=header, target=target, unit=unit, unfit=unfit)
