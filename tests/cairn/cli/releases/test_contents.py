"""What a release holds: the merged deployment, and copies of the files that its components read."""

from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest

from cairn.cli.releases.contents import release_contents
from cairn.deployment.load import load_deployment
from cairn.errors import CairnError

Write = Callable[[str, str], Path]
WALKER = "tests.cairn.rerun.walkers:Walker"
ROVER = f"""
    cairn: 1
    robot: rover
    machines:
      base: {{address: 192.0.2.1}}
      arm: {{address: 192.0.2.2}}
    settings: {{words: "${{here}}/words/first.yaml", speed: 1.0}}
    components:
      walker:
        plugin: {WALKER}
        parameters: {{names: "${{words}}", step: "${{speed}}", state_file: "${{here}}/state"}}
      hand:
        plugin: {WALKER}
        machine: arm
        parameters: {{names: /nowhere/hand.txt}}
    """


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text), encoding="utf-8")
        return path

    return write_file


def test_release_has_the_files_of_its_machine_and_the_deployment_that_names_them(
    write: Write, tmp_path: Path
) -> None:
    file = write("home/rover.yaml", ROVER)
    write("home/words/first.yaml", "image: ../more/second.txt")
    write("home/more/second.txt", "two")
    write("home/state", "what the walker writes")
    lab = write("elsewhere/lab.yaml", 'settings: {words: "${here}/lab.txt"}')
    write("elsewhere/lab.txt", "lab")

    _, plain = release_contents(file, [], ["speed=2.0"], "base")
    _, changed = release_contents(file, [lab], [], "base")
    _, arm = release_contents(file, [], [], "arm")

    root = f"files{tmp_path}"
    assert set(plain.files) == {f"{root}/home/words/first.yaml", f"{root}/home/more/second.txt"}
    assert set(changed.files) == {f"{root}/elsewhere/lab.txt"}
    assert arm.files == {}
    assert arm.notes == ("hand.names: /nowhere/hand.txt is not on this computer, and not copied",)
    assert plain.name == "rover.yaml"
    there = load_deployment(write("there/rover.yaml", plain.text))
    parameters = there.member("walker").spec.parameters
    copy = tmp_path / "there" / f"{root}/home/words/first.yaml"
    assert parameters["names"] == str(copy)
    assert parameters["step"] == 2.0
    assert there.machines.keys() == {"base", "arm"}


def test_digest_depends_on_the_contents_alone(write: Write) -> None:
    file = write("rover.yaml", ROVER)
    words = write("words/first.yaml", "one")

    first = release_contents(file, [], [], "base")[1].digest
    words.touch()
    again = release_contents(file, [], [], "base")[1].digest
    words.write_text("two", encoding="utf-8")
    changed = release_contents(file, [], [], "base")[1].digest

    assert first == again != changed


def test_private_key_is_never_copied(write: Write) -> None:
    file = write("rover.yaml", ROVER)
    write("words/first.yaml", "key: link.key")
    write("words/link.key", "-----BEGIN PRIVATE KEY-----\nMC4CAQ\n-----END PRIVATE KEY-----\n")

    with pytest.raises(CairnError, match=r"walker\.names: .*link\.key has a private key"):
        release_contents(file, [], [], "base")


def test_parameters_given_as_one_setting_are_refused(write: Write) -> None:
    file = write(
        "rover.yaml",
        f"""
        cairn: 1
        settings: {{all: {{names: "${{here}}/words.txt"}}}}
        components: {{walker: {{plugin: "{WALKER}", parameters: "${{all}}"}}}}
        """,
    )
    write("words.txt", "one")

    with pytest.raises(CairnError, match=r"walker\.names: parameters refers to a setting"):
        release_contents(file, [], [])
