"""Only multirotors are judged: what a boat, a plane or a helicopter is answered, in every kind of log and on a link."""

from pathlib import Path

import pytest
from made_logs import DataFlashMessage, ULogTopic, dataflash, ulog, ulog_message

import mavdiag as md
from mavdiag.airframe.vehicle_type import MULTIROTORS
from mavdiag.errors import InputError
from mavdiag.link.codec import Encoder
from mavdiag.link.messages import MessageId
from mavdiag.link.vehicles import LinkDecoder
from mavdiag.logs.tlog import tlog_record, vehicle_stream

BOAT = "a boat (MAV_TYPE 11): mavdiag judges multirotors only"
START_US = 1_763_000_000_000_000
LEVEL = (1.0, 0.0, 0.0, 0.0)

MSG = DataFlashMessage(33, "MSG", "QZ", "TimeUS,Message")
PARM = DataFlashMessage(32, "PARM", "QNf", "TimeUS,Name,Value")
IMU = DataFlashMessage(163, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
SENSORS = ULogTopic(1, "sensor_combined", (("uint64_t", "timestamp"), ("float[3]", "gyro_rad")))
STATE_FIELDS = (("uint64_t", "timestamp"), ("uint8_t", "arming_state"), ("uint8_t", "system_type"))
STATUS = ULogTopic(7, "vehicle_status", STATE_FIELDS)


def stream(kind: int, sysid: int = 1, n: int = 300) -> list[tuple[int, bytes]]:
    """Frames of a vehicle of this MAV_TYPE at 100 Hz, a heartbeat a second, with their times since the start [us]."""
    encoder, found = Encoder(sysid, 1), []
    for k in range(n):
        data = encoder.encode(MessageId.HEARTBEAT, kind, 3, 128, 0, 4, 3) if k % 100 == 0 else b""
        target = (5_000 + 10 * k, 0, LEVEL, 0, 0, 0, 0.5)
        for frame in (
            data,
            encoder.encode(MessageId.ATTITUDE_TARGET, *target),
            encoder.encode(MessageId.RAW_IMU, 5_000_000 + 10_000 * k, 0, 0, -1000, 1, 2, 3),
        ):
            found += [(10_000 * k, frame)] if frame else []
    return found


def tlog(path: Path, *streams: list[tuple[int, bytes]]) -> Path:
    frames = sorted((one for some in streams for one in some), key=lambda one: one[0])
    path.write_bytes(b"".join(tlog_record(START_US + t_us, frame) for t_us, frame in frames))
    return path


@pytest.mark.parametrize("kind", [0, 2, 13, 43, 1, 4, 11, 22])
def test_a_multirotor_of_a_telemetry_log_is_read_and_any_other_vehicle_refused(kind: int, tmp_path: Path) -> None:
    path = tlog(tmp_path / "a.tlog", stream(kind))
    if kind in MULTIROTORS:
        assert md.read_log(path).mav_type == kind
        return
    with pytest.raises(InputError, match=rf"a\.tlog: .*\(MAV_TYPE {kind}\): mavdiag judges multirotors only"):
        md.read_log(path)


def test_a_multirotor_beside_a_boat_is_read_and_the_boat_is_told(tmp_path: Path) -> None:
    path = tlog(tmp_path / "both.tlog", stream(11, sysid=1), stream(2, sysid=7))
    log = md.read_log(path)
    assert log.notes == (f"vehicle 1 is left out: {BOAT}",)
    assert [one.vehicle for one in vehicle_stream(path)] == [7]
    with pytest.raises(InputError, match=r"MAV_TYPE 11"):
        md.read_log(path, vehicle=1)


@pytest.mark.parametrize(
    ("texts", "parameters", "kind"),
    [
        (["ArduCopter V4.5.6 (bbf0b066)"], {"FRAME_CLASS": 1.0}, 2),
        (["ArduCopter V4.3.6 (0c5e999c)"], {"FRAME_CLASS": 4.0}, 14),
        (["APM:Copter V3.3-dev (ae3192b8)", "PX4: 6013 NuttX: 1e53", "Frame: QUAD"], {"FRAME": 1.0}, 2),
        (["APM:Copter V3.4.6 (1)", "Frame: Y6"], {"FRAME": 10.0}, 13),
        (["Rover is a word"], {}, None),
        (["ArduRover V4.2.3 (3fc3011a)"], {"FRAME_CLASS": 2.0}, "a boat (MAV_TYPE 11)"),
        (["ArduPlane V4.5.1 (1)"], {"Q_ENABLE": 1.0}, "a plane (MAV_TYPE 1)"),
        (["ArduCopter V4.4.0 (1)"], {"FRAME_CLASS": 6.0}, "a helicopter (MAV_TYPE 4)"),
    ],
)
def test_a_dataflash_log_tells_it_by_firmware_and_frame(
    texts: list[str], parameters: dict[str, float], kind: int | str | None, tmp_path: Path
) -> None:
    path = binary(tmp_path, texts, parameters)
    if not isinstance(kind, str):
        assert md.read_log(path).mav_type == kind
        return
    with pytest.raises(InputError) as caught:
        md.read_log(path)
    assert str(caught.value).endswith(f"{kind}: mavdiag judges multirotors only")


def binary(folder: Path, texts: list[str], parameters: dict[str, float]) -> Path:
    records = [PARM.record(1, name.encode(), value) for name, value in parameters.items()]
    records += [MSG.record(2, text.encode()) for text in texts]
    records += [IMU.record(3 + k, 0, 0, 0, 0, 0, 0, -9.8) for k in range(30)]
    path = folder / "log.bin"
    path.write_bytes(dataflash([PARM, MSG, IMU], records))
    return path


@pytest.mark.parametrize(
    ("types", "name"), [([2, 2], ""), ([10, 10], "a rover"), ([22], "a VTOL"), ([2, 2, 1], ""), ([], "a submarine")]
)
def test_a_ulog_tells_it_by_the_vehicle_s_state_or_a_parameter(types: list[int], name: str, tmp_path: Path) -> None:
    records = [STATUS.record(10 + k, 2, kind) for k, kind in enumerate(types)]
    key, path = b"int32_t MAV_TYPE", tmp_path / "log.ulg"
    records += [] if types else [ulog_message("P", bytes([len(key)]) + key + (12).to_bytes(4, "little"))]
    path.write_bytes(ulog([SENSORS, STATUS], [*records, SENSORS.record(9, 0, 0, 0)]))
    if not name:
        assert md.read_log(path).mav_type == 2
        return
    with pytest.raises(InputError, match=rf"{name} \(MAV_TYPE"):
        md.read_log(path)


@pytest.mark.parametrize("careful", [False, True])
def test_on_a_link_only_a_multirotor_enters(careful: bool) -> None:
    decoder = LinkDecoder(careful=careful)
    wrong = Encoder(7, 1).encode(MessageId.HEARTBEAT, 11, 3, 128, 0, 4, 3)  # made up or damaged: it keeps nobody out
    decoder.feed([(wrong, 0)], 0)
    for t_us, frame in sorted([*stream(11, sysid=1, n=600), *stream(2, sysid=7, n=600)], key=lambda one: one[0]):
        decoder.feed([(frame, 1_000 * t_us)], 1_000 * t_us)
    assert list(decoder.vehicles) == [7]
    assert decoder.waiting == {1: BOAT}
