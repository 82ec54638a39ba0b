"""The folder of a decoder training: checkpoints that are whole or not there, and the curve."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from experiments.decoder_config import FREE, TrainDecoder, load_decoder_config
from experiments.output import BadInput, say
from experiments.run_folder import CHECKPOINT, CONFIG, RESULT, RUN_FILES, STUDY_RESULT, write_json

WEIGHTS, CURVE, CURVE_PICTURE, EVENTS = "vae.safetensors", "curve.csv", "curve.png", "events"
MARK = "checkpoint.json"
FORMAT, VERSION = "bodyplan-decoder-training", 1


@dataclass(frozen=True, slots=True)
class Mark:
    """What is known about a training beside the state of its network.

    Attributes:
        step: steps of the optimiser that are done.
        seconds: of training, evaluation not counted, over all sittings [s].
        bodies: that were seen.
        device: "cpu" or "cuda".
        precision: "fp32" or "bf16".
        threads: on the CPU.
        machine: on what, in words.
        start: "scratch", or the SHA-256 of the weights it went on from.
        skipped: steps that were skipped because a number was not finite.
        earlier_steps: steps, bodies and seconds that the weights it went on from had behind them.
        earlier_bodies: see there.
        earlier_seconds: see there.
    """

    step: int
    seconds: float
    bodies: int
    device: str
    precision: str
    threads: int
    machine: str
    start: str
    skipped: int = 0
    earlier_steps: int = 0
    earlier_bodies: int = 0
    earlier_seconds: float = 0.0


def check_training_folder(config: TrainDecoder, folder: Path, resume: bool) -> None:
    """Refuse a folder that something else was written to, or this very training if it is not to be resumed.

    Raises:
        BadInput: naming what is there and what to do.
        OSError: if a file cannot be read.
    """
    from experiments.config import differences

    other = next((name for name in (*RUN_FILES.values(), STUDY_RESULT) if (folder / name).exists()), None)
    if other is not None:
        raise BadInput(f"{folder} holds {other} of another run; choose another --out")
    if not (folder / CONFIG).exists():
        held = next((name for name in (CHECKPOINT, WEIGHTS, RESULT) if (folder / name).exists()), None)
        if held is not None:
            raise BadInput(f"{folder} holds {held} of another run, but no {CONFIG}; choose another --out")
        return
    try:
        then = load_decoder_config(folder / CONFIG)
    except BadInput as error:
        raise BadInput(f"{folder} may hold another run, choose another --out: {error}") from None
    changes = differences(then, config, FREE)
    if changes:
        raise BadInput(
            f"{folder} was made with another configuration: {'; '.join(changes)}; "
            f"resume with {folder / CONFIG}, or choose another --out"
        )
    if not resume and (folder / CHECKPOINT / MARK).exists():
        raise BadInput(f"{folder} holds a training already; go on with it by --resume, or choose another --out")


def write_checkpoint(folder: Path, save: Callable[[Path], None], mark: Mark) -> None:
    """Replace the checkpoint. A crash at any moment leaves the old one or the new one, never a mixture.

    Args:
        folder: of the training.
        save: writes the state of the network to a path.
        mark: the rest.

    Raises:
        OSError: if the folder cannot be written; the checkpoint before is then still there.
    """
    place = folder / CHECKPOINT
    place.mkdir(exist_ok=True)
    path = place / f"step_{mark.step:09d}.state"
    partial = path.with_name(path.name + ".partial")
    save(partial)
    digest = _digest(partial)
    with partial.open("rb") as file:
        os.fsync(file.fileno())
    os.replace(partial, path)
    head = {"format": FORMAT, "version": VERSION, "file": path.name, "sha256": digest}
    write_json(place / MARK, {**head, **asdict(mark)})
    for old in place.iterdir():
        if old.name not in (path.name, MARK):
            old.unlink()


def read_checkpoint(folder: Path) -> tuple[Path, Mark] | None:
    """The file with the state of the network, and the rest; None if no checkpoint was written yet.

    Raises:
        BadInput: if what is there is damaged or foreign.
        OSError: if a file cannot be read.
    """
    place = folder / CHECKPOINT
    if not (place / MARK).exists():
        return None
    remedy = f"restore it, or remove {place} to begin again"
    try:
        held = json.loads((place / MARK).read_text(encoding="utf-8"))
    except ValueError:
        raise BadInput(f"{place / MARK} is damaged; {remedy}") from None
    if not isinstance(held, dict) or held.get("format") != FORMAT:
        raise BadInput(f"{place / MARK} is not the mark of a decoder training; {remedy}")
    if held.get("version") != VERSION:
        raise BadInput(f"{place / MARK} has version {held.get('version')}, this program reads {VERSION}; {remedy}")
    name = held.get("file")
    if not isinstance(name, str) or Path(name).name != name:
        raise BadInput(f"{place / MARK} is damaged: it names no file; {remedy}")
    if not (place / name).is_file():
        raise BadInput(f"checkpoint {place / name} is missing; {remedy}")
    if _digest(place / name) != held.get("sha256"):
        raise BadInput(f"checkpoint {place / name} is damaged: its SHA-256 is not the recorded one; {remedy}")
    return place / name, _mark(held, f"{place / MARK} is damaged", remedy)


def _mark(held: Mapping[str, Any], trouble: str, remedy: str) -> Mark:
    kinds: dict[str, tuple[type, ...]] = {"int": (int,), "float": (int, float), "str": (str,)}
    found: dict[str, Any] = {field.name: held.get(field.name) for field in fields(Mark)}
    for field in fields(Mark):
        value = found[field.name]
        fits = isinstance(value, kinds[str(field.type)]) and not isinstance(value, bool)
        if not fits or (isinstance(value, int | float) and not 0 <= value < math.inf):
            raise BadInput(f"{trouble}: {field.name} is {value!r}; {remedy}")
    return Mark(**found)


class Curve:
    """Rows of `curve.csv`: step, seconds of training, bodies seen, then every figure; the file is always whole."""

    def __init__(self, path: Path, step: int) -> None:
        """Read what is there up to a step; rows beyond it will be made again.

        Raises:
            BadInput: if the file is no curve.
            OSError: if it cannot be read.
        """
        self.path = path
        self.rows = [row for row in read_curve(path) if row["step"] <= step] if path.exists() else []

    def has(self, step: int) -> bool:
        """Whether there is a row of that step."""
        return any(row["step"] == step for row in self.rows)

    def add(self, row: Mapping[str, float]) -> None:
        """Write one more row.

        Raises:
            OSError: if the file cannot be written.
        """
        self.rows.append(dict(row))
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        text = io.StringIO()
        writer = csv.DictWriter(text, names, lineterminator="\n")
        writer.writeheader()
        for each in self.rows:
            writer.writerow({name: f"{value:.9g}" for name, value in each.items() if math.isfinite(value)})
        partial = self.path.with_name(self.path.name + ".partial")
        partial.write_text(text.getvalue(), encoding="utf-8")
        os.replace(partial, self.path)

    def column(self, name: str) -> list[float]:
        """One figure over all rows, NaN where a row has none."""
        return [row.get(name, math.nan) for row in self.rows]

    def draw(self, path: Path) -> None:
        """Write the picture of every figure against the compute spent; none without two rows."""
        from analysis.plots import training_curve

        if len(self.rows) < 2:
            return
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        shown = {name: self.column(name) for name in names if name not in ("step", "seconds", "bodies")}
        path.write_bytes(training_curve(self.column("seconds"), self.column("bodies"), shown))


def read_curve(path: Path) -> list[dict[str, float]]:
    """Rows of a curve, empty cells left out.

    Raises:
        BadInput: if the file is no curve.
        OSError: if it cannot be read.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [{k: float(v) for k, v in row.items() if v not in ("", None)} for row in csv.DictReader(file)]
    except (ValueError, TypeError, AttributeError, csv.Error):
        raise BadInput(f"{path} is damaged; remove it, and the curve goes on without its past") from None
    if any(not {"step", "seconds", "bodies"} <= set(row) for row in rows):
        raise BadInput(f"{path} is no curve of a training; remove it, and the curve goes on without its past")
    return rows


def tell_differences(then: Mark, now: Mark) -> None:
    """Say what has changed since the last sitting and may change how sums are rounded."""
    changed = [f"{name} was {getattr(then, name)} and is now {getattr(now, name)}"
               for name in ("device", "precision", "threads") if getattr(then, name) != getattr(now, name)]  # fmt: skip
    if changed:
        say(f"note: {'; '.join(changed)}: what follows differs by rounding from what it would have been")


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
