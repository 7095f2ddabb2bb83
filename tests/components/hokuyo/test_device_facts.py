"""What sensors say of themselves is read, with the oddities of real ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from cairn.components.hokuyo.device_facts import keyed, measuring
from cairn.components.hokuyo.replies import ReplySplitter
from cairn.components.hokuyo.scip_text import ScipError, check_sum

CAPTURED = Path(__file__).parents[2] / "data" / "hokuyo" / "scip20_VV_urg04lx-ug01.bin"
# Lines of a real URG-04LX, sums included.
PP = [
    b"DMIN:20;4",
    b"DMAX:5600;_",
    b"ARES:1024;\\",
    b"AMIN:44;7",
    b"AMAX:725;o",
    b"AFRT:384;6",
    b"SCAN:600;e",
]


def test_a_captured_version() -> None:
    (reply,) = ReplySplitter().feed(CAPTURED.read_bytes())

    assert keyed(reply.lines) == {
        "VEND": "Hokuyo Automatic Co.,Ltd.",
        "PROD": "SOKUIKI Sensor URG-04LX-UG01(Simple-URG)",
        "FIRM": "3.4.03(17/Dec./2012)",
        "PROT": "SCIP 2.0",
        "SERI": "H1510998",
    }


def test_how_a_real_sensor_measures() -> None:
    found = measuring(keyed(PP))

    assert (found.least_mm, found.most_mm, found.turn_steps) == (20, 5600, 1024)
    assert (found.first, found.front, found.last) == (44, 384, 725)
    assert found.turn_s == 0.1


def test_lines_with_unknown_keys_are_left_alone() -> None:
    line = b"PROT:SCIP 2.2"
    assert measuring(keyed([*PP, line + b";" + check_sum(line)])) == measuring(keyed(PP))


def test_sums_with_the_semicolon_and_up_to_an_arrow_are_taken() -> None:
    with_it = b"STAT:Sensor works well.;"
    arrow = b"MESM:Measuring by Normal Mode"
    lines = [with_it + check_sum(with_it), arrow + b"<-Ignored;" + check_sum(arrow)]

    assert keyed(lines)["STAT"] == "Sensor works well."
    assert keyed(lines)["MESM"] == "Measuring by Normal Mode<-Ignored"


def test_a_wrong_sum_is_refused() -> None:
    with pytest.raises(ScipError, match="DMIN:20;5"):
        keyed([b"DMIN:20;5"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"AMAX": None}, "has no AMAX"),
        ({"SCAN": "fast"}, "number"),
        ({"AMIN": "800"}, "cannot be"),
        ({"ARES": "0"}, "cannot be"),
        ({"SCAN": "0"}, "cannot be"),
    ],
)
def test_facts_that_cannot_be_are_refused(change: dict[str, str | None], message: str) -> None:
    values = {key: value for key, value in (keyed(PP) | change).items() if value is not None}

    with pytest.raises(ScipError, match=message):
        measuring(values)
