"""The emulated scanner: bytes of real sensors, every command and its statuses, scans and stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.hokuyo_scanner.emulator import EmulatedScip
from cairn.components.hokuyo_scanner.emulator_models import MODELS
from cairn.components.hokuyo_scanner.emulator_sensor import (
    CLOCK_MS,
    ECHOES,
    SentScan,
    TurnValues,
)
from cairn.components.hokuyo_scanner.protocol import (
    NO_ECHO,
    Reply,
    ReplySplitter,
    check_sum,
    decode_number,
)

DATA = Path(__file__).parents[2] / "data" / "hokuyo"


class FixedScene:
    """The same values at every turn."""

    def __init__(self, measured: TurnValues) -> None:
        self._measured = measured

    def turn(self, _number: int, _began_s: float) -> TurnValues:
        return self._measured


def _one_echo(distances: NDArray[np.int32]) -> FixedScene:
    """A scene with one echo at each step, from step 0 on."""
    table = np.full((distances.size, ECHOES), NO_ECHO, np.int32)
    table[:, 0] = distances
    strengths = np.full_like(table, NO_ECHO)
    strengths[:, 0] = 0
    return FixedScene(TurnValues(table, strengths))


def _values(frame: bytes) -> list[int]:
    """Its distances, read one character after the other, as the specification describes."""
    text = b"".join(line[:-1] for line in frame.split(b"\n")[3:-2])
    return [
        sum((text[at + place] - 0x30) << 6 * (2 - place) for place in range(3))
        for at in range(0, len(text), 3)
    ]


def test_captured_scan_is_reproduced_byte_by_byte() -> None:
    frame = (DATA / "scip20_GD_urg04lx-ug01_A.bin").read_bytes()
    distances = np.zeros(769, np.int32)
    distances[44:726] = _values(frame)
    sensor = EmulatedScip(
        "URG-04LX-UG01", scene=_one_echo(distances), clock_start_ms=decode_number(b"ZR3h")
    )
    assert sensor.receive(b"BM\nGD0044072501\n", 0.0) == [b"BM\n00P\n\n"]
    assert sensor.tick(sensor.due()) == [frame]


def test_captured_version_is_reproduced_byte_by_byte() -> None:
    frame = (DATA / "scip20_VV_urg04lx-ug01.bin").read_bytes()
    sensor = EmulatedScip("URG-04LX-UG01", serial_number="H1510998")
    assert sensor.receive(b"VV\n", 0.0) == [frame]


def test_pp_reply_equals_the_published_one() -> None:
    # urgnetwork, "Obtain status information"
    assert EmulatedScip("URG-04LX").receive(b"PP\n", 0.0) == [
        b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\n"
        b"ARES:1024;\\\nAMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n"
    ]


def test_ii_reply_equals_the_published_one() -> None:
    # The same page: 0x081615 ms after power-on, on RS-232.
    sensor = EmulatedScip("URG-04LX", rs232_baud=19200, clock_start_ms=0x081615)
    assert sensor.receive(b"II\n", 0.0) == [
        b"II\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nLASR:OFF;7\n"
        b"SCSP:Initial(600[rpm])<-Default setting by user;A\nMESM:IDLE;:\n"
        b"SBPS:19200[bps]<-Default setting by user;A\nTIME:081615;N\n"
        b"STAT:Sensor works well.;8\n\n"
    ]


def test_check_sums_may_exclude_what_follows_an_arrow() -> None:
    (answer,) = EmulatedScip("UTM-30LX", sums_arrows=False).receive(b"II\n", 0.0)
    line = next(line for line in answer.split(b"\n") if line.startswith(b"SCSP:"))
    assert line[-1:] == check_sum(line.partition(b"<-")[0]) != check_sum(line[:-2])


# Bytes of whole messages, as independent clients have counted them.
@pytest.mark.parametrize(
    ("model", "command", "length"),
    [
        ("URG-04LX", "MD0044072501000", 2137),
        ("URG-04LX", "MS0044072501000", 1435),
        ("UTM-30LX", "MD0000108001000", 3372),
        ("UTM-30LX", "ME0000108001000", 6717),
    ],
)
def test_scans_have_the_length_of_real_ones(model: str, command: str, length: int) -> None:
    sensor = EmulatedScip(model, scene=_one_echo(np.full(MODELS[model].steps, 1000, np.int32)))
    assert sensor.receive(command.encode() + b"\n", 0.0) == [command.encode() + b"\n00P\n\n"]
    (frame,) = sensor.tick(sensor.due())
    assert len(frame) == length
    assert frame.endswith(b"\n\n")
    assert all(len(line) == 65 for line in frame.split(b"\n")[3:-3])


def test_no_empty_line_follows_a_full_last_line() -> None:
    sensor = EmulatedScip("UTM-30LX", scene=_one_echo(np.full(1081, 1000, np.int32)))
    sensor.receive(b"MD0000006301000\n", 0.0)  # 64 values of 3 characters: 3 lines of 64
    (frame,) = sensor.tick(sensor.due())
    assert [len(line) for line in frame.split(b"\n")] == [15, 3, 5, 65, 65, 65, 0, 0]


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


def test_speed_of_rs232_can_be_changed() -> None:
    sensor = EmulatedScip("URG-04LX", rs232_baud=19200)
    assert sensor.baud() == 19200
    assert _statuses(sensor, "SS019200 SS115200") == ["03", "00"]
    assert sensor.baud() == 115200
    _statuses(sensor, "RT")
    assert sensor.baud() == 115200
    _statuses(sensor, "RS")
    assert sensor.baud() == 19200


@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\n", b"\n\n"])
def test_commands_may_end_in_several_ways_and_arrive_in_pieces(end: bytes) -> None:
    sensor = EmulatedScip()
    answers = [answer for byte in b"BM" + end for answer in sensor.receive(bytes([byte]), 0.0)]
    assert answers == [b"BM\n00P\n\n"]


def test_state_numbers_follow_the_state() -> None:
    sensor = EmulatedScip("UST-10LX")
    numbers = []
    for command in (b"VV", b"BM", b"MD0000108001000", b"QT", b"TM0", b"TM2", b"%SL"):
        sensor.receive(command + b"\n", 0.0)
        (answer,) = sensor.receive(b"%ST\n", 0.0)
        numbers.append(answer.split(b"\n")[2][:3])
    assert numbers == [b"000", b"003", b"004", b"000", b"002", b"000", b"005"]


def test_reboot_takes_two_commands_within_a_second() -> None:
    sensor = EmulatedScip()
    assert _statuses(sensor, "BM RB") == ["00", "01"]
    assert _statuses(sensor, "RB", now=1.5) == ["01"]
    assert _statuses(sensor, "RB", now=2.0) == ["00"]
    assert sensor.receive(b"VV\n", 2.5) == []  # it boots
    assert _statuses(sensor, "BM", now=4.0) == ["00"]


def test_scip_1_is_used_until_switched_and_again_after_power_on() -> None:
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
def test_sensor_answers_after_noise(model: str, noise: list[bytes]) -> None:
    sensor = EmulatedScip(model)
    for number, data in enumerate(noise):
        for answer in sensor.receive(data, float(number)):
            assert answer.endswith(b"\n\n")
        sensor.tick(float(number))
    sensor.receive(b"\nTM2\nQT\n", 100.0)
    assert sensor.receive(b"VV\n", 100.0)[0].startswith(b"VV\n00P\n")


def _scans(sensor: EmulatedScip, command: str, count: int) -> list[Reply]:
    """The replies with the first scans of a stream."""
    sensor.receive(command.encode() + b"\n", 0.0)
    frames: list[bytes] = []
    while len(frames) < count:
        frames += sensor.tick(sensor.due())
    return ReplySplitter().feed(b"".join(frames[:count]))


def _time_ms(reply: Reply) -> int:
    return decode_number(reply.lines[0][:4])


def test_scans_are_sent_at_the_rate_of_the_mirror() -> None:
    sensor = EmulatedScip("UTM-30LX")
    sensor.receive(b"MD0000108001000\n", 10.01)
    times = []
    for _ in range(3):
        times.append(sensor.due())
        assert len(sensor.tick(times[-1])) == 1
        assert sensor.tick(times[-1]) == []
    assert np.diff(times) == pytest.approx([0.025, 0.025])
    # A turn that begins after the command, and is sent when its last step has been measured.
    assert times[0] == pytest.approx(10.025 + 0.025 * 1081 / 1440)


def test_limited_stream_counts_down_and_switches_the_laser_off() -> None:
    sensor = EmulatedScip("UTM-30LX")
    replies = _scans(sensor, "MD0000108001203", 3)
    assert [reply.echo for reply in replies] == [
        f"MD00001080012{n:02d}".encode() for n in (2, 1, 0)
    ]
    assert [reply.code() for reply in replies] == ["99"] * 3
    assert np.diff([_time_ms(reply) for reply in replies]).tolist() == [75, 75]
    assert not sensor.sensor.laser
    assert sensor.due() == float("inf")


def test_endless_stream_keeps_its_echo_and_string() -> None:
    replies = _scans(EmulatedScip(), "MD0000108001000;mine", 3)
    assert {reply.echo for reply in replies} == {b"MD0000108001000;mine"}


def test_other_commands_are_answered_between_scans() -> None:
    sensor = EmulatedScip()
    sensor.receive(b"MD0000108001000\n", 0.0)
    assert sensor.receive(b"II\n", 1.0)[0].startswith(b"II\n00P\n")
    assert sensor.tick(1.0)[0].startswith(b"MD")
    assert sensor.receive(b"QT\n", 1.0) == [b"QT\n00P\n\n"]
    assert sensor.tick(2.0) == []


def test_clock_wraps_drifts_and_restarts() -> None:
    sensor = EmulatedScip("UTM-30LX", clock_start_ms=CLOCK_MS - 40, drift_ppm=100.0)
    times = [_time_ms(reply) for reply in _scans(sensor, "MD0000000001000", 3)]
    assert times == [CLOCK_MS - 40, CLOCK_MS - 15, 10]
    sensor.receive(b"QT\nTM0\n", 10_000.0)
    (answer,) = sensor.receive(b"TM1\n", 10_000.0)
    assert decode_number(answer.split(b"\n")[2][:4]) == 10_000_000 + 1000 - 40
    sensor.receive(b"TM2\nRS\nTM0\n", 10_000.0)
    (answer,) = sensor.receive(b"TM1\n", 10_000.03)
    assert decode_number(answer.split(b"\n")[2][:4]) == CLOCK_MS - 40 + 30


def test_old_scans_are_not_sent_after_a_busy_line() -> None:
    sensor = EmulatedScip("UTM-30LX")
    sensor.receive(b"MD0000000001000\n", 0.0)
    frames = sensor.tick(5.0)
    times = [decode_number(frame.split(b"\n")[2][:4]) for frame in frames]
    assert 0 < len(times) <= 5
    assert min(times) > 4850


def test_single_scan_waits_for_the_first_turn_of_the_laser() -> None:
    sensor = EmulatedScip("UST-10LX")
    assert sensor.receive(b"BM\nGD0000108000\n", 0.01) == [b"BM\n00P\n\n"]
    (frame,) = sensor.tick(sensor.due())
    assert frame.startswith(b"GD0000108000\n00P\n")
    assert sensor.receive(b"GE0000108000\n", 1.0)[0].startswith(b"GE0000108000\n00P\n")


def test_statuses_are_sent_instead_of_scans() -> None:
    sensor = EmulatedScip("UTM-30LX")
    sensor.send_status("0M", 2)
    assert [reply.code() for reply in _scans(sensor, "MD0000108001000", 4)] == [
        "0M", "0M", "99", "99",
    ]  # fmt: skip
    sensor.send_status("21")
    sensor.send_status("98")
    sensor.send_status("55")
    assert [reply.code() for reply in _scans(sensor, "MD0000108001000", 3)] == ["21", "98", "55"]
    assert sensor.due() == float("inf")
    assert b"STAT:Sensor malfunction No.55" in sensor.receive(b"II\n", 1.0)[0]
    assert sensor.receive(b"GD0000108001\n", 1.0) == [b"GD0000108001\n55Z\n\n"]


@pytest.mark.parametrize("model", ["UTM-30LX", "UST-10LX"])
def test_only_ethernet_sensors_notice_a_disconnected_client(model: str) -> None:
    sensor = EmulatedScip(model)
    sensor.receive(b"MD0000108001000\n", 0.0)
    sensor.disconnected(1.0)
    assert bool(sensor.tick(1.0)) == (model == "UTM-30LX")


def test_scans_differ_unless_the_seed_is_the_same() -> None:
    def sent(seed: int) -> list[SentScan]:
        scans: list[SentScan] = []
        _scans(EmulatedScip("UTM-30LX-EW", seed=seed, on_scan=scans.append), "NE0000108001000", 4)
        return scans

    first, again, other = sent(1), sent(1), sent(2)
    for one, same, different in zip(first, again, other, strict=True):
        assert np.array_equal(one.distances, same.distances)
        assert not np.array_equal(one.distances, different.distances)
    assert not np.array_equal(first[0].distances, first[1].distances)
    counts = (first[0].distances != NO_ECHO).sum(axis=1)
    assert set(counts.tolist()) == {1, 2, 3}
    assert {1, 2} <= set(first[0].distances[:, 0].tolist())  # nothing there; too near


_ECHO = st.tuples(st.integers(0, 70_000), st.integers(0, 262_143))
_STEPS = st.lists(st.lists(_ECHO, min_size=1, max_size=3), min_size=1, max_size=40)
_LETTERS = st.sampled_from(["MD", "MS", "ME", "ND", "NE"])


@settings(max_examples=60, deadline=None)
@given(steps=_STEPS, letters=_LETTERS, cluster=st.integers(0, 9))
def test_any_values_are_encoded_as_specified(
    steps: list[list[tuple[int, int]]], letters: str, cluster: int
) -> None:
    """Against a plain rendering of the text, character by character."""
    distances = np.full((1081, ECHOES), NO_ECHO, np.int32)
    intensities = distances.copy()
    distances[:, 0] = intensities[:, 0] = 0
    for step, echoes in enumerate(steps):
        distances[step, : len(echoes)] = [one for one, _ in echoes]
        intensities[step, : len(echoes)] = [one for _, one in echoes]
    sensor = EmulatedScip("UTM-30LX-EW", scene=FixedScene(TurnValues(distances, intensities)))
    (reply,) = _scans(sensor, f"{letters}0000{len(steps) - 1:04d}{cluster:02d}000", 1)

    def number(value: int) -> str:
        width = 2 if letters == "MS" else 3
        value = min(value, 64**width - 1)
        return "".join(chr(0x30 + (value >> 6 * place & 63)) for place in reversed(range(width)))

    text = ""
    group = max(1, cluster)
    for begin in range(0, len(steps), group):
        echoes = min(
            steps[begin : begin + group],
            key=lambda echoes: echoes[0][0] if echoes[0][0] >= 23 else 1_000_000,
        )
        shown = echoes if letters[0] == "N" else echoes[:1]
        text += "&".join(
            number(distance) + (number(intensity) if letters[1] == "E" else "")
            for distance, intensity in shown
        )
    assert "".join(line[:-1].decode() for line in reply.lines[1:]) == text
