"""What a training begins with: which way is forward, and whether a gait is corrected or the policy makes it all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from experiments.output import progress, say

if TYPE_CHECKING:
    from evo.pool import Pool
    from experiments.policy_config import Policy
    from sim.gaits import GaitResult
    from sim.model import Model
    from sim.race import Runner
    from sim.sturdy import Trial
    from sim.training import Start

Task = TypeVar("Task")
Result = TypeVar("Result")

GAIT = 3  # purpose of randomness beside those of `sim.training` and `sim.race`
SEARCHES = 2  # for open-loop gaits, each corrected by a start of its own
TIMEOUT = 3600.0  # of one runner's heat, or of one gait on its course [s]


class Impossible(ValueError):
    """The robot cannot be trained; the message says why."""


def best_start(config: Policy, model: Model, others: Sequence[Model], workers: int) -> Runner:
    """The winner of a race of starts, with what it has learned; the number of workers changes nothing.

    Args:
        config: of the training.
        model: of the robot.
        others: the same robot modelled otherwise; gaits have to hold on these, too.
        workers: processes.

    Raises:
        Impossible: if the physics explodes under every gait, or no start could be tried.
    """
    from evo.pool import Pool
    from sim.model import default_pose
    from sim.race import Heat, Runner, winner
    from sim.training import Start

    if config.task != "speed":
        return Runner(Start(0.0, default_pose(model)))
    say("searching open-loop gaits, whose direction is the first candidate for being forward")
    found = gaits(config, model)
    held = sturdier(found, config, model, others, workers) if config.randomise and config.generations else found
    runners = tuple(Runner(start) for start in candidates(found[0], held, config.starts))
    if len(runners) == 1:
        return runners[0]
    say(f"{len(runners)} starts race for {config.race_steps} control periods each")
    with Pool[Runner, Runner](Heat(model, config.training(model), config.race_steps), workers, TIMEOUT) as pool:
        return winner(_run(pool, runners, config.robot))


def gaits(config: Policy, model: Model) -> list[GaitResult]:
    """Open-loop gaits of independent searches, the best first; one search where no more than it is asked for.

    Raises:
        Impossible: if the physics explodes under every gait.
    """
    from sim.gaits import SCREENING, search_gait
    from sim.rollout import Diverged

    found: list[GaitResult] = []
    for key in [(GAIT,), *((GAIT, k) for k in range(1, SEARCHES))][: config.starts]:
        rng = np.random.default_rng(np.random.SeedSequence(config.seed, spawn_key=key))
        try:
            found.append(search_gait(model, rng, SCREENING))
        except Diverged as error:
            raise Impossible(str(error)) from None
    return sorted(found, key=lambda gait: -gait.score)


def sturdier(
    found: Sequence[GaitResult], config: Policy, model: Model, others: Sequence[Model], workers: int
) -> list[Trial]:
    """The gaits made to hold on all robots that training draws, the best first.

    Raises:
        Impossible: if none of them could be tried.
    """
    from evo.pool import Pool
    from sim.actor import Gait
    from sim.randomisation import EXACT
    from sim.sturdy import Course, Trial

    training = config.training(model)
    course = Course(model, tuple(others), training.task.target_speed, training.randomisation or EXACT, config.seed,
                    generations=config.generations)  # fmt: skip
    say("making them hold where friction, contact, latency, gains and the ground differ")
    with Pool[Gait, Trial](course, workers, TIMEOUT) as pool:
        tried, trouble = _in_order(pool, [result.gait for result in found], "gaits")
    done = [trial for trial in tried if trial.score > -course.pace]
    if len(done) < len(tried):
        trouble = "its physics explodes"
    if trouble:
        say(f"  a gait was lost: {trouble}")
    if not done:
        raise Impossible(f"no gait of {config.robot} could be tried: {trouble}")
    for trial in done:
        reached = f"{trial.score:.2f} of {course.pace:.2f} m/s, {trial.least:.2f} at worst"
        say(f"  heading {trial.heading:.2f} rad: {reached}")
    return sorted(done, key=lambda trial: -trial.score)


def candidates(found: GaitResult, held: Sequence[GaitResult | Trial], count: int) -> tuple[Start, ...]:
    """So many starts: gaits that hold, to be corrected, the best first; then free ones along headings.

    The headings are spread from that of the gait found on the model alone, which may hold nowhere else but says along
    which of its directions the body moves at all.
    """
    from sim.race import starts
    from sim.training import Start

    corrected = tuple(Start(gait.heading, gait.gait.offset, gait.gait) for gait in held)[:count]
    return (*corrected, *starts(found.gait, found.heading, 1 + count - len(corrected))[1:])


def _run(pool: Pool[Runner, Runner], runners: Sequence[Runner], robot: str) -> list[Runner]:
    """The runners after a heat, in their order, without those that were lost."""
    done, trouble = _in_order(pool, runners, "starts")
    if not done:
        raise Impossible(f"no start of {robot} could be tried: {trouble}")
    for runner in done:
        say(told(runner))
    return done


def _in_order(pool: Pool[Task, Result], tasks: Sequence[Task], label: str) -> tuple[list[Result], str]:
    """The results of tasks in their order, without those that were lost, and why one was lost or nothing."""
    from mfg.outcome import Failure

    done: dict[int, Result] = {}
    trouble = ""
    places = {id(task): place for place, task in enumerate(tasks)}
    for task, result, _ in progress(pool.run(tasks), len(tasks), label):
        if isinstance(result, Failure):
            trouble = result.detail
        else:
            done[places[id(task)]] = result
    return [done[place] for place in sorted(done)], trouble


def told(runner: Runner) -> str:
    """A runner in one line."""
    kind = "free" if runner.start.rhythm is None else "gait corrected"
    line = f"  {kind}, heading {runner.start.heading:.2f} rad: {runner.exploring:.2f} m/s exploring"
    if runner.verdict is None:
        return line
    v = runner.verdict
    return f"{line}; the policy itself {v.speed:.2f} m/s, {v.robust_speed:.2f} m/s randomised with {v.falls} falls"
