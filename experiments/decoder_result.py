"""What came of a decoder training: its figures along the way and at the end, and whether the package takes it."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.decoder_config import CURVE_SEED, TrainDecoder
from experiments.decoder_folder import CURVE_PICTURE, WEIGHTS, Mark
from experiments.output import BadInput, progress, say
from experiments.run_folder import RESULT, write_json

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from decoder.evaluation import Evaluation
    from decoder.figures import Bound
    from decoder.reconstruction import Codec
    from decoder.training import Training
    from decoder.weights import Weights

CURVE_PAIRS = 1  # of latents to interpolate between, for one row of the curve
_JUDGING = 5  # times as long as decoding it takes to judge whether a body can be built
PAIRS, WALK = 24, 101  # the same for the closing evaluation, and bodies per pair
CARD, PICTURES = "MODEL_CARD.md", "pictures"


class HeldOut:
    """Figures of the present weights on a few held-out bodies: a row of the curve. Others than those of the closing
    evaluation, so that whoever looks at the curve to choose a setting does not choose by the final figures.
    """  # fmt: skip

    def __init__(self, config: TrainDecoder) -> None:
        """Draw nothing yet."""
        self.config = config
        self.seconds_per_body: float | None = None

    @cached_property
    def bodies(self) -> list[VoxelDesign]:
        """The held-out bodies, drawn once."""
        from decoder.synthetic import sample_designs

        return sample_designs(self.config.evaluate_bodies, CURVE_SEED)

    def __call__(self, training: Training) -> dict[str, float]:
        """Measure the weights as they would be kept now."""
        from decoder.evaluation import evaluate
        from decoder.weights import Weights

        n, bodies = self.config.evaluate_bodies, self.bodies
        begun = time.perf_counter()
        codec = codec_of(Weights(training.weights(), "", {}))
        found = evaluate(codec, bodies, prior_n=n, pairs=CURVE_PAIRS, seed=CURVE_SEED)
        self.seconds_per_body = (time.perf_counter() - begun) / _load(n, n, CURVE_PAIRS)
        return figures_of(found)

    def closing_seconds(self, sets: int) -> float:
        """About how long the closing evaluation will take for so many sets of weights; 0 if nothing was measured yet.

        So a sitting that finds the training done always measures, however short it is.
        """
        from decoder.prior import JUDGED

        closing = self.config.evaluation
        judged = _JUDGING * min(closing.samples, JUDGED)
        return (self.seconds_per_body or 0.0) * sets * (judged + _load(closing.bodies, closing.samples, PAIRS))


def codec_of(weights: Weights) -> Codec:
    """Encoder and decoder of some weights.

    Raises:
        BadInput: if they are not of this architecture.
    """
    from decoder.vae import VaeDecoder
    from decoder.weights import WeightsError

    try:
        return VaeDecoder(weights)
    except WeightsError as error:
        raise BadInput(str(error)) from None


def figures_of(found: Evaluation) -> dict[str, float]:
    """Every figure that has a goal, and some that explain them, by a name that fits a column."""
    r, p, i = found.reconstruction, found.prior, found.interpolation
    return {
        "body_iou": r.body_iou.value,
        "bone_iou": r.bone_iou.value,
        "segment_iou": r.segment_iou.value,
        "segment_count_exact": r.segment_count.value,
        "same_tree": r.same_tree.value,
        "joint_recall": r.joint_recall.value,
        "joint_precision": r.joint_precision.value,
        "axis_error_deg": r.axis_error.value,
        "range_error_deg": r.range_error.value,
        "latent_power": r.latent_power.value,
        "prior_one_tree": p.one_tree.value,
        "prior_buildable": p.passing.value,
        "prior_joint_counts": float(len(p.tree_joint_counts)),
        "prior_tree_shapes": float(len(p.tree_shapes)),
        "step_axis_p95_deg": i.axis.value,
        "step_same_tree": i.same_tree.value,
    }


def conclude(
    config: TrainDecoder, folder: Path, training: Training, mark: Mark
) -> tuple[dict[str, Any], Evaluation | None]:
    """Write the weights of a complete training, measure them, write the result; what is there already stays.

    Returns:
        the result, and all figures unless the result was there already.

    Raises:
        OSError: if the folder cannot be written.
    """
    from decoder.weights import load_weights, save_weights

    path = folder / WEIGHTS
    digest = save_weights(path, training.weights(), about_of(config, mark))
    result, found = _measured(config, folder, digest), None
    if result is None:
        say(f"measuring {path}")
        found = measure(codec_of(load_weights(path)), config.evaluation.bodies, config.evaluation.samples)
        result = _result(path, digest, found.bounds(), figures_of(found), config)
        write_json(folder / RESULT, result)
    say(_summary(result))
    return result, found


def measure(codec: Codec, bodies: int, samples: int) -> Evaluation:
    """The closing evaluation: always the same bodies and draws, so that any two sets of weights can be compared."""
    from experiments.decoder_card import held_out_bodies
    from experiments.decoder_card import measure as evaluated

    return evaluated(codec, held_out_bodies(bodies), None, prior_n=samples, pairs=PAIRS, watch=progress)


def write_model_card(config: TrainDecoder, folder: Path, evaluation: Evaluation | None) -> Path:
    """The card of a training's weights: the package's if they are the package's, else in the folder.

    What is not measured yet, is.
    """
    curve = folder / CURVE_PICTURE
    closing = config.evaluation
    return _card(
        folder / WEIGHTS, None, closing.bodies, closing.samples, curve.read_bytes() if curve.exists() else None,
        evaluation,
    )  # fmt: skip


def evaluate_only(path: Path, out: Path | None) -> dict[str, Any]:
    """Measure weights without training and write their card.

    Args:
        path: of the weights.
        out: folder for the card and its pictures; None is the package's place for its own weights, and beside them for
            any other.

    Raises:
        WeightsError: if they cannot be used.
        OSError: if the card cannot be written.
    """
    from experiments.decoder_card import PRIOR_N, N

    card = _card(path, out, N, PRIOR_N, None, None)
    return {"kind": "train-decoder", "weights": str(path), "card": str(card), "finished": True}


def _card(
    path: Path, out: Path | None, bodies: int, samples: int, curve: bytes | None, evaluation: Evaluation | None
) -> Path:
    from decoder.weights import SHIPPED, load_weights
    from experiments import decoder_card

    weights = load_weights(path)
    shipped = SHIPPED.exists() and (path.resolve() == SHIPPED or load_weights(SHIPPED).sha256 == weights.sha256)
    if out is not None or not shipped:
        folder = path.parent if out is None else out
        card, pictures, name = folder / CARD, folder / PICTURES, str(path)
    else:
        card, pictures, name = decoder_card.CARD, decoder_card.PICTURES, "vae"
    codec = codec_of(weights)
    pictures.mkdir(parents=True, exist_ok=True)
    found = decoder_card.write_card(
        codec, weights, card, pictures, name=name, evaluation=evaluation, n=bodies, prior_n=samples, curve=curve,
        watch=progress,
    )  # fmt: skip
    missed = [bound.name for bound in found.bounds() if not bound.reached]
    say(f"wrote {card}: " + (f"not reached: {', '.join(missed)}" if missed else "every goal is reached"))
    return card


def about_of(config: TrainDecoder, mark: Mark) -> dict[str, str]:
    """What the weights say about themselves; counts include the trainings that they went on from."""
    from decoder.networks import ARCHITECTURE

    return {
        "architecture": ARCHITECTURE,
        "bodies_seen": str(mark.earlier_bodies + mark.bodies),
        "steps": str(mark.earlier_steps + mark.step),
        "seconds_of_training": f"{mark.earlier_seconds + mark.seconds:.0f}",
        "trained_on": mark.machine,
        "precision": mark.precision,
        "started_from": mark.start if mark.start == "scratch" else f"weights {mark.start[:16]}",
        **{key: f"{getattr(config, key):g}" for key in ("batch", "learning_rate", "warmup", "ema")},
        "seed": str(config.seed),
    }


def _load(bodies: int, samples: int, pairs: int) -> int:
    """Bodies that an evaluation encodes or decodes."""
    return 2 * bodies + samples + WALK * pairs


def _measured(config: TrainDecoder, folder: Path, digest: str) -> dict[str, Any] | None:
    """The result that is there, if it is of these weights and as many bodies."""
    try:
        held = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    wanted = {"sha256": digest, "evaluation": _sizes(config)}
    if not isinstance(held, dict) or any(held.get(key) != value for key, value in wanted.items()):
        return None
    return held | {"weights": str(folder / WEIGHTS)}  # it may have been moved.


def _sizes(config: TrainDecoder) -> dict[str, int]:
    from decoder.evaluation import HELD_OUT_SEED

    closing = config.evaluation
    return {"bodies": closing.bodies, "samples": closing.samples, "pairs": PAIRS, "seed": HELD_OUT_SEED}


def _result(
    path: Path, digest: str, bounds: tuple[Bound, ...], figures: Mapping[str, float], config: TrainDecoder
) -> dict[str, Any]:  # fmt: skip
    return {
        "weights": str(path),
        "sha256": digest,
        "evaluation": _sizes(config),
        "figures": {name: _finite(value) for name, value in figures.items()},
        "goals": [{**asdict(bound), "value": _finite(bound.value), "reached": bound.reached} for bound in bounds],
    }


def _finite(value: float) -> float | None:
    """JSON has no word for a number that is not finite."""
    return value if abs(value) < float("inf") else None


def _summary(result: Mapping[str, Any]) -> str:
    """The goals in a table, and what to do with the weights."""
    rows = []
    for goal in result["goals"]:
        value = "nothing" if goal["value"] is None else f"{goal['value']:.4g}{goal['unit']}"
        mark = "reached" if goal["reached"] else "not reached"
        rows.append(f"  {goal['name']:44} {value:>10}   {goal['direction']} {goal['goal']:g}{goal['unit']}, {mark}")
    path = result["weights"]
    return "\n".join([*rows, f"  use them by --decoder {path}, or put them into the package by --resume --ship"])
