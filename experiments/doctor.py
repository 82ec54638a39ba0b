"""`bodyplan doctor`: what works on this machine, and what to install for the rest."""

from __future__ import annotations

import argparse
import platform
import shutil
import sys
from pathlib import Path
from typing import Any, NamedTuple

from experiments.output import BAD_INPUT, DONE, VERSION, emit, say

HELP = "versions, GPU, GL, slicer, CAN interfaces, components: what works here"

# Distribution and the module it provides. Every one of them is imported: a wheel can be there and its library not.
REQUIRED = (
    ("numpy", "numpy"), ("scipy", "scipy"), ("scikit-image", "skimage.measure"), ("trimesh", "trimesh"),
    ("manifold3d", "manifold3d"), ("embreex", "embreex.rtcore_scene"), ("mujoco", "mujoco"), ("cma", "cma"),
    ("scikit-learn", "sklearn.discriminant_analysis"), ("pandas", "pandas"), ("python-can", "can"),
    ("pyserial", "serial"), ("matplotlib", "matplotlib"), ("msgspec", "msgspec"), ("tqdm", "tqdm"), ("pillow", "PIL"),
    ("imageio-ffmpeg", "imageio_ffmpeg"), ("torch", "torch"),
    ("safetensors", "safetensors.numpy"), ("tensorboardX", "tensorboardX"),
    ("gymnasium", "gymnasium"), ("stable-baselines3", "stable_baselines3"),
)  # fmt: skip
OTHER_SLICERS = ("orca-slicer", "OrcaSlicer", "bambu-studio")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
CAN_LINK_TYPE = "280"  # ARPHRD_CAN of the Linux kernel
GIB = 2**30


class Finding(NamedTuple):
    """One line of the table.

    Attributes:
        name: what was looked for.
        ok: True if it works here.
        text: version, device or path; if it does not work, what it would bring and how to get it.
    """

    name: str
    ok: bool
    text: str


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of a table")


def main(args: argparse.Namespace) -> int:
    """Look at everything; status 2 if a base dependency is missing or broken."""
    required = [_dependency(*names) for names in REQUIRED]
    machine, optional = _machine(), _optional()
    broken = [f.name for f in required if not f.ok]
    if args.json:
        groups = {"dependencies": required, "machine": machine, "optional": optional}
        emit({"ok": not broken, **{name: _as_json(findings) for name, findings in groups.items()}, "parts": _parts()})
    else:
        _table("this machine", machine)
        _table("needed", required)
        _table("optional (bodyplan does its work without; nothing here is required)", optional)
        print("\ncomponents that --catalogue auto chooses from (--parts DIR adds files like mfg/components/*.toml)")
        for kind, texts in _parts().items():
            for text in texts:
                print(f"       {kind:15s} {text}")
        if not broken:
            print("\nEverything bodyplan needs is here.")
    if broken:
        say(f"bodyplan: error: {', '.join(broken)} missing or broken; repair with: make install")
        return BAD_INPUT
    return DONE


def _dependency(distribution: str, module: str) -> Finding:
    import importlib
    from importlib import metadata

    try:
        importlib.import_module(module)
        return Finding(distribution, True, metadata.version(distribution))
    except metadata.PackageNotFoundError:
        return Finding(distribution, True, "version unknown")
    except (ImportError, OSError, AttributeError) as error:  # an extension that does not fit the machine
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        return Finding(distribution, False, f"{reason}; install with: pip install {distribution}")


def _machine() -> list[Finding]:
    import os

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    findings = [
        Finding("bodyplan", True, VERSION),
        Finding("python", True, f"{platform.python_version()} at {sys.executable}"),
        Finding("system", True, f"{platform.system()} {platform.release()} {platform.machine()}"),
        Finding("cores", True, f"{cores} usable: --workers {cores} is the most that helps"),
    ]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / GIB
        findings.append(Finding("memory", memory >= 2, f"{memory:.1f} GiB; a worker uses about 0.3 GiB"))
    free = shutil.disk_usage(".").free / GIB
    findings.append(Finding("disk", free >= 1, f"{free:.1f} GiB free in this folder; a run takes up to 0.2 GiB"))
    return findings


def _optional() -> list[Finding]:
    return [_gpu(), _gl(), _ffmpeg(), _slicer(), _browser(), _can(), _serial()]


def _gpu() -> Finding:
    try:
        import torch
    except (ImportError, OSError):
        return Finding("GPU", False, "torch is missing, so this is unknown")
    if torch.cuda.is_available():
        return Finding("GPU", True, f"{torch.cuda.get_device_name(0)}, CUDA {torch.version.cuda}")
    if shutil.which("nvidia-smi"):
        return Finding("GPU", False, f"an NVIDIA driver is here, but torch {torch.__version__} is a CPU build; "
                       "remove .venv and run: make install")  # fmt: skip
    return Finding("GPU", False, "none; it would speed up training, nothing in this version uses it")


def _gl() -> Finding:
    from ctypes.util import find_library

    found = [name for name in ("EGL", "OSMesa", "GL") if find_library(name)]
    if found:
        return Finding("GL", True, f"{', '.join(found)}; MuJoCo's own viewer can work (pictures never need it)")
    return Finding("GL", False, "no EGL, OSMesa or GL; only MuJoCo's own viewer needs one: apt install libegl1")


def _ffmpeg() -> Finding:
    try:
        import imageio_ffmpeg

        return Finding("ffmpeg", True, str(imageio_ffmpeg.get_ffmpeg_exe()))
    except (ImportError, RuntimeError) as error:
        return Finding("ffmpeg", False, f"{error}; videos need it: pip install imageio-ffmpeg")


def _which(names: tuple[str, ...]) -> str | None:
    return next((path for path in map(shutil.which, names) if path), None)


def _slicer() -> Finding:
    from mfg.slicer import HOW_TO_GET, SliceError, find_slicer, slicer_version

    path = find_slicer()
    if path is None:
        other = _which(OTHER_SLICERS)
        here = f"{other} opens print_bambu.3mf; " if other else ""
        return Finding("slicer", bool(other), f"{here}no PrusaSlicer; build --slice needs it: {HOW_TO_GET}")
    try:
        return Finding("slicer", True, f"{slicer_version(path)} at {path}: build --slice")
    except SliceError as error:
        return Finding("slicer", False, f"{error}; install it anew: {HOW_TO_GET}")


def _browser() -> Finding:
    path = _which(BROWSERS)
    return Finding("browser", bool(path), path or "no Chromium; any browser opens a report: apt install chromium")


def _can() -> Finding:
    links = Path("/sys/class/net")
    found = sorted(p.parent.name for p in links.glob("*/type") if p.read_text().strip() == CAN_LINK_TYPE)
    if found:
        return Finding("CAN", True, f"{', '.join(found)}: deploy with --bus socketcan:{found[0]}")
    return Finding("CAN", False, "no interface; --bus virtual always works, a real one: "
                   "ip link set can0 up type can bitrate 1000000")  # fmt: skip


def _serial() -> Finding:
    found = sorted(str(p) for pattern in ("ttyACM*", "ttyUSB*", "cu.usbmodem*") for p in Path("/dev").glob(pattern))
    if found:
        return Finding("serial", True, f"{', '.join(found)}: a CANable there is --bus slcan:{found[0]}")
    return Finding("serial", False, "no USB serial adapter; a CANable with slcan firmware would appear as /dev/ttyACM0")


def _parts() -> dict[str, list[str]]:
    """What ships, by kind, each in a few words."""
    try:
        from mfg.library import read_library
    except ImportError:  # numpy is missing; that was said above.
        return {}
    library = read_library()
    driven = {"none": ", no driver here"}
    return {
        "motor": [f"{m.name}: {m.peak_torque:g} N.m, {m.continuous_torque:.3g} N.m for long, {1e3 * m.mass:.0f} g, "
                  f"{1e3 * m.diameter:g} x {1e3 * m.length:g} mm{driven.get(m.driver, '')}" for m in library.motors],
        "battery": [f"{b.name}: {b.voltage:g} V, {b.capacity:g} A.h, {1e3 * b.mass:.0f} g, {_size(b.size)}"
                    for b in library.batteries],
        "controller": [f"{c.name}: {c.max_joints} joints, {1e3 * c.mass:.0f} g, {_size(c.size)}"
                       for c in library.controllers],
        "wire": [f"{w.name}: {w.max_current or 0:g} A, {1e3 * w.mass_per_metre:g} g/m" for w in library.wires],
    }  # fmt: skip


def _size(size: tuple[float, float, float]) -> str:
    return " x ".join(f"{1e3 * side:g}" for side in size) + " mm"


def _as_json(findings: list[Finding]) -> dict[str, Any]:
    return {f.name: {"ok": f.ok, "text": f.text} for f in findings}


def _table(title: str, findings: list[Finding]) -> None:
    print(f"\n{title}")
    for finding in findings:
        print(f"  {'yes' if finding.ok else ' no'}  {finding.name:15s} {finding.text}")
