"""Whether the package takes the weights of a decoder training."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.decoder_config import TrainDecoder
from experiments.decoder_folder import WEIGHTS
from experiments.decoder_result import codec_of, measure
from experiments.output import say
from experiments.run_folder import RESULT

if TYPE_CHECKING:
    from decoder.figures import Bound


def ship(config: TrainDecoder, folder: Path) -> dict[str, Any]:
    """Put the trained weights into the package, unless those that are there are at least as good.

    Returns:
        `kept`, which of the two the package has now, and `why`.

    Raises:
        OSError: if the package cannot be written.
    """
    from decoder.figures import better
    from decoder.weights import DIGEST, SHIPPED, load_weights

    path = folder / WEIGHTS
    mine = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    if not SHIPPED.exists():
        told = {"kept": "new", "why": "the package had none"}
    else:
        weights = load_weights(SHIPPED)
        if weights.sha256 == mine["sha256"]:
            told = {"kept": "new", "why": "the package has these very weights already"}
        else:
            say("measuring the weights of the package")
            found = measure(codec_of(weights), config.evaluation.bodies, config.evaluation.samples)
            new, old = _bounds(mine["goals"]), found.bounds()
            wins = better(new, old)
            told = {"kept": "new" if wins else "old", "why": _why(new, old)}
    if told["kept"] == "new":
        SHIPPED.parent.mkdir(exist_ok=True)
        _replace(SHIPPED, lambda partial: shutil.copyfile(path, partial))
        _replace(DIGEST, lambda partial: partial.write_text(f"{mine['sha256']}  {SHIPPED.name}\n", "ascii"))
    said = "the package has the new weights" if told["kept"] == "new" else "the package keeps its weights"
    say(f"{said}: {told['why']}")
    return told


def _bounds(goals: list[dict[str, Any]]) -> tuple[Bound, ...]:
    """Goals as they were before they were written down."""
    from decoder.figures import Bound

    rows = [{key: value for key, value in goal.items() if key != "reached"} for goal in goals]
    return tuple(Bound(**{**row, "value": float("nan") if row["value"] is None else row["value"]}) for row in rows)


def _why(new: tuple[Bound, ...], old: tuple[Bound, ...]) -> str:
    """Both merits, and the figure on which they differ most."""
    from decoder.figures import merit

    count = sum(bound.weighed for bound in new)
    ours, theirs = merit(new), merit(old)
    pairs = [(a, b) for a, b in zip(new, old, strict=True) if a.weighed]
    a, b = max(pairs, key=lambda pair: abs(pair[0].ratio - pair[1].ratio))
    goals = f"{ours[0]:.4f} against {theirs[0]:.4f} of {count} goals, {ours[1]:.4f} against {theirs[1]:.4f} with excess"
    return f"{goals}; they differ most in {a.name}, {a.value:.4g}{a.unit} against {b.value:.4g}{b.unit}"


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    """Replace a file as a whole."""
    partial = path.with_name(path.name + ".partial")
    write(partial)
    os.replace(partial, path)
