"""The page "How Cairn works": its files exist, and its journeys are short."""

import re
from pathlib import Path

PAGE = "docs/concepts/how-it-works.md"
MOST_FILES = {"A message": 35, "A crash": 15, "A goal": 20}


def sections(root: Path) -> dict[str, list[str]]:
    """Return the files that the page names, in order, by the first words of the heading."""
    text = (root / PAGE).read_text(encoding="utf-8")
    found = {}
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        heading = section.partition(":")[0].partition("\n")[0]
        found[heading] = re.findall(r"`([\w/]+\.(?:py|yaml))`", section)
    return found


def test_named_files_exist(root: Path) -> None:
    named = {name for files in sections(root).values() for name in files}

    assert len(named) > 50
    assert {name for name in named if not (root / name).is_file()} == set()


def test_journeys_pass_few_files(root: Path) -> None:
    passed = sections(root)
    assert {
        heading: len(set(passed[heading]))
        for heading, most in MOST_FILES.items()
        if len(set(passed[heading])) > most
    } == {}
