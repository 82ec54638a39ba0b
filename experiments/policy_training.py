"""The work behind `bodyplan train`: find a heading, learn chunk by chunk, keep the best, measure and write it down."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from experiments.events import Events, event_file
from experiments.output import BadInput, progress, say
from experiments.policy_start import Impossible, best_start, worst_corner
from experiments.run_folder import CHECKPOINT, CONFIG, RESULT, check_folder, keep_config, write_json

if TYPE_CHECKING:
    from experiments.output import Solvers
    from experiments.policy_config import Policy
    from mfg.description import Description
    from sim.environment import Explosion
    from sim.model import Model
    from sim.training import Chunk, Trainer

Array = NDArray[np.float64]

STATE, EXPLOSIONS, ROBOT = "training.npz", "explosions", "robot.sha256"
BLUEPRINT, EVENTS, VIDEO, STRIP, PAGE = "blueprint", "events", "walk.mp4", "walk.png", "behaviour.html"
FINAL = 4  # purpose of randomness beside those of `sim.training`, `sim.race` and `experiments.policy_start`
EPISODE, EPISODES = 20.0, 20  # length [s] and number of the closing measurement's drawn episodes


def train(config: Policy, folder: Path, resume: bool, workers: int) -> dict[str, Any]:
    """Train a policy into a folder that is locked; gives what `result.json` holds.

    Raises:
        BadInput: if the folder holds something else, or a training and `resume` is not set, or the robot is unusable.
        Impossible: if the robot cannot be built, or its physics explodes.
        OSError: if something cannot be read or written.
    """
    import json

    from experiments.config import config_hash
    from sim.learning import Unlearnable
    from sim.training import Trainer

    check_folder(config, folder)
    mark = folder / CHECKPOINT / STATE
    if not resume and (mark.exists() or (folder / RESULT).exists()):
        raise BadInput(f"{folder} holds a training already; go on with it by --resume, or choose another --out")
    if (folder / "bundle.json").exists() and not (folder / CONFIG).exists():
        raise BadInput(f"{folder} holds a policy bundle that was not trained there; choose another --out")
    if (folder / RESULT).exists():
        say(f"{folder} is finished; it is a bundle for `bodyplan simulate --policy` and `bodyplan deploy`")
        return dict(json.loads((folder / RESULT).read_text(encoding="utf-8")))
    description, source = _robot(Path(config.robot), config.solver, folder)
    model = _model(config, source)
    keep_config(config, folder)
    _same_robot(source, mark.parent / ROBOT, config.robot)
    if mark.exists():
        trainer = _restored(config, model, source, workers, mark)
    else:
        others, checks = _others(config, source)
        found = best_start(config, model, others, checks, workers)
        trainer = Trainer(
            model, config.training(model), found.start, others=others, checks=checks, nthread=workers,
            learned=found.learned,
        )  # fmt: skip
    with event_file(folder / EVENTS, trainer.training.simulated(trainer.done)) as events:
        try:
            for _ in progress(_chunks(trainer, mark, events), trainer.training.chunks - trainer.done, "training"):
                pass
        except Unlearnable as error:
            raise Impossible(str(error)) from None
    return _conclude(config, folder, source, description, model, trainer, config_hash(config))


def _robot(path: Path, rules: Solvers, folder: Path) -> tuple[Description, Path]:
    """The robot as described, and the folder of its model; a design is built first, by these rules."""
    from mfg.manifest import read_description

    if path.suffix.lower() == ".xml":
        if path.name != "robot.xml" or not path.is_file():
            raise BadInput(f"{path} is not the robot.xml of a blueprint folder; give that folder, or a design")
        path = path.parent
    if not path.is_dir():
        from experiments.build import read_design
        from mfg.description import describe
        from mfg.export import write_blueprint
        from mfg.pipeline import build

        outcome = build(read_design(path), rules=rules)
        if not outcome.ok:
            raise Impossible(f"{path} cannot be built: {outcome.failure}")
        # What is there stays until the new one is known to be the same robot.
        partial, there = folder / f"{BLUEPRINT}.partial", folder / BLUEPRINT
        shutil.rmtree(partial, ignore_errors=True)
        write_blueprint(outcome, partial)
        if (noted := folder / CHECKPOINT / ROBOT).exists():
            _same_robot(partial, noted, str(path))
        shutil.rmtree(there, ignore_errors=True)
        partial.rename(there)
        return describe(outcome.blueprint), there
    if not (path / "robot.xml").exists():
        raise BadInput(f"{path} has no robot.xml; give a blueprint folder (`bodyplan build` makes one) or a design")
    return read_description(path), path


def _same_robot(source: Path, path: Path, robot: str) -> None:
    """Note which robot is trained, or refuse to go on with another one."""
    digest = hashlib.sha256()
    for file in (source / "robot.xml", *sorted((source / "meshes").glob("*"))):
        digest.update(file.name.encode() + file.read_bytes())
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        path.write_text(digest.hexdigest() + "\n", encoding="utf-8")
    elif path.read_text(encoding="utf-8").strip() != digest.hexdigest():
        raise BadInput(
            f"{robot} has changed since this training began; choose another --out, or bring the old one back"
        )


def _others(config: Policy, source: Path) -> tuple[tuple[Model, ...], tuple[Model, ...]]:
    """The robot modelled otherwise: on sprung pads, to learn on, and with flexible skin, too, to choose the best by.

    On pads the skin gives sideways and swings back; blocks of finite elements are too slow to learn on.
    """
    if not (config.randomise and config.pads > 0):
        return (), ()
    pads = _model(config, source, "sprung")
    if config.task != "speed":
        return (pads,), ()  # other tasks are chosen by their reward
    try:
        return (pads,), (pads, _model(config, source, "flex"))
    except BadInput as trouble:
        say(f"the best is chosen without flexible skin, of which there is no model: {trouble}")
        return (pads,), (pads,)


def _model(config: Policy, source: Path, level: str = "compliant") -> Model:
    from sim.herd import with_latency_room
    from sim.model import ModelError, load_spec
    from sim.skin import Fidelity
    from sim.terrain import Kind, Terrain, lay

    try:
        spec = load_spec(source / "robot.xml", fidelity=Fidelity(level))
        lay(spec, Terrain(Kind(config.terrain), seed=config.seed))
        return with_latency_room(spec)
    except ModelError as error:
        raise BadInput(str(error)) from None


def _restored(config: Policy, model: Model, source: Path, workers: int, mark: Path) -> Trainer:
    from sim.training import Trainer, start_of

    state = read_state(mark)
    try:
        others, checks = _others(config, source)
        trainer = Trainer(
            model, config.training(model), start_of(state), others=others, checks=checks, nthread=workers
        )  # fmt: skip
        trainer.restore(state)
    except (KeyError, ValueError) as error:
        raise BadInput(f"{mark}: not a checkpoint of this training ({error}); choose another --out") from None
    return trainer


def _chunks(trainer: Trainer, mark: Path, events: Events) -> Any:
    """Advance to the last chunk; each is on the disk before it counts."""
    while trainer.done < trainer.training.chunks:
        lost = trainer.environment.lost
        kept = len(trainer.environment.explosions)
        chunk = trainer.advance()
        keep_explosions(trainer.environment.explosions[kept:], mark.parent.parent / EXPLOSIONS, chunk.index)
        write_state(mark, trainer.state())
        events(chunk.steps, curves(chunk) | {"episodes/exploded": trainer.environment.lost - lost})
        say(told(chunk))
        if trainer.environment.lost > lost:
            say(
                f"  the physics of {trainer.environment.lost - lost} robots was lost; their states are in {EXPLOSIONS}/"
            )
        yield chunk


def keep_explosions(explosions: Sequence[Explosion], folder: Path, chunk: int) -> None:
    """Write down in which state, as which robot and under which control physics was lost; nothing if it was not."""
    if explosions:
        found: dict[str, Array] = {}
        for k, explosion in enumerate(explosions):
            found |= {f"{k}/state": explosion.state, f"{k}/control": explosion.control}
            found |= {f"{k}/draws/{name}": value for name, value in explosion.draws.items()}
        write_state(folder / f"chunk_{chunk:04}.npz", found)


def curves(chunk: Chunk) -> dict[str, float]:
    """What TensorBoard shows of a chunk."""
    verdict = chunk.verdict
    found = {f"reward/{name}": value for name, value in chunk.curves.items()}
    kept = {} if verdict.kept is None else {"speed/kept_in_the_worst_corner": verdict.kept}
    found |= {
        "speed/exploring": chunk.exploring_speed,
        "speed/policy": verdict.speed,
        "speed/randomised": verdict.robust_speed,
        "episodes/falls": verdict.falls,
        "episodes/lost": verdict.lost,
        "cpu_seconds": chunk.seconds,
    }
    return found | kept


def told(chunk: Chunk) -> str:
    """A chunk in one line; what it keeps in the worst corner is no more than that where it could not be the best."""
    v = chunk.verdict
    return (f"{chunk.steps:>9} steps: {chunk.exploring_speed:.2f} m/s exploring; the policy itself {v.speed:.2f} m/s, "
            f"{v.robust_speed:.2f} m/s randomised with {v.falls} falls of {v.episodes}{worst_corner(v)}")  # fmt: skip


def write_state(path: Path, state: dict[str, Array]) -> None:
    """Write named arrays into a file that is whole or not there; the same arrays give the same bytes."""
    path.parent.mkdir(exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    # numpy's own archive would carry the time of day.
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(state):
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(state[name]), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue())
    os.replace(partial, path)


def read_state(path: Path) -> dict[str, Array]:
    """Read what `write_state` wrote.

    Raises:
        BadInput: if the file is damaged or foreign.
    """
    try:
        # Opened here, because numpy leaves a file open that it cannot read.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            state = {name: archive[name] for name in archive.files}
    except (TypeError, ValueError, zipfile.BadZipFile, EOFError, KeyError) as error:
        raise BadInput(f"{path}: not a readable checkpoint ({error}); choose another --out") from None
    broken = [name for name, value in state.items() if value.dtype != float and name != "done"]
    if "heading" not in state or "done" not in state or broken:
        raise BadInput(f"{path}: not a checkpoint of a training; choose another --out")
    return state


def _guarded(task: str) -> tuple[str, ...]:
    """What a real robot's guards will not let a policy do."""
    if task != "recover":
        return ()
    return ("a robot that gets up turns far from how it lay, which its tilt guard takes for a fall: this policy is for "
            "simulation only",)  # fmt: skip


def _conclude(
    config: Policy, folder: Path, source: Path, description: Description, model: Model, trainer: Trainer,
    digest: str,
) -> dict[str, Any]:  # fmt: skip
    """Measure the best policy on the twin, write the bundle, the films and the result; the result comes last."""
    from experiments.behaviour_page import write_behaviour_page
    from experiments.deploy import bundle_of
    from hardware.bundle import save_bundle
    from sim.behaviour import motor_limits, motor_uses, motor_warnings
    from sim.closed_loop import roll_out_actor
    from sim.randomisation import RANDOMISED
    from sim.rollout import measure
    from sim.verdict import randomised
    from sim.video import save_strip, save_video

    actor, verdict = trainer.best, trainer.best_verdict
    if actor is None or verdict is None:
        raise Impossible(f"{config.robot}: no chunk of training was finished")
    rollouts = roll_out_actor(model, actor, EPISODE)
    behaviour = measure(model, rollouts)[0]
    if behaviour is None:
        raise Impossible(f"the physics of {config.robot} explodes under the trained policy")
    save_bundle(folder, bundle_of(description, actor, config_hash=digest), source)
    trials = randomised(model, actor, RANDOMISED, config.seed + FINAL, episodes=EPISODES, seconds=EPISODE,
                        nthread=trainer.nthread)  # fmt: skip
    alive = [trial for trial in trials if trial is not None]
    falls = len(trials) - sum(not trial.fell for trial in alive)
    uses = motor_uses(model, rollouts)
    result = {
        "kind": "policy",
        "robot": config.robot,
        "design": description.name,
        "heading_rad": trainer.start.heading,
        "rhythm": trainer.start.rhythm is not None,
        "steps": trainer.training.simulated(trainer.done),
        "best": asdict(verdict) | {"score": verdict.score},
        "behaviour": behaviour.to_json() | {"steps_per_s": None},
        "randomised": {
            "episodes": len(trials),
            "falls": falls,
            "mean_speed_m_s": float(np.mean([trial.speed for trial in alive])) if alive else 0.0,
            "least_speed_m_s": min((trial.speed for trial in alive), default=0.0),
        },
        "motors": [use.to_json() for use in uses],
        "warnings": [*motor_warnings(motor_limits(model), uses), *_guarded(config.task)],
    }
    save_strip(folder / STRIP, model, rollouts)
    if config.film > 0:
        save_video(folder / VIDEO, model, roll_out_actor(model, actor, config.film))
    kind = "corrects an open-loop gait" if trainer.start.rhythm is not None else "makes the whole movement"
    facts = (
        ("training", f"{result['steps']} control periods; the policy {kind}"),
        ("randomised", f"{len(trials) - falls} of {len(trials)} episodes of {EPISODE:.0f} s without a fall"),
    )
    write_behaviour_page(folder / PAGE, model, rollouts, behaviour, title=f"How {description.name} moves", facts=facts,
                         film=folder / VIDEO if config.film > 0 else None)  # fmt: skip
    write_json(folder / RESULT, result)
    return result
