"""Parameters change while a component runs, or it says why not."""

import pytest

from cairn import CairnError, Config, ParameterRejected
from tests.cairn.runtime.base import Base, BaseConfig, Limits
from tests.cairn.runtime.running import Lockstep


def test_parameters_change_while_it_runs_all_or_none(lockstep: Lockstep) -> None:
    part = lockstep.add(Base, parameters={"gain": 0.25})
    part.activate()

    part.ask("set_parameters", **{"gain": 0.75, "limits.high": 2})
    assert part.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    with pytest.raises(ParameterRejected, match=r"limits\.high = 9 refused"):
        part.ask("set_parameters", **{"gain": 0.1, "limits.high": 9})

    assert part.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    assert {one["name"]: one["value"] for one in part.ask("parameters")} == {
        "gain": 0.75, "limits.high": 2.0
    }  # fmt: skip


def test_a_component_may_refuse_parameters_or_fail_at_it_and_keeps_the_old(
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


def test_refused_parameters_are_named_before_it_exists(lockstep: Lockstep) -> None:
    with pytest.raises(CairnError, match=r"base: parameters refused: (.|\n)*gain"):
        lockstep.add(Base, name="base", parameters={"gain": 7})
