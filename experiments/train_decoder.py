"""`bodyplan train-decoder`: train the learned decoder, measure it, and keep the better weights."""

from __future__ import annotations

import argparse
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import DONE, INTERRUPTED, BadInput, emit, make_folder, say
from experiments.run_folder import locked, terminable

if TYPE_CHECKING:
    from experiments.decoder_config import TrainDecoder
    from experiments.decoder_folder import Mark

HELP = "train the learned decoder on bodies drawn without end, measure it, and keep the better weights"

STORY = """
The same program runs on a CPU and on a GPU; experiments/configs has decoder_tiny.toml (seconds), decoder_cpu.toml
(an hour on two cores) and decoder_gpu.toml (meant for half an hour of an H200).

examples:
  bodyplan train-decoder experiments/configs/decoder_cpu.toml --out runs/decoder
  bodyplan train-decoder experiments/configs/decoder_cpu.toml --out runs/decoder --resume     after Ctrl-C or a crash
  bodyplan train-decoder experiments/configs/decoder_gpu.toml --resume --seconds 540          in sittings: again while
                                                                                              the status is 3
  bodyplan sample --decoder runs/decoder/vae.safetensors --out bodies                         look at what it learned
  bodyplan train-decoder experiments/configs/decoder_cpu.toml --out runs/decoder --resume --ship
  bodyplan train-decoder --evaluate                                       the model card of the weights of the package

the folder:
  vae.safetensors    the weights (the running mean of all that were passed through)
  curve.csv, .png    losses and held-out figures against the seconds spent; tensorboard --logdir DIR/events has more
  result.json        the figures of the closing evaluation
  checkpoint/        where to go on; replaced as a whole, so that a crash costs checkpoint_every steps at most

exit status: 0 trained and measured, 2 bad input or a training that diverged, 3 interrupted by Ctrl-C or by --seconds:
everything is saved, and the command that goes on is printed.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = STORY
    parser.add_argument("config", type=Path, nargs="?", metavar="CONFIG.toml", help="what to train; none: --evaluate")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (runs/ and the name of the configuration)")
    parser.add_argument("--resume", action="store_true", help="go on with the training in DIR if there is one")
    parser.add_argument("--seconds", type=positive, metavar="S",
                        help="stop after S seconds with a checkpoint; the closing evaluation is begun in a sitting "
                             "that has the time for it, or finds all else done")  # fmt: skip
    parser.add_argument("--evaluate", action="store_true",
                        help="write the model card, decoder/MODEL_CARD.md for the weights of the package, else beside "
                             "the weights: every figure with its n and seed, and pictures")  # fmt: skip
    parser.add_argument("--weights", type=Path, metavar="FILE",
                        help="with --evaluate and no CONFIG: these weights instead of the package's")  # fmt: skip
    parser.add_argument("--ship", action="store_true",
                        help="put the trained weights into the package if their figures are better")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Train, or only measure; status 3 if there is more to do."""
    if args.config is None:
        return _only_measure(args)
    if args.weights is not None:
        raise BadInput('--weights names weights to measure without training; leave CONFIG.toml away, or --weights '
                       '(a training starts from what its key "start" says)')  # fmt: skip
    from experiments.decoder_config import load_decoder_config

    config = load_decoder_config(args.config)
    folder = args.out or Path("runs") / args.config.stem
    again = _again(args, folder)
    try:
        result = _train(config, folder, args, again)
    except KeyboardInterrupt:
        say(f"\nbodyplan: interrupted; the last checkpoint is kept. Go on with: {again}")
        return INTERRUPTED
    if args.json:
        emit(result)
    return DONE if result["finished"] else INTERRUPTED


def _train(config: TrainDecoder, folder: Path, args: argparse.Namespace, again: str) -> dict[str, Any]:
    """Train as far as time allows; a complete training is written down, measured and, if asked for, shipped."""
    from experiments.decoder_folder import check_training_folder
    from experiments.decoder_result import HeldOut, conclude, write_model_card
    from experiments.decoder_ship import ship
    from experiments.decoder_training import stoppable, train

    make_folder(folder)
    with locked(folder):
        check_training_folder(config, folder, args.resume)
        with stoppable(args.seconds) as stop:
            held_out = HeldOut(config)
            training, mark = train(config, folder, stop, held_out)
            result = _told(config, folder, mark)
            if mark.step < config.last_step:
                why = "stopped" if stop.signalled else f"{args.seconds:g} s are over"
                where = f"step {mark.step} of {config.last_step}"
                say(f"bodyplan: {why} at {where}; everything is saved. Go on with: {again}")
                return result
            if stop.signalled or held_out.closing_seconds(1 + args.ship) > max(stop.left(), 0.0):
                say(f"bodyplan: trained; what is left is to measure the weights. Go on with: {again}")
                return result
        with terminable():
            told, evaluation = conclude(config, folder, training, mark)
            result |= told
            if args.ship:
                result["shipped"] = ship(config, folder)
            if args.evaluate:
                result["card"] = str(write_model_card(config, folder, evaluation))
        result["finished"] = True
    return result


def _told(config: TrainDecoder, folder: Path, mark: Mark) -> dict[str, Any]:
    """How far it is, as JSON."""
    return {
        "kind": config.kind,
        "out": str(folder),
        "finished": False,
        "step": mark.step,
        "steps": config.last_step,
        "seconds": round(mark.seconds, 1),
        "bodies": mark.bodies,
        "skipped": mark.skipped,
        "device": mark.device,
        "precision": mark.precision,
        "start": mark.start,
    }


def _only_measure(args: argparse.Namespace) -> int:
    if not args.evaluate:
        raise BadInput("nothing to do: give a CONFIG.toml to train (see experiments/configs), or --evaluate to measure "
                       "the weights of the package")  # fmt: skip
    for name in ("resume", "seconds", "ship"):
        if getattr(args, name):
            raise BadInput(f"--{name} belongs to a training; give its CONFIG.toml, or leave --{name} away")
    from decoder.weights import SHIPPED
    from experiments.decoder_result import evaluate_only

    try:
        result = evaluate_only(args.weights or SHIPPED, args.out)
    except KeyboardInterrupt:
        say("\nbodyplan: interrupted; nothing was written. Give the same command again")
        return INTERRUPTED
    if args.json:
        emit(result)
    return DONE


def _again(args: argparse.Namespace, folder: Path) -> str:
    """The command that goes on."""
    words = ["bodyplan", "train-decoder", str(args.config), "--out", str(folder), "--resume"]
    words += [] if args.seconds is None else ["--seconds", f"{args.seconds:g}"]
    return shlex.join(words + [f"--{name}" for name in ("evaluate", "ship", "json") if getattr(args, name)])


def positive(text: str) -> float:
    """Read a command-line duration [s]."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is out of bounds; it must be a number of seconds above 0")
    return value
