"""What an emulated sensor measures, when, and how it is sent."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.hokuyo.emulated_mirror import CLOCK_MS
from cairn.components.hokuyo.emulated_record import SentScan
from cairn.components.hokuyo.emulated_scene import ECHOES, NO_ECHO, Still, Turn
from cairn.components.hokuyo.emulated_scip import EmulatedScip
from cairn.components.hokuyo.replies import Reply, ReplySplitter
from cairn.components.hokuyo.scip_text import decode_number


def _scans(sensor: EmulatedScip, command: str, count: int) -> list[Reply]:
    """The replies with the first scans of a stream."""
    sensor.receive(command.encode() + b"\n", 0.0)
    frames: list[bytes] = []
    while len(frames) < count:
        frames += sensor.tick(sensor.due())
    return ReplySplitter().feed(b"".join(frames[:count]))


def _time_ms(reply: Reply) -> int:
    return decode_number(reply.lines[0][:4])


def test_scans_come_as_often_as_the_mirror_turns() -> None:
    sensor = EmulatedScip("UTM-30LX")
    sensor.receive(b"MD0000108001000\n", 10.01)
    times = []
    for _ in range(3):
        times.append(sensor.due())
        assert len(sensor.tick(times[-1])) == 1
        assert sensor.tick(times[-1]) == []
    assert np.diff(times) == pytest.approx([0.025, 0.025])
    # A turn that begins after the command, and is told when its last step has been measured.
    assert times[0] == pytest.approx(10.025 + 0.025 * 1081 / 1440)


def test_remaining_scans_are_counted_down_and_the_laser_goes_out() -> None:
    sensor = EmulatedScip("UTM-30LX")
    replies = _scans(sensor, "MD0000108001203", 3)
    assert [reply.echo for reply in replies] == [
        f"MD00001080012{n:02d}".encode() for n in (2, 1, 0)
    ]
    assert [reply.code() for reply in replies] == ["99"] * 3
    assert np.diff([_time_ms(reply) for reply in replies]).tolist() == [75, 75]
    assert not sensor.sensor.laser
    assert sensor.due() == float("inf")


def test_a_stream_without_end_counts_nothing_and_keeps_its_string() -> None:
    replies = _scans(EmulatedScip(), "MD0000108001000;mine", 3)
    assert {reply.echo for reply in replies} == {b"MD0000108001000;mine"}


def test_other_commands_are_answered_between_scans() -> None:
    sensor = EmulatedScip()
    sensor.receive(b"MD0000108001000\n", 0.0)
    assert sensor.receive(b"II\n", 1.0)[0].startswith(b"II\n00P\n")
    assert sensor.tick(1.0)[0].startswith(b"MD")
    assert sensor.receive(b"QT\n", 1.0) == [b"QT\n00P\n\n"]
    assert sensor.tick(2.0) == []


def test_the_clock_wraps_drifts_and_begins_anew() -> None:
    sensor = EmulatedScip("UTM-30LX", clock_start_ms=CLOCK_MS - 40, drift_ppm=100.0)
    times = [_time_ms(reply) for reply in _scans(sensor, "MD0000000001000", 3)]
    assert times == [CLOCK_MS - 40, CLOCK_MS - 15, 10]
    sensor.receive(b"QT\nTM0\n", 10_000.0)
    (answer,) = sensor.receive(b"TM1\n", 10_000.0)
    assert decode_number(answer.split(b"\n")[2][:4]) == 10_000_000 + 1000 - 40
    sensor.receive(b"TM2\nRS\nTM0\n", 10_000.0)
    (answer,) = sensor.receive(b"TM1\n", 10_000.03)
    assert decode_number(answer.split(b"\n")[2][:4]) == CLOCK_MS - 40 + 30


def test_what_is_measured_while_the_line_is_busy_is_not_sent_later() -> None:
    sensor = EmulatedScip("UTM-30LX")
    sensor.receive(b"MD0000000001000\n", 0.0)
    frames = sensor.tick(5.0)
    times = [decode_number(frame.split(b"\n")[2][:4]) for frame in frames]
    assert 0 < len(times) <= 5
    assert min(times) > 4850


def test_a_single_scan_waits_for_the_first_turn_of_the_laser() -> None:
    sensor = EmulatedScip("UST-10LX")
    assert sensor.receive(b"BM\nGD0000108000\n", 0.01) == [b"BM\n00P\n\n"]
    (frame,) = sensor.tick(sensor.due())
    assert frame.startswith(b"GD0000108000\n00P\n")
    assert sensor.receive(b"GE0000108000\n", 1.0)[0].startswith(b"GE0000108000\n00P\n")


def test_statuses_come_in_place_of_scans() -> None:
    sensor = EmulatedScip("UTM-30LX")
    sensor.trouble("0M", 2)
    assert [reply.code() for reply in _scans(sensor, "MD0000108001000", 4)] == [
        "0M", "0M", "99", "99",
    ]  # fmt: skip
    sensor.trouble("21")
    sensor.trouble("98")
    sensor.trouble("55")
    assert [reply.code() for reply in _scans(sensor, "MD0000108001000", 3)] == ["21", "98", "55"]
    assert sensor.due() == float("inf")
    assert b"STAT:Sensor malfunction No.55" in sensor.receive(b"II\n", 1.0)[0]
    assert sensor.receive(b"GD0000108001\n", 1.0) == [b"GD0000108001\n55Z\n\n"]


@pytest.mark.parametrize("model", ["UTM-30LX", "UST-10LX"])
def test_only_on_ethernet_does_a_sensor_notice_that_its_client_is_gone(model: str) -> None:
    sensor = EmulatedScip(model)
    sensor.receive(b"MD0000108001000\n", 0.0)
    sensor.disconnected(1.0)
    assert bool(sensor.tick(1.0)) == (model == "UTM-30LX")


def test_no_two_scans_are_alike_and_a_seed_repeats_them() -> None:
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
def test_any_values_are_sent_as_the_specification_says(
    steps: list[list[tuple[int, int]]], letters: str, cluster: int
) -> None:
    """Against a plain rendering of the text, character by character."""
    distances = np.full((1081, ECHOES), NO_ECHO, np.int32)
    intensities = distances.copy()
    distances[:, 0] = intensities[:, 0] = 0
    for step, echoes in enumerate(steps):
        distances[step, : len(echoes)] = [one for one, _ in echoes]
        intensities[step, : len(echoes)] = [one for _, one in echoes]
    sensor = EmulatedScip("UTM-30LX-EW", scene=Still(Turn(distances, intensities)))
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
