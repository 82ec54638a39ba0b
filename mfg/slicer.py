"""A foreign opinion on the printed parts: PrusaSlicer slices the whole blueprint, and says how long and how much.

The file sliced is the blueprint's own print.3mf, with the settings that are in it, one plate at a time. The G-code is
read for its estimates and thrown away: its paths differ from run to run, the estimates by less than a percent.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from mfg.manifest import ManifestError, changed_files, read_manifest
from mfg.stl import MM_PER_M
from mfg.threemf import PLATE_STRIDE, PRUSA_CONFIG

PROGRAMS = ("prusa-slicer", "PrusaSlicer", "prusaslicer", "prusa-slicer-console")
HOW_TO_GET = "apt install --no-install-recommends prusa-slicer"
PRINT_FILE = "print.3mf"
PATIENCE = 1800.0  # for one plate; the largest seen takes 4 minutes on one slow core [s]
_MODEL = "3D/3dmodel.model"
_SETTINGS = "Metadata/Slic3r_PE_model.config"
_ITEM = re.compile(r'<item objectid="(\d+)" transform="([^"]*)" printable="1"/>')
_FOOTER = 2**18  # bytes at the end of the G-code in which the estimates stand
_GRAMS = re.compile(r"^; filament used \[g\] = (.+)$", re.MULTILINE)
_TIME = re.compile(r"^; estimated printing time \(normal mode\) = (.+)$", re.MULTILINE)
_CLOCK = re.compile(r"(?:(\d+)d)?\s*(?:(\d+)h)?\s*(?:(\d+)m)?\s*(?:(\d+)s)?")
_LOG = re.compile(r"^(?:\[[-0-9: .]+\]\s*)?(?:\[0x[0-9a-fA-F]+\]\s*)?\[(warning|error|fatal)\]\s*(.*)$")
_SPOKEN = re.compile(r"^(?:print )?(?:warning|error)\s*:\s*(.*)$", re.IGNORECASE)


class SliceError(RuntimeError):
    """A blueprint that was not sliced; the message is one line that says why, and what to do where that is known."""


@dataclass(frozen=True, slots=True)
class PlateSlice:
    """What the slicer says about one plate.

    Attributes:
        plate: index, 0, 1, ...
        objects: names of what stands on it.
        seconds: estimated printing time [s].
        grams: of rigid and of soft filament, supports and all [g].
        warnings: of the slicer, each once.
    """

    plate: int
    objects: tuple[str, ...]
    seconds: float
    grams: tuple[float, float]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SliceReport:
    """What the slicer says about a blueprint.

    Attributes:
        program: name and version.
        plates: in order.
    """

    program: str
    plates: tuple[PlateSlice, ...]

    @property
    def seconds(self) -> float:
        """Estimated printing time of all plates [s]."""
        return sum(plate.seconds for plate in self.plates)

    @property
    def grams(self) -> tuple[float, float]:
        """Rigid and soft filament of all plates [g]."""
        return sum(plate.grams[0] for plate in self.plates), sum(plate.grams[1] for plate in self.plates)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Each once, in the order in which they came."""
        return tuple(dict.fromkeys(warning for plate in self.plates for warning in plate.warnings))

    def to_json(self) -> dict[str, Any]:
        """As it stands in blueprint.json under `slice`."""
        return {
            "program": self.program,
            "seconds": self.seconds,
            "filament_g": _by_material(self.grams),
            "warnings": list(self.warnings),
            "plates": [
                {"plate": p.plate, "objects": list(p.objects), "seconds": p.seconds,
                 "filament_g": _by_material(p.grams), "warnings": list(p.warnings)}
                for p in self.plates
            ],
        }  # fmt: skip


def find_slicer() -> Path | None:
    """PrusaSlicer on the search path, or None."""
    found = next((path for path in map(shutil.which, PROGRAMS) if path), None)
    return None if found is None else Path(found)


def slicer_version(program: Path) -> str:
    """Name and version, as the program's help begins.

    Raises:
        SliceError: if it does not run or is another program.
    """
    said = _run([str(program), "--help"], 60.0)
    match = re.search(r"^(PrusaSlicer)-(\d[\w.]*)", said.stdout, re.MULTILINE)
    if match is None:
        raise SliceError(f"{program} is not PrusaSlicer: its help does not say so")
    return f"{match[1]} {match[2]}"


def slice_blueprint(folder: Path | str, program: Path | None = None, patience: float = PATIENCE) -> SliceReport:
    """Slice every plate of a blueprint folder; nothing in the folder is changed.

    Args:
        folder: of a blueprint, as `write_blueprint` made it.
        program: PrusaSlicer; the one on the search path if None.
        patience: most that one plate may take [s].

    Raises:
        SliceError: if there is no slicer, or it crashes, takes too long or does not say what it should.
        ManifestError: if the manifest is damaged.
        OSError: if a file cannot be read.
    """
    program = program or find_slicer()
    if program is None:
        raise SliceError(f"no PrusaSlicer on this machine; get it with: {HOW_TO_GET}")
    folder = Path(folder)
    document = read_manifest(folder)
    if PRINT_FILE in changed_files(folder):
        raise SliceError(f"{folder / PRINT_FILE} is not the file that blueprint.json knows; build the design again")
    try:
        objects = [(str(laid["name"]), int(laid["plate"])) for laid in document.get("pieces") or document["bodies"]]
        stride = float(document["catalogue"]["printer"]["volume"][0]) * PLATE_STRIDE * MM_PER_M
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ManifestError(f"{folder}: what lies on which plate is missing or malformed ({error!r:.120})") from None
    version = slicer_version(program)
    content = _unpacked(folder / PRINT_FILE)
    extruders = _extruders(content[_SETTINGS].decode(), len(objects))
    plates = []
    with tempfile.TemporaryDirectory(prefix="bodyplan-slice-") as work:
        for plate in sorted({plate for _, plate in objects}):
            one = Path(work) / f"plate_{plate + 1}.3mf"
            _pack(one, content, [p for _, p in objects], plate, stride)
            here = tuple(name for name, p in objects if p == plate)
            used = {e for (_, p), found in zip(objects, extruders, strict=True) if p == plate for e in found}
            plates.append(_slice(program, one, plate, here, used, patience))
    return SliceReport(version, tuple(plates))


def clock(seconds: float) -> str:
    """Hours and minutes for people."""
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def _slice(
    program: Path, file: Path, plate: int, objects: tuple[str, ...], extruders: set[str], patience: float
) -> PlateSlice:
    gcode = file.with_suffix(".gcode")
    command = [str(program), "--loglevel", "2", "--datadir", str(file.parent / "settings"), "--dont-arrange",
               "--export-gcode", "--output", str(gcode), str(file)]  # fmt: skip
    said = _run(command, patience)
    name = f"plate {plate + 1} ({', '.join(objects)})"
    spoken = [line.strip() for line in (said.stdout + "\n" + said.stderr).splitlines() if line.strip()]
    if said.returncode != 0:
        how = f"signal {-said.returncode}" if said.returncode < 0 else f"status {said.returncode}"
        raise SliceError(f"PrusaSlicer failed on {name} with {how}: {_last(spoken)}")
    if not gcode.is_file():
        raise SliceError(f"PrusaSlicer wrote no G-code for {name}: {_last(spoken)}")
    footer = _footer(gcode)
    gcode.unlink()
    return PlateSlice(plate, objects, _seconds(footer, name), _grams(footer, name, extruders), _warnings(spoken))


@contextmanager
def _ending_by_exception() -> Iterator[None]:
    """Let SIGTERM end this program by SystemExit, so that it takes what it started with it.

    Only where nobody else answers that signal, and in the main thread, which alone may ask for signals.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return

    def end(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _run(command: Sequence[str], patience: float) -> subprocess.CompletedProcess[str]:
    try:
        with _ending_by_exception(), subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            errors="replace", env={**os.environ, "LC_ALL": "C"}, start_new_session=True,
        ) as process:  # fmt: skip
            try:
                out, err = process.communicate(timeout=patience)
            except BaseException:
                # It may be a script that waits for the program proper: all of them go.
                os.killpg(process.pid, signal.SIGKILL)
                raise
            return subprocess.CompletedProcess(command, process.returncode, out, err)
    except subprocess.TimeoutExpired:
        raise SliceError(f"{command[0]} was stopped after {patience:g} s without a result") from None
    except OSError as error:
        raise SliceError(f"{command[0]} does not run: {error.strerror or error}") from None


def _unpacked(path: Path) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(path) as archive:
            content = {name: archive.read(name) for name in archive.namelist()}
    except (zipfile.BadZipFile, KeyError) as error:
        raise SliceError(f"{path} is not a 3MF file: {error}") from None
    if not {PRUSA_CONFIG, _MODEL, _SETTINGS} <= set(content):
        raise SliceError(f"{path} holds no print settings: it is of an older version; build the design again")
    return content


def _pack(path: Path, content: dict[str, bytes], plates: Sequence[int], plate: int, stride: float) -> None:
    """Write the 3MF again with one plate at its true place and the others switched off."""
    model = content[_MODEL].decode()
    if len(_ITEM.findall(model)) != len(plates):
        raise SliceError(f"{PRINT_FILE} does not hold the {len(plates)} objects that blueprint.json names")
    numbers = iter(plates)

    def placed(match: re.Match[str]) -> str:
        transform = match[2].split()
        transform[9] = f"{float(transform[9]) - plate * stride:.9g}"
        shown = int(next(numbers) == plate)
        return f'<item objectid="{match[1]}" transform="{" ".join(transform)}" printable="{shown}"/>'

    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in content.items():
            archive.writestr(name, _ITEM.sub(placed, model).encode() if name == _MODEL else data)


def _extruders(settings: str, count: int) -> list[set[str]]:
    """The extruders that each object's parts name."""
    found = [set(re.findall(r'key="extruder" value="(\d+)"', block)) for block in settings.split("<object ")[1:]]
    if len(found) != count:
        raise SliceError(f"{PRINT_FILE} does not hold settings of the {count} objects that blueprint.json names")
    return found


def _footer(gcode: Path) -> str:
    with gcode.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - _FOOTER))
        return file.read().decode("utf-8", "replace")


def _seconds(footer: str, name: str) -> float:
    match = _TIME.search(footer)
    clock = None if match is None else _CLOCK.fullmatch(match[1].strip())
    if match is None or clock is None or not any(clock.groups()):
        raise SliceError(f"the G-code of {name} says no printing time that this program can read")
    days, hours, minutes, seconds = (int(part or 0) for part in clock.groups())
    return float(((days * 24 + hours) * 60 + minutes) * 60 + seconds)


def _grams(footer: str, name: str, extruders: set[str]) -> tuple[float, float]:
    match = _GRAMS.search(footer)
    try:
        grams = [float(text) for text in match[1].split(",")] if match else []
    except ValueError:
        grams = []
    # Only extruders that were used are listed.
    if len(grams) == 1 and len(extruders) == 1:
        grams = [grams[0] if number in extruders else 0.0 for number in ("1", "2")]
    if len(grams) != 2 or not all(math.isfinite(g) and g >= 0 for g in grams) or not sum(grams) > 0:
        raise SliceError(f"the G-code of {name} does not say how much it uses of each filament")
    return grams[0], grams[1]


def _warnings(spoken: Sequence[str]) -> tuple[str, ...]:
    found = []
    for line in spoken:
        match = _LOG.match(line)
        text = match[2] if match else (spoken_of[1] if (spoken_of := _SPOKEN.match(line)) else "")
        if text.strip():
            found.append(" ".join(text.split()))
    return tuple(dict.fromkeys(found))


def _last(spoken: Sequence[str]) -> str:
    """The last thing a program said that is no progress report, in one short line."""
    said = [line for line in spoken if not re.match(r"\d+%?\s*=>", line) and "[trace]" not in line]
    return " ".join(said[-1].split())[:300] if said else "it did not say why"


def _by_material(grams: tuple[float, float]) -> dict[str, float]:
    return {"rigid": round(grams[0], 2), "soft": round(grams[1], 2)}
