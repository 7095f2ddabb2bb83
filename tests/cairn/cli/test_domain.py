"""One rule for the domain: what is given, else `ROS_DOMAIN_ID`, else 0; everywhere the same."""

from pathlib import Path

import pytest

from cairn import CairnError
from cairn.bus.endpoints import default_domain
from cairn.client import connect
from cairn.deployment.load import load_deployment, read_names
from tests.commands import Answer, cairn

TEXT = "cairn: 1\ncomponents: {talker: {plugin: test_talker}}\n"


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", str(tmp_path / "none"))
    file = tmp_path / "robot.yaml"
    file.write_text(TEXT)
    return file


def commands(file: Path, *options: str) -> list[Answer]:
    recording = str(file.parent / "recording.mcap")
    return [cairn("ps", *options), cairn("record", "--output", recording, *options)]


@pytest.mark.parametrize(
    ("variable", "domain"), [("", 0), (" ", 0), ("0", 0), (" 7 ", 7), ("232", 232)]
)
def test_variable_is_the_domain_of_deployment_client_and_commands(
    file: Path, variable: str, domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", variable)

    assert default_domain() == load_deployment(file).domain == read_names(file).domain == domain
    with pytest.raises(CairnError, match=f"/domain-{domain}.sock"):
        connect()
    assert all(f"/domain-{domain}.sock" in answer.err for answer in commands(file))


@pytest.mark.parametrize("variable", ["233", "-1", "+3", "1_0", "0x3", "one"])
def test_variable_that_is_not_a_domain_is_an_error_everywhere(
    file: Path, variable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", variable)

    for answer in (*commands(file), cairn("check", str(file))):
        assert answer.code != 0
        assert "ROS_DOMAIN_ID" in answer.err
        assert f"'{variable}' is not a domain; set it to a number from 0 to 232" in " ".join(
            answer.err.split()
        )
    with pytest.raises(CairnError, match="ROS_DOMAIN_ID"):
        connect()


def test_domain_that_is_given_has_priority_over_the_variable(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")

    assert load_deployment(file, sets=["domain=4"]).domain == 4
    assert all("/domain-4.sock" in answer.err for answer in commands(file, "--domain", "4"))
    with pytest.raises(CairnError, match=r"/domain-4\.sock"):
        connect(domain=4)
    assert "is not a domain" in cairn("ps", "--domain", "233").err
