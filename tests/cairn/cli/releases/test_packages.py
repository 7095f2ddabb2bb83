"""Which packages a release installs, and to which machines it goes."""

from pathlib import Path
from textwrap import dedent

import pytest

from cairn.cli.releases.packages import packages_of
from cairn.cli.releases.push import targets
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from tests.cairn.cli.releases.tiny_wheel import CAIRN, tiny_wheel


def deployment(folder: Path, plugin: str = "supervisor") -> Deployment:
    file = folder / "rover.yaml"
    text = f"""
        cairn: 1
        robot: rover
        machines:
          base: {{address: 127.0.0.1}}
          arm: {{address: 198.51.100.7}}
        components: {{one: {{plugin: "{plugin}"}}}}
        """
    file.write_text(dedent(text), encoding="utf-8")
    return load_deployment(file)


def test_environment_depends_on_what_a_wheel_installs_and_not_on_its_file(tmp_path: Path) -> None:
    rover = deployment(tmp_path)

    def packages(name: str, code: str = CAIRN) -> str:
        found = packages_of(rover, [tiny_wheel(tmp_path / name, code)], tmp_path)
        assert found.names() == ["cairn_robotics==9.0"]
        return found.digest

    first = packages("first")
    assert packages("built_later") == first
    assert packages("changed", CAIRN + "# changed") != first


def test_plugin_without_a_package_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lonely = "from cairn import Component\n\nclass Lonely(Component):\n    pass\n"
    (tmp_path / "lonely_plugin.py").write_text(lonely)
    monkeypatch.syspath_prepend(tmp_path)
    rover = deployment(tmp_path, "lonely_plugin:Lonely")

    with pytest.raises(CairnError, match="lonely_plugin:Lonely is of no installed package"):
        packages_of(rover, [tiny_wheel(tmp_path)], tmp_path)


def test_release_goes_to_all_machines_but_this_computer(tmp_path: Path) -> None:
    rover = deployment(tmp_path)

    (arm,) = targets(rover, [], "", "", None)
    (named,) = targets(rover, ["base"], "pi@rover.local", "~/rover", None)

    assert (arm.label, arm.host.destination, arm.folder) == (
        "arm", "198.51.100.7", "/srv/cairn/rover",
    )  # fmt: skip
    assert (named.label, named.host.destination, named.folder) == (
        "base", "pi@rover.local", "~/rover",
    )  # fmt: skip
    with pytest.raises(CairnError, match=r"there is no machine elbow; .* base, arm"):
        list(targets(rover, ["elbow"], "", "", None))
    with pytest.raises(CairnError, match="not a destination"):
        list(targets(rover, ["base"], "-oProxyCommand=true", "", None))
