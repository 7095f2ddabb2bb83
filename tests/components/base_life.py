"""The part of the base contract that is not judged by the clock, for drivers of emulated bases."""

from cairn.testing.driver_contract import (
    EndContract,
    LifeCycleContract,
    ParametersContract,
    StopContract,
    UnplugContract,
)
from tests.patience import LIMIT_S


class BaseLifeContract(
    EndContract, StopContract, UnplugContract, LifeCycleContract, ParametersContract
):
    """Its limits suit a computer with other work; the rest of the contract runs in real time."""

    return_limit_s = LIMIT_S
    report_limit_s = LIMIT_S
    cycles = 6
