"""The recorded faults can be applied to the current code."""

from cairn_lab.mutation.faults import problems, read_faults


def test_each_recorded_fault_can_be_applied() -> None:
    assert list(problems(read_faults())) == []
