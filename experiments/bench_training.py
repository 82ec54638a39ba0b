"""The rows of `make bench` about learning: what learning costs beside the physics, and beside processes."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.model import Model

AGAINST_ENVIRONMENT, AGAINST_PROCESSES, CPU_SECONDS = 0.75, 3.0, 15.0  # goals
SEEDS = (0, 1, 2)
STEPS = 20_480  # control periods of each timing
WALKS = 0.5  # mean speed while exploring that counts as walking [m/s]
MOST_STEPS = 300_000  # after which walking is given up
ROBOT = Path(__file__).parent / "examples" / "quadruped.vox"

Row = dict[str, Any]  # as of `experiments.bench`


def training(row: Any, processes: int) -> Iterator[Row]:
    """Rates of the environment alone, of learning on it, and of the same learner on SubprocVecEnv; time to walk.

    Args:
        row: `experiments.bench.row`.
        processes: cores.
    """
    model = reference()
    alone, learning, ratio = zip(*(against_environment(model, seed) for seed in SEEDS), strict=True)
    note = f"{model.nu} joints, randomised, one thread, CPU time, {len(SEEDS)} seeds"
    yield row("environment alone", statistics.median(alone), "steps/s", note=note)
    yield row("training on it", statistics.median(learning), "steps/s", note="the same thread gathers and learns")
    yield row("training against environment alone", statistics.median(ratio), "x", f">= {AGAINST_ENVIRONMENT}")
    ours = [batched(model, seed, processes) for seed in SEEDS]
    theirs = [max(by_processes(model, seed, count) for count in (processes, 4 * processes)) for seed in SEEDS]
    yield row("training, all cores, wall time", statistics.median(ours), "steps/s")
    yield row("training on SubprocVecEnv, wall time", statistics.median(theirs), "steps/s", note="best of two sizes")
    times = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    yield row("training: times faster than SubprocVecEnv", times, "x", f">= {AGAINST_PROCESSES:g}")
    seconds = [cpu_seconds_to_walk(model, seed) for seed in SEEDS]
    what = f"CPU time to {WALKS} m/s, exploring, {len(SEEDS)} seeds"
    yield row(what, statistics.median(seconds), "s", f"<= {CPU_SECONDS:g}", note="from nothing, quadruped.vox")


def reference() -> Model:
    """The painted quadruped with its hardware in it."""
    from experiments.build import catalogue_of, read_design
    from mfg.description import describe
    from mfg.pipeline import score
    from sim.herd import with_latency_room
    from sim.model import make_spec

    return with_latency_room(make_spec(describe(score(read_design(ROBOT), catalogue_of("paper")).blueprint)))


def _trainer_parts(model: Model, seed: int, nthread: int = 1) -> tuple[Any, Any]:
    """Environment and learner of a free start."""
    from sim.closed_loop import default_pose
    from sim.learning import Learner
    from sim.training import Start, Training, environment_of

    settings = Training(seed)
    environment = environment_of(model, settings, Start(0.0, default_pose(model)), nthread)
    return environment, Learner(environment, settings.ppo, seed)


def against_environment(model: Model, seed: int) -> tuple[float, float, float]:
    """Steps per CPU second of the environment under random actions and of training, in turns, and their ratio."""
    import numpy as np

    environment, learner = _trainer_parts(model, seed)
    rng = np.random.default_rng(seed)
    learn = partial(learner.learn, learning_rate=learner.settings.learning_rate, spread=learner.settings.spread)
    learn(learner.settings.update, rng)  # imports and compiles what torch does at first
    said = np.clip(rng.normal(0, learner.settings.spread, (50, environment.count, model.nu)), -1, 1)
    alone, learning = 0.0, 0.0
    for _ in range(3):
        environment.reset(rng)
        before = time.process_time()
        for k in range(STEPS // 3 // environment.count):
            environment.step(said[k % len(said)])
        alone += time.process_time() - before
        learning += learn(STEPS // 3, rng)[1]
    updates = 3 * -(-(STEPS // 3) // learner.settings.update) * learner.settings.update
    steps = 3 * (STEPS // 3 // environment.count) * environment.count
    return steps / alone, updates / learning, (updates / learning) / (steps / alone)


def batched(model: Model, seed: int, nthread: int) -> float:
    """Control periods per second of wall time, learning included, with the physics on all cores."""
    import numpy as np

    _, learner = _trainer_parts(model, seed, nthread)
    rng, settings = np.random.default_rng(seed), learner.settings
    learner.learn(settings.update, rng, settings.learning_rate, settings.spread)
    before = time.perf_counter()
    learner.learn(STEPS, rng, settings.learning_rate, settings.spread)
    return STEPS / (time.perf_counter() - before)


def by_processes(model: Model, seed: int, count: int) -> float:
    """The same learner of Stable-Baselines3 on its own vector of processes, each with the Gymnasium environment."""
    from sim.learning import on_processes

    settings = replace(_settings(), copies=count)
    seconds, steps = on_processes(model, settings, STEPS // 4, seed)
    return steps / seconds


def _settings() -> Any:
    from sim.learning import USUAL

    return USUAL


def cpu_seconds_to_walk(model: Model, seed: int) -> float:
    """CPU seconds of learning until the exploring robots go half a metre a second on average."""
    import numpy as np

    from sim.tasks import SCALE

    _, learner = _trainer_parts(model, seed)
    settings, spent, done = learner.settings, 0.0, 0
    while done < MOST_STEPS:
        rng = np.random.default_rng([seed, done])
        curves, seconds = learner.learn(5 * settings.update, rng, settings.learning_rate, settings.spread)
        spent, done = spent + seconds, done + 5 * settings.update
        if curves["speed"] / SCALE / 2.0 >= WALKS:
            return spent
    return float("inf")
