"""The examples in docs/reference/deployment.md match the product."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from cairn.deployment.bus_settings import BusSettings
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.deployment.problems import DeploymentError
from cairn.runtime.child_spec import ChildSpec, Fallback, Storage, Supervision

Write = Callable[..., Path]
PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "deployment.md").read_text(
    encoding="utf-8"
)


@pytest.fixture(autouse=True)
def files(write: Write) -> None:
    for name, text in re.findall(r'```yaml title="(\S+)"\n(.*?)```', PAGE, re.DOTALL):
        write(text, name)


def test_first_example_matches_the_page() -> None:
    deployment = load_deployment(Path("deploy/robot.yaml"))

    assert [(one.name, one.parent) for one in deployment.members()] == [
        ("mobile", None),
        ("scanner", "mobile"),
        ("base", "mobile"),
        ("localizer", "mobile"),
    ]
    assert deployment.member("scanner").spec.parameters["rate"] == 10.0


def commands() -> list[list[str]]:
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    return [shlex.split(line) for line in block.splitlines()]


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_commands_on_the_page_give_valid_deployments(words: list[str]) -> None:
    given = list(zip(words[3::2], words[4::2], strict=True))

    deployment = load_deployment(
        Path(words[2]),
        [Path(value) for option, value in given if option == "--overlay"],
        [value for option, value in given if option == "--set"],
    )

    assert Deployment.model_validate_json(deployment.model_dump_json()) == deployment


def test_problems_match_those_on_the_page() -> None:
    (expected,) = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)

    with pytest.raises(DeploymentError) as caught:
        load_deployment(Path("wrong.yaml"))

    assert str(caught.value) == expected.strip()


@pytest.mark.parametrize(
    ("keys", "prefix"),
    [
        (Deployment.model_fields.keys() - {"bus", "storage"}, ""),
        (BusSettings.model_fields.keys(), "bus."),
        (Storage.model_fields.keys(), "storage."),
        (ChildSpec.model_fields.keys() - {"fallback", "supervision"}, ""),
        (Fallback.model_fields.keys(), "fallback."),
        (Supervision.model_fields.keys(), "supervision."),
    ],
)
def test_every_key_is_on_the_page(keys: set[str], prefix: str) -> None:
    described = set(re.findall(r"^\| `([a-z_.]+)` \|", PAGE, re.MULTILINE))

    assert {f"{prefix}{name}" for name in keys} <= described
