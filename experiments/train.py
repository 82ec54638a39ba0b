"""`bodyplan train`: a policy for a robot, by reinforcement learning on its twin."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import (
    DEFAULT_SOLVER,
    DONE,
    INFEASIBLE,
    INTERRUPTED,
    SOLVERS,
    BadInput,
    emit,
    make_folder,
    say,
    seed,
)
from experiments.run_folder import CHECKPOINT, cores, locked, terminable, worker_count

if TYPE_CHECKING:
    from experiments.policy_config import Policy

HELP = "train a policy for a blueprint by reinforcement learning: a bundle that simulate and deploy take"

STORY = """
Episodes of the robot's twin differ in latency, gains, friction, masses, skin and sensor errors, so that the policy
works on the robot that is built. Open-loop gaits, slow and quick ones, are searched first, and made to hold on many
such robots at once. The best of them is what a policy then learns to correct. "Forward" is not defined for a
free-form body: it is that gait's direction. Where no gait is quick enough, free policies along the direction of the
first gait and the opposite one race against it, and the training goes on from the winner. Faster than --pace costs
reward, so that all of these robots go about as fast. The best policy so far is kept, be it the gait as it is, judged
without exploration: by the speed that is left at the worst end of all ranges, on sprung pads and on flexible skin,
and by falls.

examples:
  bodyplan train robot --out runs/walk                      a blueprint folder of `bodyplan build`, in some minutes
  bodyplan train robot --out runs/walk --resume             after Ctrl-C or a crash; the same bytes as uninterrupted
  bodyplan train experiments/examples/tripod.vox --out runs/tripod          a design: it is built first
  bodyplan simulate robot --policy runs/walk --video walk.mp4
  bodyplan deploy runs/walk --bus virtual --dry-run

the folder is a policy bundle (bundle.json, robot.xml, meshes/) and holds:
  result.json        what was measured on the twin: speed, falls in randomised episodes, torques, warnings
  behaviour.html     how it moves: gait diagram, motors against their limits, the film
  walk.mp4, .png     a film and a strip of moments
  events/            curves for `tensorboard --logdir`
  config.toml        what was asked; `bodyplan run` takes it, too
  checkpoint/        where to go on, one file, replaced after every chunk

exit status: 0 trained, 1 the design cannot be built or its physics explodes, 2 bad input, 3 interrupted: everything up
to the last chunk is saved, and the command that goes on is printed.
"""

FLAGS = ("solver", "steps", "starts", "seed", "task", "pace", "history", "pads", "terrain", "film")
TASKS = ("speed", "command", "stand", "recover")
TERRAINS = ("flat", "rough", "potholes", "slope", "steps")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = STORY
    parser.add_argument("robot", type=Path, metavar="BLUEPRINT", help="a blueprint folder, its robot.xml, or a design")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the policy bundle")
    parser.add_argument("--solver", choices=SOLVERS, help=f"by which rules a design is built ({DEFAULT_SOLVER})")
    parser.add_argument("--steps", type=int, help="control periods of experience after the race (400000)")
    parser.add_argument("--starts", type=int, help="how many starts race: a gait, free headings (3)")
    parser.add_argument("--seed", type=seed, help="of everything random (0)")
    parser.add_argument("--task", choices=TASKS, help="what is learned (speed)")
    parser.add_argument("--pace", type=float, metavar="V", help="how fast it is to be (0.65 body lengths a second)")
    parser.add_argument("--history", type=int, metavar="N", help="frames that the policy sees (1)")
    parser.add_argument("--pads", type=float, metavar="SHARE", help="of the robots on sprung pads (0.35)")
    parser.add_argument("--terrain", choices=TERRAINS, help="what it walks on (flat)")
    parser.add_argument("--no-randomise", action="store_true", help="train on the twin exactly as it is")
    parser.add_argument("--film", type=float, metavar="S", help="length of the film, 0 for none (10)")
    parser.add_argument("--workers", type=worker_count, help="processes and threads; changes no result (one per core)")
    parser.add_argument("--resume", action="store_true", help="go on with the training in DIR if there is one")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Train; status 1 if the robot cannot be built or lives in no simulator, 3 if it was interrupted."""
    from experiments.toml_document import checked

    asked = {name: value for name in FLAGS if (value := getattr(args, name)) is not None}
    if args.no_randomise:
        asked["randomise"] = False
    if args.solver is not None and (args.robot.is_dir() or args.robot.suffix == ".xml"):
        raise BadInput(f"--solver {args.solver} is for a design; {args.robot} is built already: leave it out")
    from experiments.policy_config import Policy

    document = {"kind": "policy", "robot": str(args.robot.resolve()), **asked}
    config = checked(document, Policy, "bodyplan train")
    again = shlex.join(["bodyplan", "train", str(args.robot), *_again(args), "--out", str(args.out), "--resume"])
    return run_training(config, args.out, args.resume, args.workers, again, args.json)


def run_training(
    config: Policy, folder: Path, resume: bool, workers: int | None, again: str, as_json: bool = False
) -> int:
    """Train as a configuration says, in a folder.

    Args:
        config: what to train.
        folder: of the bundle and everything beside it.
        resume: go on if there is something.
        workers: processes and threads; None for one per core.
        again: the command that goes on after an interruption.
        as_json: print the result as one document.

    Raises:
        BadInput: if the folder holds another training, or one and `resume` is not set, or the robot is unusable.
        OSError: if something cannot be read or written.
    """
    from experiments.policy_start import Impossible
    from experiments.policy_training import STATE, train

    make_folder(folder)
    count = max(1, cores() if workers is None else workers)
    try:
        with terminable(), locked(folder):
            result = train(config, folder, resume, count)
    except KeyboardInterrupt:
        kept = "the last chunk is kept" if (folder / CHECKPOINT / STATE).exists() else "nothing was learned yet"
        say(f"\nbodyplan: interrupted; {kept}. Go on with: {again}")
        return INTERRUPTED
    except Impossible as error:
        say(f"bodyplan: {error}")
        return INFEASIBLE
    if as_json:
        emit(result)
    else:
        _tell(folder, result)
    return DONE


def _tell(folder: Path, result: dict[str, Any]) -> None:
    walked, trials = result["behaviour"], result["randomised"]
    lengths = walked["speed_m_s"] / walked["body_length_m"]
    print(f"{folder}: {walked['speed_m_s']:.2f} m/s on the twin, {lengths:.2f} body lengths a second over "
          f"{walked['seconds']:.0f} s, heading {result['heading_rad']:.2f} rad")  # fmt: skip
    print(f"{trials['episodes'] - trials['falls']} of {trials['episodes']} randomised episodes without a fall, "
          f"{trials['mean_speed_m_s']:.2f} m/s on average")  # fmt: skip
    for warning in result["warnings"]:
        print(f"warning: {warning}")
    print(f"rehearse it: bodyplan deploy {folder} --bus virtual --dry-run")


def _again(args: argparse.Namespace) -> list[str]:
    """The flags that say what is trained, as they were given."""
    words: list[str] = []
    for name in (*FLAGS, "workers"):
        value = getattr(args, name)
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    return [*words, "--no-randomise"] if args.no_randomise else words
