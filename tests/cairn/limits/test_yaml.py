"""Hostile YAML files and devices given as files are refused with the reason, quickly."""

from pathlib import Path

import pytest

from cairn.errors import CairnError
from tests.hostile_files import HOSTILE
from tests.hostile_reading import READERS
from tests.sweeps import sampled

# The readers of images refuse their files in cases of their own.
_KINDS = ("deployment", "world", "grid_map", "camera_file")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        case
        for kind in _KINDS
        for case in sampled(
            [
                (kind, name)
                for name in HOSTILE[kind]
                if not name.startswith("image_") and name != "points"  # slow: 50,000 values
            ],
            3,
        )
    ],
)
def test_hostile_yaml_file_is_refused_with_its_reason(tmp_path: Path, kind: str, name: str) -> None:
    hostile = HOSTILE[kind][name]
    file = hostile.build(tmp_path)

    with pytest.raises(CairnError, match=hostile.reason) as refusal:
        READERS[kind](file)

    assert str(file) in str(refusal.value)
    assert len(str(refusal.value)) < 3000
