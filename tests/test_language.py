"""The text of the project: standard technical English, by the rules of CONTRIBUTING.md."""

import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SUFFIXES = {".py", ".md", ".yaml", ".yml", ".toml", ".sh", ".service", ".rules", ".sysusers"}
# Not ours: licenses, and notes that quote their sources. This file quotes what it rejects.
EXCLUDED = re.compile(r"LICENSE|SOURCE\.md$|^tests/test_language\.py$")

# Each pattern with what to write instead.
REJECTED = {
    r"\b(tell|tells|told|telling)\b": "publish, report, log, return, send or specify",
    r"\b(whoever|whomever|nobody|somebody|anybody)\b": "name the process, component or person",
    r"\banew\b": "again, or restart",
    r"\bheeds?\b": "name the action",
    r"\bbegun\b": "started",
    r"\bof late\b": "recently",
    r"\bgets? on\b": "progress",
    r"\bin vain\b": "without effect",
    r"(?<![Tt]here )\bis (no|none)\b(?! (longer|more|less))": "is not a ..., or: there is no ...",
    r"(?<![Tt]here )\bare none\b": "are not valid",
    r"\bcomes? (hardly|of it)\b": "rewrite the sentence",
    r"\btaken for\b": "treated as, or mistaken for",
    r"\bword of\b": "name the message or event",
    r"\bmended?\b|\bmends\b": "repair, correct or fix",
    r"\bcarried off\b": "moved by hand (kidnapped)",
    r"\bso long as\b": "as long as",
    r"\bbethought|\bwhereabouts\b|\bhindrances?\b": "use the term of docs/glossary.md",
    r"(?i)(colour|behaviour|neighbour|favour|recognis|localis(?!t)|normalis|initialis|serialis"
    r"|synchronis|optimis|(?<!\.)cancelled(?!Error|error)|cancelling"
    r"|\bmetres?\b|\bcentres?\b)": "American spelling",
}


@cache
def texts() -> dict[str, str]:
    """Return the project's own text files, by their path from the root."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    paths = [name for name in listed if Path(name).suffix in SUFFIXES and not EXCLUDED.search(name)]
    return {
        name: (ROOT / name).read_text(encoding="utf-8")
        for name in paths
        if (ROOT / name).is_file() and not name.startswith("tests/data/")
    }


@pytest.mark.parametrize("pattern", REJECTED)
def test_text_avoids_rejected_wording(pattern: str) -> None:
    rejected = re.compile(pattern)
    # A text of lower case is searched three times faster than one whose case is ignored.
    ignores_case = pattern.startswith("(?i)")
    coarse = re.compile(pattern.removeprefix("(?i)").lower()) if ignores_case else rejected
    found = [
        f"{name}:{number}: {line.strip()}"
        for name, text in texts().items()
        if coarse.search(text.lower() if ignores_case else text)
        for number, line in enumerate(text.splitlines(), 1)
        if rejected.search(line)
    ]

    assert not found, f"write {REJECTED[pattern]}:\n" + "\n".join(found)
