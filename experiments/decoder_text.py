"""The text of a model card, from what was measured."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from decoder.figures import Figure
from decoder.kinematics import REACH, WHOLE
from decoder.latent import LATENT_DIM
from decoder.parts import BONES_APART, HINGES_APART

if TYPE_CHECKING:
    from decoder.evaluation import Evaluation
    from decoder.population import Population
    from decoder.reconstruction import Reconstruction

NONE = "–"  # where nothing was measured
MOST_SHAPES = 12  # tree shapes that the card lists
CAPTIONS = {
    "reconstructions": "The first eight held-out bodies, each above its reconstruction.",
    "samples": "24 samples of the prior, not picked.",
    "interpolations": "From one sample of the prior to another, in six steps along the arc between them.",
    "curve": "Losses and held-out figures against the time spent on training.",
}


@dataclass(frozen=True)
class Card:
    """Everything a card says.

    Attributes:
        evaluation: with its cost.
        held_out: what the held-out bodies are like.
        foreign: other bodies by what they are: what they are like, and how they were reconstructed.
        sha256: of the weights' file.
        numbers: in the weights.
        about: what the weights say of their training.
        pictures: files; the stem tells which.
        folder: where the card lies.
    """

    evaluation: Evaluation
    held_out: Population
    foreign: Mapping[str, tuple[Population, Reconstruction]]
    sha256: str
    numbers: int
    about: Mapping[str, str]
    pictures: tuple[Path, ...]
    folder: Path


def card_text(card: Card) -> str:
    """The card as Markdown; the same card gives the same text."""
    evaluation = card.evaluation
    prior, interpolation = evaluation.prior, evaluation.interpolation
    sections = [
        "# Model card: the learned decoder",
        f"{LATENT_DIM} numbers in, a jointed body on the 64 x 64 x 64 grid out, and back. Inference needs numpy only. "
        f"The weights hold {card.numbers:,} numbers; SHA-256 of their file: `{card.sha256 or 'not recorded'}`.",
        "Written by `bodyplan train-decoder --evaluate`, which measures everything below anew. Brackets hold 95 % "
        "intervals: Wilson for shares, else bootstrap over bodies (over pairs for interpolation).",
        "## Goals",
        _goals(evaluation),
        f"## Reconstruction\n\n{evaluation.reconstruction.n} held-out bodies, seed {evaluation.reconstruction.seed}, "
        "encoded and decoded.",
        _reconstruction(evaluation.reconstruction),
        _picture(card, "reconstructions"),
        f"## Samples of the prior\n\n{prior.n} latents z ~ N(0, I), seed {prior.seed}.",
        _prior(evaluation),
        _picture(card, "samples"),
        f"## Interpolation\n\n{interpolation.pairs} pairs of latents from the prior, seed {interpolation.seed}, 100 "
        f"equal steps along the arc between each pair: {interpolation.steps} steps.",
        _interpolation(evaluation),
        _picture(card, "interpolations"),
        "## Cost",
        _cost(evaluation),
        "## Training",
        _about(card.about),
        _picture(card, "curve"),
        "## Training distribution",
        "Bodies drawn without end by `decoder/synthetic.py`: a torso with one to five limbs, chains or forks, mirrored "
        "or not; elliptic and free-form bones, bends, skin over bone, a margin around everything. The held-out "
        "bodies are drawn by the same law from a seed that no training uses. Bodies are dropped whose hinges are less "
        f"than {HINGES_APART:g} voxels apart, too near for two motors, or whose bones nearly touch without a common "
        f"hinge (less than {BONES_APART:g} voxels).",
        _populations({"held-out bodies": card.held_out, **{name: p for name, (p, _) in card.foreign.items()}}),
        "## Bodies of other kinds",
        "Encoded and decoded like the held-out bodies, though no training has seen their kind.",
        _foreign(card),
        "## Known limits",
        _limits(card),
        "## How it was measured",
        _definitions(),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def _goals(evaluation: Evaluation) -> str:
    bounds = evaluation.bounds()
    rows = [
        [b.name, f"{b.direction} {_amount(b.goal, b.unit)}", _amount(b.value, b.unit), str(b.n),
         "yes" if b.reached else "**no**"]
        for b in bounds
    ]  # fmt: skip
    table = _table(["figure", "goal", "measured", "n", "reached"], rows)
    return f"{table}\n\n{sum(b.reached for b in bounds)} of {len(bounds)} goals are reached."


def _reconstruction(r: Reconstruction) -> str:
    rows = [
        _row("body IoU", r.body_iou),
        _row("bone IoU", r.bone_iou),
        _row("IoU per segment", r.segment_iou),
        _row("segment count exact", r.segment_count, "%"),
        _row("same tree", r.same_tree, "%"),
        _row("joints found within 2 voxels (recall)", r.joint_recall, "%"),
        _row("joints that are right (precision)", r.joint_precision, "%"),
        _row("distance of found joints, median", r.joint_distance, "voxels"),
        _row("axis error, median", r.axis_error, "°"),
        _row("axis error, 95 % quantile", r.axis_error_p95, "°"),
        _row("error of a range's end, mean", r.range_error, "°"),
        _row("mean square of a latent's number (1 as in the prior)", r.latent_power),
    ]
    return _table(["figure", "value", "95 % interval", "n"], rows)


def _prior(evaluation: Evaluation) -> str:
    prior = evaluation.prior
    rows = [_row("one connected tree with at least 2 joints", prior.one_tree, "%")]
    if prior.passing.n:
        rows.append(_row("can be built, by the fast verdict of the paper's rules", prior.passing, "%"))
    counts = sorted({*prior.joint_counts, *prior.tree_joint_counts})
    histogram = [
        ["all"] + [str(prior.joint_counts.get(k, 0)) for k in counts],
        ["connected trees"] + [str(prior.tree_joint_counts.get(k, 0)) for k in counts],
    ]
    shapes = list(prior.tree_shapes.items())
    listed = ", ".join(f"`{shape}` {count}" for shape, count in shapes[:MOST_SHAPES])
    rest = f", and {len(shapes) - MOST_SHAPES} others" if len(shapes) > MOST_SHAPES else ""
    return "\n\n".join([
        _table(["figure", "value", "95 % interval", "n"], rows),
        _table(["joints", *map(str, counts)], histogram),
        f"{len(prior.tree_joint_counts)} distinct joint counts and {len(shapes)} distinct tree shapes among the "
        f"connected trees. The commonest, one pair of brackets for each segment: {listed or NONE}{rest}.",
    ])  # fmt: skip


def _interpolation(evaluation: Evaluation) -> str:
    i = evaluation.interpolation
    rows = [
        _row("axis change of a joint per step, 95 % quantile", i.axis, "°"),
        _row("axis change of a joint per step, 99 % quantile", i.axis_p99, "°"),
        _row("displacement of a joint per step, 95 % quantile", i.position, "voxels"),
        _row("body IoU with the next step, mean", i.body_iou),
        _row("body IoU with the next step, 5 % quantile", i.body_iou_p05),
        _row("steps that keep the tree", i.same_tree, "%"),
    ]
    table = _table(["figure", "value", "95 % interval", "n"], rows)
    return f"{table}\n\n{i.changing_steps} steps change the tree; axes and positions are compared over the others."


def _cost(evaluation: Evaluation) -> str:
    c = evaluation.cost
    if c is None:
        return "Not measured."
    rows = [
        ["decode, batch 1", f"{1000 * c.single:.3g} ms"],
        ["decode, batch 32", f"{1000 * c.batched:.3g} ms a body"],
        ["encode, batch 32", f"{1000 * c.encoding:.3g} ms a body"],
        ["peak memory of a fresh process, batch 32", f"{c.peak:.0f} MiB"],
        ["same bytes in batches of 1, 3 and 32", "yes" if c.same_bytes else "**no**"],
    ]
    return f"{_table(['what', 'measured'], rows)}\n\nMedians, on {c.machine}."


def _about(about: Mapping[str, str]) -> str:
    if not about:
        return "The weights say nothing about their training."
    return _table(["what", "value"], [[key.replace("_", " "), f"{value}"] for key, value in sorted(about.items())])


def _populations(populations: Mapping[str, Population]) -> str:
    rows = [
        [name, str(p.n), ", ".join(f"{k}: {count}" for k, count in p.segments.items()), str(p.shapes),
         f"{p.extent:.0f} voxels", f"{100 * p.rigid:.0f} %"]
        for name, p in populations.items()
    ]  # fmt: skip
    return _table(["bodies", "n", "how many have so many segments", "tree shapes", "mean length", "bone"], rows)


def _foreign(card: Card) -> str:
    found = {"held-out bodies": card.evaluation.reconstruction, **{name: r for name, (_, r) in card.foreign.items()}}
    rows = []
    for name, r in found.items():
        figures = [(r.body_iou, ""), (r.bone_iou, ""), (r.segment_iou, ""), (r.segment_count, "%"),
                   (r.joint_recall, "%"), (r.axis_error, "°")]  # fmt: skip
        rows.append([name, str(r.n), *(_cell(figure, r.n, unit) for figure, unit in figures)])
    head = ["bodies", "n", "body IoU", "bone IoU", "IoU per segment", "segment count exact", "joints found",
            "axis error, median"]  # fmt: skip
    return _table(head, rows)


def _limits(card: Card) -> str:
    evaluation = card.evaluation
    missed = [b for b in evaluation.bounds() if not b.reached]
    bad = 100 * (1 - evaluation.prior.one_tree.value)
    lines = [
        *(f"Missed goal: {b.name}, {_amount(b.value, b.unit)} instead of {b.direction} {_amount(b.goal, b.unit)}."
          for b in missed),
        f"Of the prior's samples {_amount(bad, '%')} are no connected tree with two joints. The decoder does not "
        "judge: whether a body can be built is what the solvers say, here those of the paper's rules.",
        f"Bodies have at most {max(card.held_out.segments)} segments, joined by hinges into one tree. Other bodies are "
        "encoded as the nearest of that kind; the table above says how near.",
        f"{evaluation.interpolation.changing_steps} of {evaluation.interpolation.steps} steps of 1 % change the tree, "
        "and with it the body, abruptly.",
        "All figures but those of other kinds of bodies are on one synthetic distribution. They say how well it was "
        "learned, not how good its bodies are.",
        "Times and memory are those of the machine named above.",
    ]  # fmt: skip
    return "\n".join(f"- {line}" for line in lines)


def _definitions() -> str:
    lines = [
        "IoU: voxels in both over voxels in either. Body: not empty. Bone: rigid.",
        "IoU per segment: rigid segments of original and copy are paired one to one for the greatest sum of IoU; a "
        "segment left over on either side counts 0. Mean over bodies.",
        "Same tree: with segments so paired, none left over, the same pairs are linked.",
        "Joints are paired one to one within 2 voxels, most pairs first, then least distance. Recall and precision are "
        "over the joints of all bodies. The sense of an axis does not count; ranges are compared along the same axis.",
        f"One connected tree: joints link all rigid segments, rigid voxels of every linked pair have centres at most "
        f"{REACH:g} voxels apart, and at least {100 * WHOLE:.0f} % of every segment's rigid voxels form one piece "
        "(sharing a corner is enough).",
        "Tree shapes: free trees without names or root, told apart by a canonical form. Joint counts and shapes are "
        "counted among the connected trees.",
        "A step keeps the tree if segments pair up and the same pairs are linked; a joint is known by what it links.",
        "Of two sets of weights the better one has the larger sum of ratios to the goals, each capped at 1; if that is "
        "equal, the larger sum with ratios up to 2. Cost does not count.",
    ]
    return "\n".join(f"- {line}" for line in lines)


def _picture(card: Card, stem: str) -> str:
    path = next((path for path in card.pictures if path.stem == stem), None)
    if path is None:
        return ""
    address = Path(os.path.relpath(path, card.folder)).as_posix()
    return f"![{stem}]({address})\n\n{CAPTIONS[stem]}"


def _row(name: str, figure: Figure, unit: str = "") -> list[str]:
    scale = 100.0 if unit == "%" else 1.0
    return [name, _amount(scale * figure.value, unit), _interval(figure, unit), str(figure.n)]


def _cell(figure: Figure, bodies: int, unit: str = "") -> str:
    """Value and interval in one; the interval of a single body would say nothing."""
    scale = 100.0 if unit == "%" else 1.0
    value = _amount(scale * figure.value, unit)
    return f"{value} {_interval(figure, unit)}" if bodies > 1 and figure.n else value


def _interval(figure: Figure, unit: str) -> str:
    if not figure.n:
        return NONE
    scale = 100.0 if unit == "%" else 1.0
    low, high = (_amount(scale * value, unit).removesuffix(unit).strip() for value in (figure.low, figure.high))
    return f"[{low}, {high}]"


def _amount(value: float, unit: str = "") -> str:
    if math.isnan(value):
        return NONE
    if unit in ("%", "°", "voxels"):
        text = f"{value:.1f}" if unit != "voxels" else f"{value:.2f}"
    elif unit in ("MiB", "s"):
        text = f"{value:.3g}" if unit == "s" else f"{value:.0f}"
    else:
        text = f"{value:.3f}" if value != round(value) or abs(value) <= 1 else f"{value:.0f}"
    return f"{text} {unit}".strip()


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        f"| {' | '.join(cell.replace('|', '/').replace(chr(10), ' ') for cell in line)} |" for line in lines
    )
