"""Parameters change while a component runs, or are rejected with a reason."""

import pytest

from cairn import CairnError, Config, ParameterRejected
from tests.cairn.runtime.base import Base, BaseConfig, Limits
from tests.cairn.runtime.running import Lockstep


def test_live_parameters_change_all_or_none(lockstep: Lockstep) -> None:
    part = lockstep.add(Base, parameters={"gain": 0.25})
    part.activate()

    part.ask("set_parameters", **{"gain": 0.75, "limits.high": 2})
    assert part.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    with pytest.raises(ParameterRejected, match=r"limits\.high = 9 rejected"):
        part.ask("set_parameters", **{"gain": 0.1, "limits.high": 9})

    assert part.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    assert {one["name"]: one["value"] for one in part.ask("parameters")} == {
        "gain": 0.75, "limits.high": 2.0
    }  # fmt: skip


def test_component_that_rejects_parameters_keeps_the_old_ones(
    lockstep: Lockstep,
) -> None:
    class Picky(Base):
        def on_parameters(self, new: Config) -> None:
            assert isinstance(new, BaseConfig)
            if new.gain < self.config.gain:
                raise ParameterRejected("gain may only grow while it drives")
            if new.gain > 0.9:
                raise ZeroDivisionError("dear me")

    part = lockstep.add(Picky)
    part.activate()
    with pytest.raises(ParameterRejected, match=r"^gain may only grow while it drives$"):
        part.ask("set_parameters", gain=0.1)
    with pytest.raises(CairnError, match="part: set_parameters failed: ZeroDivisionError: dear me"):
        part.ask("set_parameters", gain=1.0)

    assert part.component.config.gain == 0.5
    assert part.state == "active"


def test_invalid_parameters_are_reported_before_construction(lockstep: Lockstep) -> None:
    with pytest.raises(CairnError, match=r"base: invalid parameters: (.|\n)*gain"):
        lockstep.add(Base, name="base", parameters={"gain": 7})
