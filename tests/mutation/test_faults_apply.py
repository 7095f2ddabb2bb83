"""The recorded faults fit the code of today."""

from tests.mutation.faults import problems, read_faults


def test_each_fault_can_be_applied_to_the_code() -> None:
    assert list(problems(read_faults())) == []
