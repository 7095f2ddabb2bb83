"""Tests of the component's zones: their file, the requests that change them, a full disk."""

import json
from pathlib import Path
from typing import Any

import pytest

from cairn import CairnError
from cairn.components.map_builder.component import MapBuilder
from cairn.planar.map_file import write_map
from cairn.planar.zones import feature_of, read_zones, zone_of
from cairn.schemas.cairn_nav_msgs import Zones
from cairn.testing.lockstep import ComponentHarness
from tests.components.localizer.room import room
from tests.disk import room_for
from tests.wording import assert_words
from tests.zone_features import area, place

KITCHEN = place("kitchen", 7.5, 5.0)
STAIRS = area("keepout", (0, 0, 2, 2), "stairs")


def named(name: str, feature: dict[str, Any] = KITCHEN) -> dict[str, Any]:
    return {**feature, "properties": {**feature["properties"], "name": name}}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_map(tmp_path / "map.yaml", room())
    return tmp_path / "map.zones.geojson"


def builder(file: Path | None, **parameters: Any) -> ComponentHarness[MapBuilder]:
    if file is not None:
        parameters |= {"zones_file": str(file), "grid_file": str(file.parent / "map.yaml")}
    return ComponentHarness(MapBuilder, parameters, start_s=1000.0)


def published(it: ComponentHarness[MapBuilder]) -> list[str]:
    message = it.take("zones")[-1]
    assert isinstance(message, Zones)
    return [zone.name for zone in message.zones]


def names_in(file: Path) -> list[str]:
    return [zone.name for zone in read_zones(file)]


def test_zones_of_the_file_are_published(file: Path) -> None:
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [KITCHEN, STAIRS]}))
    it = builder(file)
    assert published(it) == ["kitchen", "stairs"]


def test_map_without_a_file_has_no_zones_until_one_is_added(file: Path) -> None:
    it = builder(file)
    assert published(it) == []
    assert not file.exists()

    answer = it.request("add_zone", feature=KITCHEN)

    assert answer == {"version": 2, "zones": 1, "saved": True, "file": str(file)}
    assert published(it) == names_in(file) == ["kitchen"]


def test_zones_are_added_replaced_removed_and_listed(file: Path) -> None:
    it = builder(file)
    it.request("add_zone", feature=KITCHEN)
    it.request("add_zone", feature=STAIRS)
    it.request("add_zone", feature=named("canteen"), replace="kitchen")
    assert published(it) == names_in(file) == ["canteen", "stairs"]
    listed = it.request("zones")
    assert listed["features"] == [feature_of(zone_of(one)) for one in (named("canteen"), STAIRS)]
    assert listed["version"] == 4

    it.request("remove_zone", name="canteen")
    assert published(it) == names_in(file) == ["stairs"]
    it.request("set_zones", features=[])
    assert published(it) == names_in(file) == []


@pytest.mark.parametrize(
    ("verb", "arguments", "words"),
    [
        ("add_zone", {"feature": KITCHEN}, "kitchen"),
        ("add_zone", {"feature": KITCHEN, "replace": "dock"}, "'dock': no such zone"),
        ("add_zone", {"feature": {**STAIRS, "geometry": KITCHEN["geometry"]}}, "is a Polygon"),
        ("add_zone", {"feature": 3}, "must be an object"),
        ("remove_zone", {"name": "dock"}, "the zones are: kitchen"),
        ("remove_zone", {"name": ["kitchen"]}, "no such zone"),
        ("set_zones", {"features": KITCHEN}, "give a list"),
        ("set_zones", {"features": [STAIRS, STAIRS]}, "stairs"),
        ("set_zones", {}, "set_zones"),
    ],
)
def test_invalid_change_is_refused_and_changes_nothing(
    file: Path, verb: str, arguments: dict[str, Any], words: str
) -> None:
    it = builder(file)
    it.request("add_zone", feature=KITCHEN)
    content = file.read_bytes()
    it.take("zones")

    with pytest.raises(CairnError) as error:
        it.request(verb, **arguments)

    assert words in str(error.value)
    assert it.take("zones") == []
    assert file.read_bytes() == content


def test_restarted_map_builder_has_the_zones(file: Path) -> None:
    builder(file).request("add_zone", feature=STAIRS)
    assert published(builder(file)) == ["stairs"]


def test_damaged_file_is_an_error_of_the_start(file: Path) -> None:
    file.write_text('{"type": "FeatureCollection", "features": [{}]}')
    with pytest.raises(CairnError, match=f"{file}: feature 1"):
        builder(file)


@pytest.mark.parametrize("length", [0, 1, 200])
def test_truncated_file_is_set_aside_and_its_absence_stays_in_the_status(
    file: Path, length: int, caplog: pytest.LogCaptureFixture
) -> None:
    builder(file).request("add_zone", feature=STAIRS)
    truncated = file.read_bytes()[:length]
    file.write_bytes(truncated)
    kept = file.with_suffix(".damaged.geojson")

    for _ in range(2):  # also after a restart
        it = builder(file)
        assert published(it) == []
        reason = it.runtime.status().reason
        assert_words(reason, str(kept), "not in force", f"rename it to {file.name}")
    assert kept.read_bytes() == truncated
    assert_words(caplog.text, f"{file} cannot be used", f"it is kept as {kept}")

    it.request("add_zone", feature=KITCHEN)
    assert published(builder(file)) == ["kitchen"]
    kept.unlink()
    assert builder(file).runtime.status().reason == ""


def test_file_in_a_folder_that_is_missing_is_an_error_of_the_start(file: Path) -> None:
    with pytest.raises(CairnError, match="no such folder"):
        builder(
            None, zones_file=str(file.parent / "no" / "x"), grid_file=str(file.parent / "map.yaml")
        )


def test_zones_that_were_edited_in_the_file_are_not_overwritten(file: Path) -> None:
    it = builder(file)
    it.request("add_zone", feature=KITCHEN)
    edited = json.dumps({"type": "FeatureCollection", "features": [STAIRS]})
    file.write_text(edited)

    with pytest.raises(CairnError, match="changed by another program"):
        it.request("remove_zone", name="kitchen")

    assert file.read_text() == edited
    assert [one["properties"]["name"] for one in it.request("zones")["features"]] == ["kitchen"]


def test_map_builder_without_a_zones_file_refuses_with_the_remedy(file: Path) -> None:
    it = builder(None, grid_file=str(file.parent / "map.yaml"))
    assert it.take("zones") == []
    with pytest.raises(CairnError, match="set its parameter zones_file"):
        it.request("add_zone", feature=KITCHEN)


def test_zone_is_in_force_on_a_full_disk_and_saved_later(file: Path) -> None:
    it = builder(file)
    with room_for(10):
        answer = it.request("add_zone", feature=STAIRS)
        assert not answer["saved"]
        assert published(it) == ["stairs"]
        it.run_for(3.0)
        assert not file.exists()

    it.run_for(12.0)

    assert names_in(file) == ["stairs"]
