"""The guest's kernel and its modules, of Debian's packages, unpacked into the user's cache."""

import lzma
import os
import shutil
from pathlib import Path

from tests.hardware.needs import CannotRun, program, run

_IMAGE = "linux-image-amd64"
_LIMIT_S = 300
_XZ = b"\xfd7zXZ\0"


class Kernel:
    """A kernel's files: nothing of it is installed on this machine.

    Files:
        vmlinux: the bare kernel. QEMU starts it without unpacking it in the guest, which emulated
            takes four seconds.
        tree: below it `lib/modules/RELEASE`, v4l2loopback included.
    """

    def __init__(self, cache: Path) -> None:
        """The kernel in a cache folder; fetches and unpacks it if it is not there yet."""
        self._cache = cache
        version = self._version()
        self.folder = cache / version
        if not (self.folder / "ready").exists():
            self._make(version)
        self.tree = self.folder / "tree"
        self.vmlinux = self.folder / "vmlinux"
        [modules] = (self.tree / "lib" / "modules").iterdir()
        self.release = modules.name
        self.modules = modules

    def files_of(self, *modules: str) -> list[Path]:
        """Files of modules and of what they need, in the order in which they can be inserted."""
        files: dict[Path, None] = {}
        for module in modules:
            how = ["-d", str(self.tree), "-S", self.release, "--show-depends", module]
            for line in run([program("modprobe"), *how], 20).splitlines():
                words = line.split()
                if words[0] == "insmod":
                    files[Path(words[1])] = None
        return list(files)

    def _version(self) -> str:
        """Package version such as `6.1.0-56-amd64`: that of the cache if apt knows none."""
        try:
            text = run([program("apt-cache"), "depends", _IMAGE], 60)
        except CannotRun:
            text = ""
        for word in text.split():
            if word.startswith("linux-image-") and word != _IMAGE:
                return word.removeprefix("linux-image-")
        if cached := sorted(self._cache.glob("*/ready")):
            return cached[-1].parent.name
        raise CannotRun(
            f"apt knows no package {_IMAGE}: on Debian, `apt-get update` makes it known; other "
            "systems have no kernel with all these drivers"
        )

    def _make(self, version: str) -> None:
        print(f"fetching Debian's kernel {version} into {self.folder} (85 MB)", flush=True)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        tree, build = self.folder / "tree", self.folder / "build"
        self._unpack(f"linux-image-{version}", tree)
        for package in _needed_to_build(version):
            self._unpack(package, build)
        image = (tree / "boot" / f"vmlinuz-{version}").read_bytes()
        bare = lzma.LZMADecompressor().decompress(image[image.find(_XZ) :])
        (self.folder / "vmlinux").write_bytes(bare)
        self._build_loopback(tree, build, version)
        run([program("depmod"), "-b", str(tree), version], 60)
        shutil.rmtree(build)
        (self.folder / "ready").touch()

    def _unpack(self, package: str, where: Path) -> None:
        run([program("apt-get"), "download", "-q", package], _LIMIT_S, folder=self.folder)
        [file] = self.folder.glob("*.deb")
        run([program("dpkg-deb"), "-x", str(file), str(where)], 120)
        file.unlink()

    def _build_loopback(self, tree: Path, build: Path, version: str) -> None:
        """Compile v4l2loopback, which Debian has as source only."""
        sources = build / "usr" / "src"
        headers = sources / f"linux-headers-{version}"
        makefile = headers / "Makefile"
        makefile.write_text(makefile.read_text().replace("/usr/src", str(sources)))
        [module] = sources.glob("v4l2loopback-*")
        jobs = f"-j{os.cpu_count()}"
        how = ["-C", str(headers), f"M={module}", "CC=gcc", jobs, "modules"]
        run([program("make"), *how], _LIMIT_S)
        extra = tree / "lib" / "modules" / version / "updates"
        extra.mkdir()
        shutil.copy(module / "v4l2loopback.ko", extra)


def _needed_to_build(version: str) -> list[str]:
    common = version.rpartition("-")[0]
    series = ".".join(version.split(".")[:2])
    return [
        f"linux-headers-{version}",
        f"linux-headers-{common}-common",
        f"linux-kbuild-{series}",
        "v4l2loopback-dkms",
    ]
