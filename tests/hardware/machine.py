"""The virtual machine: boots a kernel on this machine's file system and runs one command in it."""

import shlex
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path

from tests.hardware.kernel import Kernel
from tests.hardware.needs import CannotRun, program

_HERE = Path(__file__).parent
_REPOSITORY = _HERE.parents[1]
_STARTING = ("second_program.sh", "tests.service", "third_program.sh")
_BOOT_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay")
# Software emulation works on every machine. With a clock that counts instructions, one per
# nanosecond (about those of one core of a Raspberry Pi 4), the guest sees nothing of how slow or
# busy the machine is; it waits for its timers in real time. Systemd takes too long so (14 minutes
# for the guest's first one): that guest has two processors and the machine's clock.
_COUNTED = ("-accel", "tcg,thread=single,tb-size=1024", "-icount", "shift=0", "-smp", "1")
_FAST = ("-accel", "tcg,thread=multi,tb-size=1024", "-smp", "2")


def first_file_system(kernel: Kernel, folder: Path) -> Path:
    """Make the guest's first file system: a shell, and the files needed to mount the next one."""
    root = folder / "first"
    for name in ("bin", "proc", "sys", "dev", "host", "written", "root", "modules"):
        (root / name).mkdir(parents=True)
    shutil.copy(program("busybox"), root / "bin" / "busybox")
    files = kernel.files_of(*_BOOT_MODULES)
    for file in files:
        shutil.copy(file, root / "modules")
    (root / "modules" / "order").write_text("".join(f"{file.name}\n" for file in files))
    shutil.copy(_HERE / "first_program.sh", root / "init")
    (root / "init").chmod(0o755)
    names = "\n".join(str(path.relative_to(root)) for path in [root, *root.rglob("*")])
    packed = folder / "first.cpio"
    with packed.open("wb") as out:
        command = [program("cpio"), "--create", "--format=newc", "--quiet"]
        subprocess.run(command, cwd=root, input=names.encode(), stdout=out, check=True, timeout=20)
    return packed


def run_in_guest(
    kernel: Kernel, command: list[str], log: Path, limit_s: float, *, booted: bool = False
) -> int:
    """Run a command in the guest, in this repository's folder; returns its exit status.

    With `booted` the guest's init is systemd, which takes longer.

    Its output is printed here at once; the kernel's messages go to the file `log`.
    Raises `CannotRun` if the guest does not come to the command's end within the limit [s].
    """
    with tempfile.TemporaryDirectory(prefix="cairn-guest-") as name:
        folder = Path(name)
        exchange = folder / "exchange"
        exchange.mkdir()
        for file in _STARTING:
            shutil.copy(_HERE / file, exchange)
        (exchange / "environment").write_text(
            f"REPOSITORY={shlex.quote(str(_REPOSITORY))}\n"
            f"MODULES={shlex.quote(str(kernel.modules))}\n"
            f"COMMAND={shlex.quote(shlex.join(command))}\n"
            f"BOOTED={'yes' if booted else ''}\n"
        )
        qemu = _qemu(kernel, first_file_system(kernel, folder), folder, log, booted=booted)
        ended = _printed(qemu, limit_s)
        status = exchange / "exit_status"
        if not status.exists():
            raise CannotRun(f"{ended} before the guest's command ended (limit: {limit_s:g} s)")
        return int(status.read_text())


def _printed(qemu: list[str], limit_s: float) -> str:
    """Run QEMU, print what the guest prints, marked as such, and return how QEMU ended."""
    pipe = subprocess.PIPE  # for its input too: QEMU would stop at the end of its input
    late = threading.Event()
    with subprocess.Popen(qemu, stdin=pipe, stdout=pipe, text=True, errors="replace") as process:

        def stop() -> None:
            late.set()
            process.kill()

        limit = threading.Timer(limit_s, stop)
        limit.start()
        try:
            assert process.stdout is not None
            for line in process.stdout:
                print(f"guest| {line}", end="", flush=True)
            process.wait()
        finally:
            process.kill()  # if we are interrupted
            limit.cancel()
    return "QEMU was killed" if late.is_set() else f"QEMU ended with {process.returncode}"


def _qemu(kernel: Kernel, first: Path, folder: Path, log: Path, *, booted: bool) -> list[str]:
    machine = ["-machine", "q35", "-cpu", "max", "-m", "2048", *(_FAST if booted else _COUNTED)]
    boot = ["-kernel", str(kernel.vmlinux), "-initrd", str(first), "-no-reboot"]
    words = "console=ttyS0 quiet panic=-1 mitigations=off nokaslr"
    outside = ["-display", "none", "-nodefaults", "-nic", "none", "-serial", f"file:{log}"]
    files = [
        *_shared("/", "host", "readonly=on,multidevs=remap"),
        *_shared(str(folder / "exchange"), "exchange", "multidevs=remap"),
    ]
    return [
        *[program("qemu-system-x86_64"), *machine, *boot, "-append", words, *outside, *files],
        *_virtual_ports(folder),
    ]


def _shared(path: str, tag: str, how: str) -> list[str]:
    return ["-virtfs", f"local,path={path},mount_tag={tag},security_model=none,{how}"]


def _virtual_ports(folder: Path) -> list[str]:
    """The guest's lines to its own surroundings.

    /dev/virtio-ports/output: what the command prints.
    /dev/virtio-ports/control: QEMU's control protocol: tests pull their own machine's plugs.
    /dev/hvc0: the far end of the FTDI adapter's RS-232 line, where tests put an emulated device.

    The last two are looped through sockets of this process alone: one end is the server, the other
    its client.
    """
    control, line = folder / "control.sock", folder / "line.sock"
    return [
        *["-device", "qemu-xhci,id=usb", "-device", "virtio-serial-pci"],
        *["-chardev", "stdio,id=output,signal=off"],
        *["-device", "virtserialport,chardev=output,nr=1,name=output"],
        *["-chardev", f"socket,id=control,path={control},server=on,wait=off"],
        *["-mon", "chardev=control,mode=control"],
        *["-chardev", f"socket,id=control_guest,path={control}"],
        *["-device", "virtserialport,chardev=control_guest,nr=2,name=control"],
        *["-chardev", f"socket,id=line,path={line},server=on,wait=off"],
        *["-chardev", f"socket,id=line_guest,path={line}"],
        *["-device", "virtconsole,chardev=line_guest,nr=0"],
    ]
