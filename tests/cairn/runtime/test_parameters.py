"""Parameters are described for the operator, and change all or none, also at run time."""

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, ValidationError, model_validator

from cairn import CairnError, Config, ParameterRejected, ReadPath
from cairn.runtime.parameters import ParameterDescription, describe_parameters, with_changes
from cairn.testing.lockstep import ComponentHarness
from tests.cairn.runtime.base import Base, BaseConfig, Limits
from tests.wording import assert_words, words_in_order


class Filter(Config):
    sigma: float = Field(0.1, gt=0, le=1, description="Noise of a beam [m].")


class Localizer(Config):
    particles: int = Field(500, ge=10, le=200_000, description="Number of particles [1].")
    mode: Literal["paper", "improved"] = Field("paper", description="Which equations.")
    low: float = Field(0.0, description="Lower limit [m].")
    high: float | None = Field(None, gt=0, description="Upper limit [m], or none.")
    filter: Filter = Field(default_factory=Filter, description="Sensor model.")
    gain: Annotated[int, Field(ge=0, le=255)] | None = Field(None, description="Gain [1].")
    map: ReadPath | None = Field(None, description="File of the map.")
    beams: tuple[float, ...] = Field((), description="Bearings [rad].")

    @model_validator(mode="after")
    def _ordered(self) -> "Localizer":
        if self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low} must be less than high {self.high}")
        return self


def test_parameters_are_described_with_type_value_and_bounds() -> None:
    assert describe_parameters(Localizer(particles=20)) == [
        ParameterDescription(
            "particles", 20, "int", "Number of particles [1].", ">= 10, <= 200000", (10, 200_000)
        ),
        ParameterDescription(
            "mode", "paper", "Literal['paper', 'improved']", "Which equations.", ""
        ),
        ParameterDescription("low", 0.0, "float", "Lower limit [m].", ""),
        ParameterDescription(
            "high", None, "float | None", "Upper limit [m], or none.", "> 0", (0, None)
        ),
        ParameterDescription(
            "filter.sigma", 0.1, "float", "Noise of a beam [m].", "> 0, <= 1", (0, 1)
        ),
        ParameterDescription("gain", None, "int | None", "Gain [1].", ">= 0, <= 255", (0, 255)),
        ParameterDescription("map", None, "Path | None", "File of the map.", ""),
        ParameterDescription("beams", (), "tuple[float, ...]", "Bearings [rad].", ""),
    ]


def test_changes_return_a_new_configuration() -> None:
    before = Localizer(particles=20)

    after = with_changes(before, {"filter.sigma": 0.5, "high": 3})

    assert after == Localizer(particles=20, high=3.0, filter=Filter(sigma=0.5))
    assert before == Localizer(particles=20)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"high": 5.0, "particles": 5}, ("particles = 5", ">= 10, <= 200000")),
        ({"filter.sigma": 2}, ("filter.sigma = 2", "> 0, <= 1")),
        ({"low": float("nan")}, ("low = nan", "finite")),
        ({"low": True}, ("low = 'true'", "number")),
        ({"particles": True}, ("particles = 'true'", "integer")),
        ({"low": 4.0, "high": 3.0}, ("low = 4.0, high = 3.0", "low 4.0", "high 3.0")),
        ({"partcles": 5}, ("partcles", "particles?")),
        ({"zzz": 5}, ("zzz", "particles, mode, low, high, filter.sigma, gain, map, beams")),
        ({"filter": {"sigma": 0.5}}, ("filter", "filter.sigma")),
        (
            {"particles": 5, "mode": "best"},
            ("particles = 5", ">= 10, <= 200000", "mode = 'best'", "'paper'", "'improved'"),
        ),
    ],
)
def test_rejection_names_parameter_value_and_bound(
    changes: dict[str, Any], words: tuple[str, ...]
) -> None:
    with pytest.raises(ParameterRejected) as caught:
        with_changes(Localizer(), changes)

    assert_words(str(caught.value), *words)


def test_rejection_does_not_repeat_long_names_and_values() -> None:
    for changes in ({"n" * 100_000: 1}, {"mode": "m" * 100_000}, {"beams": ["x"] * 100_000}):
        with pytest.raises(ParameterRejected) as caught:
            with_changes(Localizer(), changes)
        assert len(str(caught.value)) < 2000


def test_configuration_is_immutable_and_rejects_unknown_names() -> None:
    config = Localizer()

    with pytest.raises(ValidationError):
        config.particles = 30  # type: ignore[misc]
    with pytest.raises(ValidationError):
        Localizer(partcles=30)  # type: ignore[call-arg]


def test_live_parameters_change_all_or_none() -> None:
    harness = ComponentHarness(Base, {"gain": 0.25})

    harness.request("set_parameters", **{"gain": 0.75, "limits.high": 2})
    assert harness.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    with pytest.raises(ParameterRejected, match=r"limits\.high = 9 rejected"):
        harness.request("set_parameters", **{"gain": 0.1, "limits.high": 9})

    assert harness.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    assert {one["name"]: one["value"] for one in harness.request("parameters")} == {
        "gain": 0.75, "limits.high": 2.0, "log_level": "info", "service_introspection": "off"
    }  # fmt: skip


def test_component_that_rejects_parameters_keeps_the_old_ones() -> None:
    class Picky(Base):
        def on_parameters(self, new: Config) -> None:
            assert isinstance(new, BaseConfig)
            if new.gain < self.config.gain:
                raise ParameterRejected("gain may only grow while it drives")
            if new.gain > 0.9:
                raise ZeroDivisionError("broken gain")

    harness = ComponentHarness(Picky)
    with pytest.raises(ParameterRejected, match=r"^gain may only grow while it drives$"):
        harness.request("set_parameters", gain=0.1)
    with pytest.raises(
        CairnError,
        match=words_in_order("component", "set_parameters", "ZeroDivisionError: broken gain"),
    ):
        harness.request("set_parameters", gain=1.0)

    assert harness.component.config.gain == 0.5
    assert harness.state == "active"


def test_invalid_parameters_are_reported_before_construction() -> None:
    with pytest.raises(CairnError, match=r"base: invalid parameters: (.|\n)*gain"):
        ComponentHarness(Base, {"gain": 7}, name="base")


def test_log_level_is_a_parameter_of_every_component(caplog: pytest.LogCaptureFixture) -> None:
    harness = ComponentHarness(Base)
    harness.component.log.debug("hidden")
    harness.request("set_parameters", log_level="debug")
    harness.component.log.debug("shown")
    with pytest.raises(ParameterRejected) as rejected:
        harness.request("set_parameters", log_level="loud", gain=0.7)

    assert "shown" in caplog.messages
    assert "hidden" not in caplog.messages
    assert_words(str(rejected.value), "log_level", "'loud'", "debug, info, warning, error")
    assert harness.component.config.gain == 0.5
    assert harness.request("parameters")[-2]["value"] == "debug"


def test_configuration_may_not_have_a_parameter_of_that_name() -> None:
    class OwnLevel(Config):
        log_level: str = ""

    class Loud(Base):
        config: OwnLevel  # type: ignore[assignment]

    with pytest.raises(CairnError, match="log_level already"):
        Loud.config_class()
