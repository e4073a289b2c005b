"""A virtual machine with a stock Debian kernel, in which the host's own files run.

The host's root is mounted read-only, so that the project's virtual environment is the one under
test; ``/mnt`` in the guest is a folder of the host for what comes out. The kernel is fetched once
with apt-get and unpacked, not installed. Plain emulation: no KVM, no privileges on the host.

With ``icount`` the guest is a computer of 10^9 instructions a second in a virtual time of its
own, which the load of the host cannot touch.
"""

from __future__ import annotations

import gzip
import io
import lzma
import os
import shlex
import shutil
import struct
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from support.programs import run_program

PROGRAMS = (*("qemu-system-x86_64", "busybox", "depmod", "cpio", "dpkg", "apt-get", "setpriv"),)
BOOT_MODULES = ("virtio_pci", "9pnet_virtio", "9p")
GUEST_MODULES = ("usbcore", "vhci-hcd")
MEMORY_MB = 512


class VmError(RuntimeError):
    """The virtual machine could not be made or did not end as it should."""


@dataclass(frozen=True)
class VmResult:
    """status: exit status of the command. output: what it wrote. console: the kernel's words."""

    status: int
    output: str
    console: str


def why_not() -> str:
    """Why this machine cannot run the virtual machine; empty when it can."""
    missing = [name for name in PROGRAMS if _program(name) is None]
    if missing:
        return f"not installed: {', '.join(missing)}; install the packages that hold them"
    return ""


def run(
    command: list[str], out: Path, *, icount: str = "", timeout_s: float = 300.0, cwd: Path
) -> VmResult:
    """Run ``command`` in a fresh machine. ``out`` appears as ``/mnt``.

    icount: empty for plain emulation, ``sleep=on`` (virtual time keeps to real time where it
        can) or ``sleep=off`` (as fast as it goes).
    """
    kernel = kernel_root()
    version = _version(kernel)
    out.mkdir(parents=True, exist_ok=True)
    script = "\n".join(
        [
            "export PATH=/usr/local/bin:/usr/bin:/usr/sbin:/bin:/sbin",
            "export HOME=/dev/shm TMPDIR=/dev/shm PYTHONDONTWRITEBYTECODE=1",
            f"cd {shlex.quote(str(cwd))}",
            f"modprobe -d {shlex.quote(str(kernel))} -a {' '.join(GUEST_MODULES)} || exit 90",
            shlex.join(command),
        ]
    )
    (out / "command.sh").write_text(script + "\n")
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "initrd.gz"
        image.write_bytes(_initramfs(kernel, version))
        counting = ["-icount", f"shift=0,{icount}"] if icount else []
        machine = [
            # ends with the tests, however they end
            "setpriv", "--pdeathsig", "KILL",
            # its time is its own: it takes what other tests leave
            "nice", "-n", "19",
            "qemu-system-x86_64", "-M", "q35,accel=tcg", "-cpu", "max", "-smp", "1",
            "-m", str(MEMORY_MB), "-nodefaults", "-no-user-config", "-display", "none",
            "-no-reboot", "-kernel", str(_unpacked_kernel(kernel, Path(folder), version)),
            "-initrd", str(image),
            "-virtfs", _share("/", "hostroot", readonly=True),
            "-virtfs", _share(str(out), "out", readonly=False),
            "-serial", "stdio", "-append", "console=ttyS0 quiet panic=-1 mitigations=off",
            *counting,
        ]  # fmt: skip
        try:
            done = run_program(machine, stdin=subprocess.DEVNULL, text=False, timeout=timeout_s)
        except subprocess.TimeoutExpired as late:
            said = (late.stdout or b"").decode(errors="replace") + _read(out / "output")
            raise VmError(f"no end within {timeout_s:g} s; it said: {said[-4000:]}") from late
    console = (done.stdout + done.stderr).decode(errors="replace")
    if not (out / "exit").exists():
        raise VmError(f"the machine ended without a result: {console[-4000:]}")
    return VmResult(int(_read(out / "exit")), _read(out / "output"), console)


def cache_folder() -> Path:
    """What is made once for all machines."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "groundstation-usb-vm"


def kernel_root() -> Path:
    """A folder with ``boot`` and ``lib/modules`` of Debian's kernel, fetched when it is absent."""
    cache = cache_folder()
    root = cache / "root"
    if not root.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache) as folder:
            _command(["apt-get", "-q", "download", _kernel_package()], folder)
            (package,) = Path(folder).glob("*.deb")
            _command(["dpkg", "-x", str(package), "root"], folder)
            package.unlink()
            fresh = Path(folder) / "root"
            _command([_program("depmod") or "", "-b", str(fresh), _version(fresh)], folder)
            fresh.rename(root)
    return root


def _kernel_package() -> str:
    """The image behind ``linux-image-amd64``: the cloud image has no USB."""
    said = _command(["apt-cache", "depends", "linux-image-amd64"], "/")
    for line in said.splitlines():
        verb, _, name = line.strip().partition(": ")
        if verb == "Depends" and name.startswith("linux-image-"):
            return name
    raise VmError("apt knows no linux-image-amd64; run 'apt-get update' on a Debian machine")


def _version(root: Path) -> str:
    (image,) = (root / "boot").glob("vmlinuz-*")
    return image.name.removeprefix("vmlinuz-")


def _unpacked_kernel(root: Path, folder: Path, version: str) -> Path:
    """What the kernel's image unpacks when it starts, unpacked here, where it takes less time.

    Offsets: Documentation/x86/boot.rst of the Linux kernel, "The Real-Mode Kernel Header".
    """
    image = root / "boot" / f"vmlinuz-{version}"
    packed = image.read_bytes()
    offset, length = struct.unpack_from("<II", packed, 0x248)
    start = (packed[0x1F1] + 1) * 512 + offset
    payload = packed[start : start + length]
    if not payload.startswith(b"\xfd7zXZ"):
        return image
    kernel = folder / "vmlinux"
    # the payload's last word is no part of the packed stream, but its unpacked size
    kernel.write_bytes(lzma.LZMADecompressor().decompress(payload))
    return kernel


def _initramfs(root: Path, version: str) -> bytes:
    """busybox, the modules for the shared folders, and the script below, as a cpio archive."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in ("bin", "host", "modules", "proc", "sys", "dev"):
            (tree / name).mkdir()
        shutil.copy(_program("busybox") or "", tree / "bin" / "busybox")
        lines = []
        for module in BOOT_MODULES:
            modprobe = [_program("modprobe") or "modprobe", "-d", str(root), "-S", version]
            for line in _command([*modprobe, "--show-depends", module], "/").splitlines():
                verb, _, path = line.strip().partition(" ")
                if verb == "insmod" and (name := Path(path.strip()).name) not in lines:
                    shutil.copy(path.strip(), tree / "modules" / name)
                    lines.append(name)
        init = tree / "init"
        init.write_text(_INIT.replace("MODULES", " ".join(lines)))
        init.chmod(0o755)
        names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
        packed = run_program(
            ["cpio", "--quiet", "-o", "-H", "newc"],
            input=names.encode(), text=False, cwd=tree, check=True,
        )  # fmt: skip
    compressed = io.BytesIO()
    with gzip.GzipFile(fileobj=compressed, mode="wb", compresslevel=1) as file:
        file.write(packed.stdout)
    return compressed.getvalue()


_INIT = """#!/bin/busybox sh
b=/bin/busybox
$b mount -t proc none /proc
$b mount -t sysfs none /sys
$b mount -t devtmpfs none /dev
for m in MODULES; do $b insmod /modules/$m || $b echo "no $m"; done
share="trans=virtio,version=9p2000.L,msize=524288"
$b mount -t 9p -o $share,ro,cache=loose hostroot /host || $b echo "no root"
$b mount -t proc none /host/proc
$b mount -t sysfs none /host/sys
$b mount -t devtmpfs none /host/dev
$b mkdir -p /host/dev/shm /host/dev/pts
$b mount -t tmpfs -o size=128m none /host/dev/shm
$b mount -t devpts none /host/dev/pts
$b mount -t tmpfs none /host/run
$b mount -t 9p -o $share out /host/mnt || $b echo "no out"
$b ip link set lo up
$b chroot /host /bin/sh /mnt/command.sh > /host/mnt/output 2>&1
$b echo $? > /host/mnt/exit
$b sync
$b echo o > /proc/sysrq-trigger
$b sleep 10
"""


def _share(path: str, tag: str, *, readonly: bool) -> str:
    access = ",readonly=on" if readonly else ""
    return f"local,path={path},mount_tag={tag},security_model=none,multidevs=remap{access}"


def _program(name: str) -> str | None:
    return shutil.which(name, path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")


def _command(command: list[str], folder: str) -> str:
    done = run_program(command, cwd=folder)
    if done.returncode:
        raise VmError(f"{' '.join(command)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout


def _read(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""
