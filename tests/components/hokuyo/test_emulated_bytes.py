"""Given the same values, the emulated sensor sends the very bytes that real ones have sent."""

from pathlib import Path

import numpy as np
import pytest

from cairn.components.hokuyo.emulated_models import MODELS
from cairn.components.hokuyo.emulated_scene import Still
from cairn.components.hokuyo.emulated_scip import EmulatedScip
from cairn.components.hokuyo.scip_text import check_sum, decode_number

DATA = Path(__file__).parents[2] / "data" / "hokuyo"


def _values(frame: bytes) -> list[int]:
    """Its distances, read one character after the other, as the specification describes."""
    text = b"".join(line[:-1] for line in frame.split(b"\n")[3:-2])
    return [
        sum((text[at + place] - 0x30) << 6 * (2 - place) for place in range(3))
        for at in range(0, len(text), 3)
    ]


def test_a_captured_scan_comes_out_as_it_was_captured() -> None:
    frame = (DATA / "scip20_GD_urg04lx-ug01_A.bin").read_bytes()
    distances = np.zeros(769, np.int32)
    distances[44:726] = _values(frame)
    sensor = EmulatedScip(
        "URG-04LX-UG01", scene=Still.of(distances), clock_start_ms=decode_number(b"ZR3h")
    )
    assert sensor.receive(b"BM\nGD0044072501\n", 0.0) == [b"BM\n00P\n\n"]
    assert sensor.tick(sensor.due()) == [frame]


def test_a_captured_version_comes_out_as_it_was_captured() -> None:
    frame = (DATA / "scip20_VV_urg04lx-ug01.bin").read_bytes()
    sensor = EmulatedScip("URG-04LX-UG01", serial_number="H1510998")
    assert sensor.receive(b"VV\n", 0.0) == [frame]


def test_parameters_are_those_that_hokuyo_publishes() -> None:
    # urgnetwork, "Obtain status information"
    assert EmulatedScip("URG-04LX").receive(b"PP\n", 0.0) == [
        b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\n"
        b"ARES:1024;\\\nAMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n"
    ]


def test_the_state_is_told_in_the_words_that_hokuyo_publishes() -> None:
    # The same page: 0x081615 ms after power-on, on RS-232.
    sensor = EmulatedScip("URG-04LX", rs232_baud=19200, clock_start_ms=0x081615)
    assert sensor.receive(b"II\n", 0.0) == [
        b"II\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nLASR:OFF;7\n"
        b"SCSP:Initial(600[rpm])<-Default setting by user;A\nMESM:IDLE;:\n"
        b"SBPS:19200[bps]<-Default setting by user;A\nTIME:081615;N\n"
        b"STAT:Sensor works well.;8\n\n"
    ]


def test_some_leave_what_stands_behind_arrows_out_of_check_sums() -> None:
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
def test_a_message_is_as_long_as_it_should_be(model: str, command: str, length: int) -> None:
    sensor = EmulatedScip(model, scene=Still.of(np.full(MODELS[model].steps, 1000, np.int32)))
    assert sensor.receive(command.encode() + b"\n", 0.0) == [command.encode() + b"\n00P\n\n"]
    (frame,) = sensor.tick(sensor.due())
    assert len(frame) == length
    assert frame.endswith(b"\n\n")
    assert all(len(line) == 65 for line in frame.split(b"\n")[3:-3])


def test_text_that_ends_with_a_full_line_has_no_empty_one_behind_it() -> None:
    sensor = EmulatedScip("UTM-30LX", scene=Still.of(np.full(1081, 1000, np.int32)))
    sensor.receive(b"MD0000006301000\n", 0.0)  # 64 values of 3 characters: 3 lines of 64
    (frame,) = sensor.tick(sensor.due())
    assert [len(line) for line in frame.split(b"\n")] == [15, 3, 5, 65, 65, 65, 0, 0]
