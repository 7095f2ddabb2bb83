"""A wheel with the name of Cairn, as small as possible."""

import zipfile
from base64 import urlsafe_b64encode
from hashlib import sha256
from pathlib import Path
from textwrap import dedent

# Only `cairn check FILE`, which refuses one label.
CAIRN = """
    import sys

    def main():
        assert sys.argv[1] == "check"
        if "label: refused" in open(sys.argv[2]).read():
            sys.exit("the label is refused")
    """


def tiny_wheel(folder: Path, code: str = CAIRN) -> Path:
    """Return a new wheel with a program `cairn`."""
    wheel = folder / "cairn_robotics-9.0-py3-none-any.whl"
    info = "cairn_robotics-9.0.dist-info"
    code = dedent(code)
    files = {
        "tiny_cairn.py": code,
        f"{info}/METADATA": "Metadata-Version: 2.1\nName: cairn-robotics\nVersion: 9.0\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\ncairn = tiny_cairn:main\n",
    }
    digest = urlsafe_b64encode(sha256(code.encode()).digest()).decode().rstrip("=")
    record = [f"{name},," for name in [*files, f"{info}/RECORD"]]
    record[0] = f"tiny_cairn.py,sha256={digest},{len(code)}"
    files[f"{info}/RECORD"] = "\n".join([*record, ""])
    folder.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return wheel
