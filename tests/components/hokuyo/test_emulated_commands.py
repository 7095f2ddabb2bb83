"""Every command of an emulated sensor, and the statuses with which it answers."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.hokuyo.emulated_models import MODELS
from cairn.components.hokuyo.emulated_scip import EmulatedScip


def _statuses(sensor: EmulatedScip, commands: str, now: float = 0.0) -> list[str]:
    """The statuses of the answers to commands, each of which begins with its command's echo."""
    answers = sensor.receive("".join(f"{one}\n" for one in commands.split()).encode(), now)
    for command, answer in zip(commands.split(), answers, strict=True):
        assert answer.startswith(command.encode() + b"\n")
    return [answer.split(b"\n")[1][:-1].decode() for answer in answers]


@pytest.mark.parametrize(
    ("model", "commands", "statuses"),
    [
        ("UTM-30LX", "BM BM QT QT", "00 02 00 00"),
        ("UTM-30LX", "GD0000108001 GE0000108001 GS0000108001", "10 10 10"),
        ("UTM-30LX", "MDx000108001000 MD0000x08001000 MD00001080x1000", "01 02 03"),
        ("UTM-30LX", "MD0000108101000 MD0010000901000", "04 05"),
        ("UTM-30LX", "MD000010800100 MD00001080010000 MD", "0C 0D 0C"),
        ("UTM-30LX", "MD0000108001x00 MD00001080010x0", "06 07"),
        ("UTM-30LX", "TM1 TM2 TM3 TM0 TM0 TM1", "04 03 01 00 02 00"),
        ("UTM-30LX", "TM0 QT VV MD0000108001000 TM2 VV", "00 0E 0E 0E 00 00"),
        ("UTM-30LX", "CR05 CR05 CR11 CRx0 CR99 CR00", "00 03 02 01 00 03"),
        ("UTM-30LX", "HS1 HS1 HS0 HS2", "00 02 00 01"),
        ("UTM-30LX", "SS115200 SSx15200 SS123456 SS1152", "04 01 02 0C"),
        ("UTM-30LX", "RS RT RB RB", "00 00 01 00"),
        ("UTM-30LX", "XX Q SCIP2.0 ND0000108001000 DB02 %SL", "0E 0E 0E 0E 0E 0E"),
        ("UTM-30LX", "VV;abcdefghijklmnop VV;abcdefghijklmnopq VV;a-b VV;.@+_", "00 0G 0H 00"),
        ("URG-04LX", "DB07 DB02 BM MD0044072501000 DB10 BM", "01 00 01 50 00 00"),
        ("URG-04LX-UG01", "DB02 ME0044072501000 %ST", "0E 0E 0E"),
        ("UST-10LX", "SS115200 MS0000108001000 XX", "0F 0F 0E"),
        ("UST-10LX", "TM1 TM0 QT BM MD0000108001000 TM2", "00 00 10 10 10 00"),
        ("UST-10LX", "MD0000108001000 TM0 QT TM0", "00 10 00 00"),
        ("UTM-30LX-EW", "MD0000108001000 TM0 VV", "00 10 00"),
    ],
)  # fmt: skip
def test_commands_are_answered_as_specified(model: str, commands: str, statuses: str) -> None:
    assert _statuses(EmulatedScip(model), commands) == statuses.split()


def test_an_rs232_line_changes_its_speed() -> None:
    sensor = EmulatedScip("URG-04LX", rs232_baud=19200)
    assert sensor.baud() == 19200
    assert _statuses(sensor, "SS019200 SS115200") == ["03", "00"]
    assert sensor.baud() == 115200
    _statuses(sensor, "RT")
    assert sensor.baud() == 115200
    _statuses(sensor, "RS")
    assert sensor.baud() == 19200


@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\n", b"\n\n"])
def test_a_line_may_end_in_several_ways_and_come_in_pieces(end: bytes) -> None:
    sensor = EmulatedScip()
    answers = [answer for byte in b"BM" + end for answer in sensor.receive(bytes([byte]), 0.0)]
    assert answers == [b"BM\n00P\n\n"]


def test_states_are_told_by_number() -> None:
    sensor = EmulatedScip("UST-10LX")
    told = []
    for command in (b"VV", b"BM", b"MD0000108001000", b"QT", b"TM0", b"TM2", b"%SL"):
        sensor.receive(command + b"\n", 0.0)
        (answer,) = sensor.receive(b"%ST\n", 0.0)
        told.append(answer.split(b"\n")[2][:3])
    assert told == [b"000", b"003", b"004", b"000", b"002", b"000", b"005"]


def test_a_reboot_takes_two_commands_within_a_second() -> None:
    sensor = EmulatedScip()
    assert _statuses(sensor, "BM RB") == ["00", "01"]
    assert _statuses(sensor, "RB", now=1.5) == ["01"]
    assert _statuses(sensor, "RB", now=2.0) == ["00"]
    assert sensor.receive(b"VV\n", 2.5) == []  # it boots
    assert _statuses(sensor, "BM", now=4.0) == ["00"]


def test_scip_1_is_spoken_until_it_is_switched_and_again_after_power_on() -> None:
    sensor = EmulatedScip("URG-04LX", speaks_scip1=True, rs232_baud=19200)
    assert sensor.receive(b"QT\n", 0.0) == [b"QT\nE\n\n"]
    (version,) = sensor.receive(b"V\n", 0.0)
    assert version.startswith(
        b"V\n0\nVEND:Hokuyo Automatic Co.,Ltd.\nPROD:SOKUIKI Sensor URG-04LX\n"
    )
    assert sensor.receive(b"G00076801\n", 0.0) == [b"G00076801\n1\n\n"]  # its laser is off
    (_, scan) = sensor.receive(b"L1\nG00076801\n", 0.0)
    assert scan.startswith(b"G00076801\n0\n")
    assert sum(len(line) for line in scan.split(b"\n")[2:]) == 2 * 769
    assert sensor.receive(b"S1152000000000\n", 0.0) == [b"S1152000000000\n0\n\n"]
    assert sensor.baud() == 115200
    assert sensor.receive(b"SCIP2.0\nSCIP2.0\n", 0.0) == [b"SCIP2.0\n0\n\n", b"SCIP2.0\n0Ee\n\n"]
    assert sensor.receive(b"QT\n", 0.0) == [b"QT\n00P\n\n"]
    sensor.powered_on(1.0)
    assert sensor.receive(b"QT\n", 1.0) == [b"QT\nE\n\n"]


@settings(max_examples=50, deadline=None)
@given(model=st.sampled_from(sorted(MODELS)), noise=st.lists(st.binary(max_size=300), max_size=8))
def test_noise_does_it_no_harm(model: str, noise: list[bytes]) -> None:
    sensor = EmulatedScip(model)
    for number, data in enumerate(noise):
        for answer in sensor.receive(data, float(number)):
            assert answer.endswith(b"\n\n")
        sensor.tick(float(number))
    sensor.receive(b"\nTM2\nQT\n", 100.0)
    assert sensor.receive(b"VV\n", 100.0)[0].startswith(b"VV\n00P\n")
