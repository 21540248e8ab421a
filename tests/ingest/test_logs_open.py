"""The front door of log reading: formats by content, several files, and the small text formats."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.ingest.logs.column_map import ColumnMap
from georef_gis.ingest.logs.eagle_tree import read_channels
from georef_gis.ingest.logs.open_log import format_of, read_log, read_logs
from georef_gis.ingest.tsb_line import TsbRecord, format_tsb_line, parse_tsb_line
from georef_gis.model.logs import FIX_NONE, FIX_SINGLE
from georef_gis.units import GPS_WEEK

SAMPLE = Path(__file__).parents[2] / "sample_project" / "logs"
IMU = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n"
IMU += "".join(f"{i * 0.01:.2f},0.1,0.2,0.3,0,0,-9.8\n" for i in range(20))
GNSS = "time_s,lat_deg,lon_deg,height_ellipsoidal_m\n"
GNSS += "".join(f"{i * 0.2:.1f},39.6,-80,300\n" for i in range(20))


@pytest.fixture
def put(tmp_path: Path):
    def of(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return of


# --- formats -----------------------------------------------------------------------------------


def test_sample_project_is_one_flight_of_three_files() -> None:
    logs = read_logs(sorted(SAMPLE.iterdir()))
    assert logs.imu is not None and logs.gnss is not None  # noqa: PT018
    (board,) = logs.events
    assert (board.kind, board.scale, board.sequence[0]) == ("sync_board", "gps", 1)
    assert logs.imu.time[0] < board.time[0] < board.time[-1] < logs.imu.time[-1]
    assert logs.doubts == ()


@pytest.mark.parametrize(
    ("file", "label"),
    [
        ("flight_logs/drive_0708/gnss_1934_sf.pos", "RTKLIB .pos"),
        ("flight_logs/px4_ulg/sample_log_small.ulg", "PX4 ULog"),
        ("numbers/rtk_mrk/101FTASK_Timestamp.mrk", "DJI .MRK"),
        ("flight_logs/drive_0708/imu_1934.csv", "text with columns"),
    ],
)
def test_format_is_told_by_content_whatever_the_name(
    data: Path, tmp_path: Path, file: str, label: str
) -> None:
    disguised = tmp_path / "log.txt"
    shutil.copyfile(data / file, disguised)
    assert format_of(disguised) == label


@pytest.mark.parametrize(
    ("name", "content", "label"),
    [
        ("a.bin", b"garbage\r\n$TSB,1,1536,604749.116585,1498,1*44\r\n", "sync board ($TSB)"),
        ("a.csv", b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n",
         "NMEA 0183"),
        ("a.txt", b"IMG_1.JPG 47.5 8.5 123 1 2 3\nIMG_2.JPG 47.5 8.5 123 1 2 3\n", "geoinfo"),
        ("a.ulg", IMU.encode(), "text with columns"),
    ],
)  # fmt: skip
def test_content_goes_before_the_suffix(put, name: str, content: bytes, label: str) -> None:
    assert format_of(put(name, content)) == label


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "is empty; copy the log"),
        ("a.csv", b"\x00" * 4000, "nothing but blanks"),
        ("a.csv", np.random.default_rng(5).bytes(4000), "no known format: tried PX4 ULog"),
        ("a.ulg", np.random.default_rng(6).bytes(4000), "its name says PX4 ULog, its content"),
        ("a.log", b"hello\nworld\n", r"tried PX4 ULog, .* \[logs\.columns\] or by --map"),
        ("a.csv", b"p1,p2\n1,2\n3,4\n", r"columns p1, p2 hold no IMU.*--map"),
    ],
    ids=["empty", "zeros", "garbage", "garbage by name", "words", "unknown columns"],
)
def test_what_is_no_log_is_refused_in_one_line(put, name: str, content: bytes, words: str) -> None:
    path = put(name, content)
    with pytest.raises(InputError, match=words) as caught:
        read_log(path)
    assert caught.value.source == str(path)
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: cannot be read"):
        read_log(tmp_path / "none.csv")


# --- several files -------------------------------------------------------------------------------


def test_two_imu_logs_are_refused_by_name(put) -> None:
    first, second = put("one.csv", IMU), put("two.csv", IMU)
    with pytest.raises(InputError, match=r"2 logs hold IMU: .*one\.csv and .*two\.csv"):
        read_logs([first, second])
    assert read_logs([first, second], take={"imu": second}).imu.source == str(second)


def test_two_gnss_logs_are_refused_unless_one_holds_none(put) -> None:
    first, second = put("one.csv", GNSS), put("two.csv", GNSS)
    with pytest.raises(InputError, match=r"2 logs hold GNSS: .*one\.csv and .*two\.csv"):
        read_logs([first, second])
    void = put("void.csv", GNSS.replace("39.6,-80", "nan,nan"))
    assert read_logs([void, first]).gnss.source == str(first)


def test_file_to_take_from_must_hold_the_part(put) -> None:
    imu, gnss = put("imu.csv", IMU), put("gnss.csv", GNSS)
    with pytest.raises(InputError, match=r"imu\.csv: holds no GNSS"):
        read_logs([imu, gnss], take={"gnss": imu})


def test_same_file_twice_is_one_log(put) -> None:
    path = put("imu.csv", IMU)
    assert len(read_logs([path, path]).imu) == 20


def test_no_file_is_an_error() -> None:
    with pytest.raises(InputError, match="no log is named"):
        read_logs([])


def test_mapping_of_one_file_does_not_trouble_the_other(put) -> None:
    imu = put("imu.csv", IMU.replace("time_s", "clk"))
    gnss = put("gnss.csv", GNSS)
    logs = read_logs([imu, gnss], ColumnMap.from_strings(["time=clk:s"]))
    assert (len(logs.imu), len(logs.gnss)) == (20, 20)
    with pytest.raises(InputError, match="no column 'clock'"):
        read_logs([imu, gnss], ColumnMap.from_strings(["time=clk:s", "lat=clock:deg"]))


def test_logs_without_a_common_clock_are_doubted(put) -> None:
    week = GNSS.replace("time_s", "gps_time_s").replace("\n", "\n14000000", 20)
    logs = read_logs([put("imu.csv", IMU), put("gnss.csv", week)])
    assert "no common clock" in " ".join(logs.doubts)


# --- sync board ----------------------------------------------------------------------------------

RECORDS = st.builds(
    TsbRecord,
    seq=st.integers(0, 2**32 - 1),
    gps_week=st.integers(0, 4095),
    tow_s=st.integers(0, 604_799_999_999).map(lambda v: v / 1e6),
    pulse_us=st.integers(0, 20000).map(float),
    flags=st.integers(0, 255),
)


@given(RECORDS)
def test_tsb_line_survives_a_round_trip(record: TsbRecord) -> None:
    back = parse_tsb_line(format_tsb_line(record))
    assert back is not None
    assert (back.seq, back.gps_week, back.flags) == (record.seq, record.gps_week, record.flags)
    assert back.tow_s == pytest.approx(record.tow_s, abs=1e-6)


@given(RECORDS, st.integers(0, 200), st.integers(1, 255))
def test_one_wrong_byte_is_never_taken_for_another_record(
    record: TsbRecord, at: int, change: int
) -> None:
    line = bytearray(format_tsb_line(record).rstrip())
    at %= len(line)
    line[at] ^= change
    back = parse_tsb_line(bytes(line))
    # Case of the checksum's letters is the only change that means nothing.
    assert back is None or back == parse_tsb_line(format_tsb_line(record))


def test_tsb_checksum_is_that_of_nmea() -> None:
    # by hand: the exclusive or of the line that the simulator wrote
    assert parse_tsb_line(b"$TSB,1,1536,604749.116585,1498,1*44\r\n") == TsbRecord(
        seq=1, gps_week=1536, tow_s=604749.116585, pulse_us=1498.0, flags=1
    )
    assert parse_tsb_line(b"$TSB,1,1536,604749.116585,1498,1*45\r\n") is None
    assert parse_tsb_line(b"$TSB,1,1536,604749.116585,1498*69") is None


def test_tsb_file_passes_garbage_and_counts_damaged_lines(put) -> None:
    lines = [
        format_tsb_line(TsbRecord(seq=i, gps_week=2400, tow_s=100.0 + i, pulse_us=1500, flags=1))
        for i in range(1, 7)
    ]
    lines[2] = lines[2].replace(b"103", b"903")
    lines[4] = lines[4][:12]
    raw = b"\xff\xfe noise\r\n" + b"# boot 1.2\r\n".join(lines)
    logs = read_log(put("board.log", raw))
    (board,) = logs.events
    assert board.sequence.tolist() == [1, 2, 4, 6]
    assert board.time == pytest.approx(2400 * GPS_WEEK + np.array([101.0, 102.0, 104.0, 106.0]))
    assert "2 of 6 $TSB lines are damaged (line 6, 10)" in logs.doubts[0]


def test_tsb_file_over_the_turn_of_the_week_and_before_gps_time(put) -> None:
    def line(seq: int, week: int, tow: float, flags: int) -> bytes:
        record = TsbRecord(seq=seq, gps_week=week, tow_s=tow, pulse_us=1500, flags=flags)
        return format_tsb_line(record)

    turn = [line(1, 0, 12.0, 0), line(2, 2400, 604799.0, 1), line(3, 2400, 1.0, 1)]
    logs = read_log(put("board.log", b"".join(turn)))
    assert logs.events[0].sequence.tolist() == [2, 3]
    assert np.diff(logs.events[0].time) == pytest.approx([2.0])
    assert "before the board had GPS time (sequence 1)" in " ".join(logs.doubts)
    none = read_log(put("none.log", line(1, 0, 12.0, 0) + line(2, 0, 14.0, 0)))
    assert (none.events[0].scale, none.events[0].time.tolist()) == ("boot", [12.0, 14.0])


def test_tsb_file_without_a_whole_line_names_the_baud_rate(put) -> None:
    with pytest.raises(InputError, match=r"no whole \$TSB line \(1 damaged\); check the baud rate"):
        read_log(put("board.log", b"$TSB,1,15\x9036,604749.11*44\r\n"))


# --- Eagle Tree ----------------------------------------------------------------------------------

FDR = (
    "Milliseconds IsEvent EventCode EventData Altitude Airspeed ServoCurrent*100 Throttle "
    "GPSLat GPSLon GPSAlt GPSSpeed GPSCourse NumSats Servo1"
)


def _fdr(unit: float = 0.44704, *, restart: bool = False) -> str:
    """A straight flight to the east at 20 m/s; the GPS at 5 Hz in records at 10 Hz."""
    out = ["My Foamy", "12 34 0 1", "All Sessions", "0 300", FDR, "0 1 9 0 " + " ".join("0" * 11)]
    for i in range(300):
        way = (i // 2) * 0.2 * 20.0 / 6371000.0 / math.cos(math.radians(39.6))
        place = f"39.6 {-80 + math.degrees(way):.7f} 1000 {20 / unit:.2f} 90 8"
        place = place if i >= 10 else "0 0 0 0 0 0"
        time = i * 100 - (20000 if restart and i >= 200 else 0)
        out.append(f"{time} 0 0 0 100 {18 / unit:.1f} 45 1500 {place} {1000 + i}")
        if i == 50:
            out.append(f"{time} 1 18 77 9999 9999 0 0 0 0 0 0 0 0 0")
    return "\n".join(out) + "\n"


def test_eagle_tree_is_parsed_by_column_name(put) -> None:
    path = put("flight.fdr", _fdr())
    assert format_of(path) == "Eagle Tree .FDR"
    logs = read_log(path)
    fix = logs.gnss.fix
    assert (fix[0], fix[-1], logs.gnss.scale) == (FIX_NONE, FIX_SINGLE, "boot")
    assert len(fix) == 146
    assert math.degrees(logs.gnss.lat[-1]) == pytest.approx(39.6)
    # m/s: two decimals of miles per hour
    assert logs.gnss.v_ned[-1, :2] == pytest.approx([0.0, 20.0], abs=0.01)
    assert logs.gnss.height[-1] == pytest.approx(304.8)
    values = {a.kind: a.value[5] for a in logs.aids}
    assert values["baro_height"] == pytest.approx(30.48)
    assert values["airspeed"] == pytest.approx(18.0, abs=0.05)
    assert "2 event records passed (restart 1x, GPS packet 1x)" in logs.doubts


def test_eagle_tree_in_kilometres_has_metres(put) -> None:
    logs = read_log(put("flight.fdr", _fdr(1 / 3.6)))
    assert logs.gnss.height[-1] == 1000.0
    assert "GPSSpeed in km/h" in " ".join(logs.doubts)


def test_eagle_tree_height_needs_a_unit(put) -> None:
    path = put("flight.fdr", _fdr(0.2))
    with pytest.raises(InputError, match=r"GPSAlt: the unit of this height .*'height = GPSAlt:ft'"):
        read_log(path)
    logs = read_log(path, columns=ColumnMap.from_strings(["height=GPSAlt:m"]))
    assert logs.gnss.height[-1] == 1000.0


def test_eagle_tree_channels_are_by_name_in_seconds(put) -> None:
    channels = read_channels(put("flight.fdr", _fdr()))
    assert channels["time"] == pytest.approx(0.1 * np.arange(300))
    assert channels["Servo1"].tolist() == list(range(1000, 1300))
    assert channels["ServoCurrent"][0] == pytest.approx(0.45)


def test_eagle_tree_restart_leaves_the_longest_run(put) -> None:
    path = put("flight.fdr", _fdr(restart=True))
    assert len(read_channels(path)["time"]) == 200
    assert "was started 2 times" in " ".join(read_log(path).doubts)


def test_eagle_tree_without_records_is_refused(put) -> None:
    with pytest.raises(InputError, match="holds no record"):
        read_log(put("flight.fdr", f"My Foamy\n1 2\n{FDR}\n"))


# --- geoinfo -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "row", "doubt"),
    [
        ("#name latitude/Y longitude/X height/Z yaw pitch roll SAlt\n",
         "IMG_{i}.JPG 47.5 8.5 123.5 350 2 -1 0\n", "yaw, pitch, roll state no unit"),
        ("image_id lon lat alt yaw roll pitch\n",
         "IMG_{i}.JPG 8.5 47.5 123.5 350 -1 2\n", "state no unit; taken in degrees"),
        ("image,lat_deg,lon_deg,height_ellipsoidal_m,heading_deg,pitch_deg,roll_deg\n",
         "IMG_{i}.JPG,47.5,8.5,123.5,350,2,-1\n", "states no times"),
        ("", "IMG_{i}.JPG;47,5;8,5;123,5;350;2;-1\n", "the file has no header"),
    ],
    ids=["mission planner", "other order", "units", "no header"],
)  # fmt: skip
def test_geoinfo_gives_places_and_angles_by_photo(put, head: str, row: str, doubt: str) -> None:
    text = head + "".join(row.format(i=i) for i in range(5))
    logs = read_log(put("geoinfo.txt", text))
    (events,) = logs.events
    assert events.names == tuple(f"IMG_{i}.JPG" for i in range(5))
    place = math.degrees(events.lat[0]), math.degrees(events.lon[0]), events.height[0]
    assert place == pytest.approx((47.5, 8.5, 123.5))
    assert np.degrees(events.rpy[0]) == pytest.approx([-1.0, 2.0, 350.0])
    assert np.isnan(events.time).all()
    assert doubt in " ".join(logs.doubts)


def test_geoinfo_with_times_has_times(put) -> None:
    text = "photo,gps_week,tow_s,lat,lon,height\n"
    text += "".join(f"A{i}.JPG,2400,{i},47.5,8.5,100\n" for i in range(5))
    (events,) = read_log(put("geo.csv", text)).events
    assert events.time == pytest.approx(2400 * GPS_WEEK + np.arange(5.0))
