"""The panel Proposals in Chromium: what a real object finder proposes is accepted and rejected."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

import cairn.client
from cairn.components.object_recognizer.hypotheses import Hypothesis, ObjectSighting
from cairn.components.object_recognizer.proposals import Proposals
from cairn.deployment.shipped import FOLDER, deployment_file
from cairn.testing.launching import launching
from cairn.vision.object_model import ObjectModel
from cairn.vision.teaching import make_view
from cairn.visual_map.object_models import read_models
from tests.browser.conftest import OpenTab, RunningRobot, console, with_map
from tests.cairn.visual_map.views import texture


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    return Path(shutil.copy(FOLDER / "maps" / "room.cairn", tmp_path / "map.cairn"))


@pytest.fixture
def proposing(tmp_path: Path, map_file: Path) -> Iterator[RunningRobot]:
    """A simulated robot that has found three things before it was started."""
    proposals = Proposals(tmp_path / "proposals.cairn")
    for seed, (x, y) in enumerate(((4.0, 7.0), (9.0, 5.0), (2.5, 0.0)), start=41):
        view = make_view(texture(seed, 400, 300))
        hypothesis = Hypothesis(ObjectModel(seed, "", (0.4, 0.3), (view,)))
        hypothesis.add(10**9, ObjectSighting(x, y, 0.04**2 * np.eye(2), (x - 1, y, 0.0)), 20.0)
        proposals.add(hypothesis)
    proposals.save()
    parameters = {"map_file": str(map_file), "proposals_file": str(proposals.path)}
    finder = {"plugin": "object_finder", "parameters": parameters}
    overlay = tmp_path / "finder.yaml"
    cameras = ["left_image", "right_image", "left_info", "right_info"]  # it needs none here
    overlay.write_text(
        yaml.safe_dump({"components": {"object_finder": finder}, "external_topics": cameras})
    )
    with launching(tmp_path) as launch:
        run = launch(deployment_file("sim"), "--overlay", str(overlay))
        run.await_line("child active: vision_supervisor")
        with (
            cairn.client.connect(run.endpoint) as client,
            console("--connect", run.endpoint) as url,
        ):
            yield RunningRobot(client, run.endpoint, url, {})


def test_proposals_are_accepted_by_keyboard_and_rejected(
    proposing: RunningRobot, open_tab: OpenTab, map_file: Path
) -> None:
    tab = open_tab(proposing.url)
    page = tab.page
    tab.show("Proposals")
    things = page.get_by_role("list", name="Proposals").get_by_role("listitem")
    picture = page.get_by_role("img", name="Picture of found 1")
    picture.wait_for()
    assert things.count() == 3
    page.wait_for_function("() => document.querySelector('.proposal img').naturalWidth > 100")
    assert page.get_by_role("button", name="Accept").first.is_disabled()
    page.get_by_text("Changes need the lease").wait_for()
    with_map(tab)
    tab.picture("proposals")
    tab.take_lease()

    field = page.get_by_label("Name of found 1")
    field.fill("object_3")
    field.press("Enter")
    page.get_by_text("has an object 'object_3' already").wait_for()
    field.fill("poster")
    field.press("Enter")
    picture.wait_for(state="hidden")
    page.get_by_text("poster is object").wait_for()

    page.get_by_role("button", name="Reject").first.click()
    page.get_by_text("found 2 is rejected").wait_for()
    page.get_by_role("button", name="Accept").click()
    page.get_by_text("No proposals").wait_for()
    names = {model.name for model in read_models(map_file).models}
    assert {"poster", "found 3"} <= names
    assert "found 2" not in names
