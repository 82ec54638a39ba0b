"""The rows of `make bench` about learning: what it costs beside the physics and beside processes; time to walk.

Three figures have goals. Training against the environment alone: the same episodes, with the same actions, are run
once while learning and once more without a learner, on one thread, in CPU time. Training against SubprocVecEnv: the
same PPO with the same network and settings, in wall time, both with all cores. Time to walk: CPU seconds of learning,
from nothing, until robots that explore go half a metre a second. What is loaded or compiled once is never counted.
"""

from __future__ import annotations

import copy
import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.environment import Environment, Step
from sim.plan import USUAL, Ppo, Training

if TYPE_CHECKING:
    from sim.learning import Learner
    from sim.model import Model

AGAINST_ENVIRONMENT, AGAINST_PROCESSES, CPU_SECONDS = 0.75, 3.0, 15.0  # goals
SEEDS = (0, 1, 2)
STEPS = 20_480  # control periods of each timing, ten updates of the usual learner
PROCESS_STEPS = 6_144  # of a timing with processes, three updates
PROCESSES = (2, 4, 8)  # numbers of processes, of which the fastest counts
WALKS, UPDATES = 0.5, 2  # walking: this speed along the heading [m/s], in the mean over so many updates
MOST_STEPS = 400_000  # after which walking is given up
ROBOT = Path(__file__).parent / "examples" / "quadruped.vox"

Array = NDArray[np.float64]
Row = dict[str, Any]  # as of `experiments.bench`


@dataclass(eq=False)
class Watched(Environment):
    """An environment that keeps what it was told, and when how fast the robots were.

    Attributes:
        said: actions of every control period since the last reset.
        speeds: mean speed along the heading of every control period ever [m/s], up to the task's target.
        clock: CPU time of this process at the end of each of those [s].
    """

    said: list[Array] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)

    def reset(self, rng: np.random.Generator) -> Array:
        """As always, and nothing was said yet."""
        self.said = []
        return super().reset(rng)

    def step(self, said: ArrayLike) -> Step:
        """As always."""
        from sim.tasks import SCALE

        self.said.append(np.array(said))
        step = super().step(said)
        self.speeds.append(step.parts["speed"] / SCALE / 2.0)
        self.clock.append(time.process_time())
        return step


def training(row: Any, processes: int, model: Model | None = None) -> Iterator[Row]:
    """Rates of the environment alone, of learning on it, and of the same learner on SubprocVecEnv; time to walk.

    Args:
        row: `experiments.bench.row`.
        processes: cores.
        model: of the robot; the painted quadruped by default.
    """
    model = reference() if model is None else model
    found = [against_environment(model, seed) for seed in SEEDS]
    random, replayed, learning = (statistics.median(column) for column in zip(*found, strict=True))
    goal = f">= {AGAINST_ENVIRONMENT}"
    note = f"{model.nu} joints, {USUAL.copies} copies, randomised, one thread, CPU time, {len(SEEDS)} seeds"
    yield row("bare environment, random actions", random, "steps/s", note=note)
    yield row("bare environment, the learner's actions", replayed, "steps/s", note="its episodes once more")
    yield row("training", learning, "steps/s", note="learning included, the same thread")
    ratios = [[c / a for a, _, c in found], [c / b for _, b, c in found]]
    against_random, against_replayed = (statistics.median(column) for column in ratios)
    yield row("training against bare environment", against_replayed, "x", goal, "the learner's actions in both")
    yield row("- the same, random actions in the bare one", against_random, "x", goal)

    rates = {count: on_processes(model, SEEDS[0], count) for count in PROCESSES}
    best = max(rates, key=lambda count: rates[count])
    theirs = [rates[best], *(on_processes(model, seed, best) for seed in SEEDS[1:])]
    ours = [on_batch(model, seed, processes) for seed in SEEDS]
    tried = ", ".join(f"{count}: {rate:.0f}" for count, rate in rates.items())
    yield row("training, wall time", statistics.median(ours), "steps/s", note=f"physics on {processes} threads")
    yield row("training on SubprocVecEnv, wall time", statistics.median(theirs), "steps/s",
              note=f"{best} processes; {tried}")  # fmt: skip
    times = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    yield row("times faster than SubprocVecEnv", times, "x", f">= {AGAINST_PROCESSES:g}", "wall time")

    walked = [time_to_walk(model, seed) for seed in SEEDS]
    short = sum(not reached for _, reached in walked)
    each = ", ".join(f"{'' if reached else '> '}{seconds:.1f}" for seconds, reached in walked)
    note = f"quadruped.vox from rest, heading 0, mean of {UPDATES} updates while exploring; seeds: {each}"
    at_least = ", at least" if 2 * short > len(walked) else ""
    yield row(f"CPU-seconds to {WALKS} m/s{at_least}", statistics.median(seconds for seconds, _ in walked), "s",
              f"<= {CPU_SECONDS:g}", note)  # fmt: skip


def reference() -> Model:
    """The painted quadruped with its hardware in it."""
    from experiments.build import read_design
    from mfg.description import describe
    from mfg.pipeline import score
    from sim.herd import with_latency_room
    from sim.model import make_spec

    return with_latency_room(make_spec(describe(score(read_design(ROBOT)).blueprint)))


def fresh(model: Model, seed: int, nthread: int = 1, settings: Ppo = USUAL) -> tuple[Watched, Learner]:
    """Environment and learner of a free start at rest with heading 0; the learner has made one update to warm up."""
    from sim.learning import Learner
    from sim.model import default_pose
    from sim.training import Start, environment_of

    plan = Training(seed, ppo=settings)
    made = environment_of(model, plan, Start(0.0, default_pose(model)), nthread)
    environment = Watched(**{f.name: getattr(made, f.name) for f in fields(made) if f.init})
    _learn(Learner(made, plan.ppo, seed), plan.ppo.update, np.random.default_rng(seed))  # another one, thrown away
    return environment, Learner(environment, plan.ppo, seed)


def against_environment(model: Model, seed: int, steps: int = STEPS) -> tuple[float, float, float]:
    """Steps per CPU second: bare with random actions, bare with the learner's actions again, and learning."""
    environment, learner = fresh(model, seed)
    rng, count = np.random.default_rng(seed), environment.count
    spent = np.zeros(3)
    parts = 2  # in turns, for a busy machine to slow all alike
    periods = 0
    for _ in range(parts):
        again, reached = copy.deepcopy(rng), len(environment.speeds)
        again.integers(2**31)  # what the learner draws for its own noise
        spent[2] += _learn(learner, steps // parts, rng)
        said, speeds = environment.said, environment.speeds[reached:]
        noise = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, np.shape(said))
        bare = Environment(**{f.name: getattr(environment, f.name) for f in fields(Environment) if f.init})
        spent[1] += _run(bare, said, again)
        spent[0] += _run(bare, noise, np.random.default_rng(seed))
        periods += len(speeds)
    random, replayed, learning = periods * count / spent
    return float(random), float(replayed), float(learning)


def _run(environment: Environment, said: ArrayLike, rng: np.random.Generator) -> float:
    """CPU seconds that an environment takes under given actions."""
    orders = np.asarray(said)
    environment.reset(rng)
    before = time.process_time()
    for order in orders:
        environment.step(order)
    return time.process_time() - before


def on_batch(model: Model, seed: int, nthread: int, steps: int = STEPS) -> float:
    """Control periods per second of wall time, learning included, with the physics on some threads."""
    environment, learner = fresh(model, seed, nthread)
    before = time.perf_counter()
    _learn(learner, steps, np.random.default_rng(seed))
    return len(environment.speeds) * environment.count / (time.perf_counter() - before)


def on_processes(model: Model, seed: int, count: int, steps: int = PROCESS_STEPS) -> float:
    """The same as `on_batch` on Stable-Baselines3's SubprocVecEnv, with the registered environment in each process.

    Every update has as many samples as ours; starting the processes is not counted.
    """
    import torch
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from sim.ppo import ppo_on

    torch.set_num_threads(1)
    alike = replace(USUAL, copies=count, horizon=USUAL.update // count)
    vector = SubprocVecEnv([partial(_walk, model)] * count, start_method="spawn")
    try:
        ppo = ppo_on(vector, Environment(model, 1), alike, seed)
        ppo.learn(alike.update)
        before = time.perf_counter()
        ppo.learn(steps)
        return float(ppo.num_timesteps / (time.perf_counter() - before))
    finally:
        vector.close()


def _walk(model: Model) -> Any:
    """The registered environment, in a process of its own."""
    import gymnasium

    from sim.gym_env import ID
    from sim.randomisation import RANDOMISED

    return gymnasium.make(ID, robot=model, randomisation=RANDOMISED)


def time_to_walk(
    model: Model, seed: int, most: int = MOST_STEPS, speed: float = WALKS, settings: Ppo = USUAL
) -> tuple[float, bool]:
    """CPU seconds of learning until the exploring robots walk, or until it is given up, and whether they walk."""
    environment, learner = fresh(model, seed, settings=settings)
    window = UPDATES * learner.settings.horizon
    rng, spent, done = np.random.default_rng(seed), 0.0, 0
    while done * environment.count < most:
        before = time.process_time()
        seconds = _learn(learner, max(most // 4, window * environment.count), rng)
        sums = np.cumsum([0.0, *environment.speeds[done:]])
        walking = np.flatnonzero((sums[window:] - sums[:-window]) / window >= speed)
        if len(walking):
            return spent + environment.clock[done + int(walking[0]) + window - 1] - before, True
        spent, done = spent + seconds, len(environment.speeds)
    return spent, False


def _learn(learner: Learner, steps: int, rng: np.random.Generator) -> float:
    """CPU seconds that learning takes, with settings that do not change."""
    return learner.learn(steps, rng, learner.settings.learning_rate, learner.settings.spread)[1]
