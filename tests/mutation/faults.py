"""The list of deliberate faults: how to read, check and write it."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("faults.yaml")
NO_TEST = "none"

_HEADER = """\
# Deliberate faults. `python -m tests.mutation` applies each to a copy of the code and runs its
# tests; see tests/mutation/__main__.py. `find` occurs exactly once in `file`. `caught_by` is the
# first test that failed when the fault was last recorded, or none. With `--record` the runner
# writes this file anew, and other comments are lost.
"""


class Fault(BaseModel):
    """A small change of the code that a programmer's mistake could make."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    id: str = Field(pattern=r"^[a-z0-9-]+$")
    room: str
    file: str
    find: str
    replace: str
    fault: str
    tests: tuple[str, ...] = Field(min_length=1)
    caught_by: str = NO_TEST


def read_faults(file: Path = FILE) -> list[Fault]:
    """Read the list of faults; raises `ValueError` if an entry is not valid."""
    return [Fault.model_validate(entry) for entry in yaml.safe_load(file.read_text("utf-8"))]


def write_faults(faults: Sequence[Fault], file: Path = FILE) -> None:
    """Replace the list of faults."""
    entries = [{**fault.model_dump(), "tests": list(fault.tests)} for fault in faults]
    text = yaml.dump(entries, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=98)
    file.write_text(_HEADER + text.replace("\n- id:", "\n\n- id:"), "utf-8")


def mutated(fault: Fault, source: str) -> str:
    """Return the text of the file with the fault."""
    return source.replace(fault.find, fault.replace)


def problems(faults: Sequence[Fault], root: Path = ROOT) -> Iterator[str]:
    """Yield a sentence for each fault that cannot be applied to the code under `root`."""
    for name, count in Counter(fault.id for fault in faults).items():
        if count > 1:
            yield f"{name}: {count} faults have this id"
    for fault in faults:
        for test in fault.tests:
            if not (root / test.partition("::")[0]).exists():
                yield f"{fault.id}: there is no test {test}"
        path = root / fault.file
        if not path.is_file():
            yield f"{fault.id}: there is no file {fault.file}"
            continue
        source = path.read_text("utf-8")
        count = source.count(fault.find)
        if count != 1:
            yield f"{fault.id}: `find` occurs {count} times in {fault.file}; it must occur once"
            continue
        if fault.find == fault.replace:
            yield f"{fault.id}: `replace` is the same as `find`"
        try:
            compile(mutated(fault, source), fault.file, "exec")
        except SyntaxError as error:
            yield f"{fault.id}: {fault.file} with the fault is not Python: {error}"


class _Dumper(yaml.SafeDumper):
    """Writes code as literal blocks."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        """Indent lists within an entry."""
        return super().increase_indent(flow, False)


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = "|" if "\n" in text else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)
