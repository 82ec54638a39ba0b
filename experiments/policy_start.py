"""What a training begins with: which way is forward, and whether a gait is corrected or the policy makes it all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from experiments.output import progress, say

if TYPE_CHECKING:
    from evo.pool import Pool
    from experiments.policy_config import Policy
    from sim.actor import Gait
    from sim.gaits import GaitResult
    from sim.model import Model
    from sim.race import Runner
    from sim.sturdy import Course, Trial
    from sim.training import Start
    from sim.verdict import Verdict

Task = TypeVar("Task")
Result = TypeVar("Result")

GAIT = 3  # purpose of randomness beside those of `sim.training` and `sim.race`
SEARCHES = 3  # for open-loop gaits in each band of frequencies
ENOUGH = 0.75  # of the pace: no free start races against a gait that holds and goes so fast
TIMEOUT = 3600.0  # of one search, one course or one heat [s]


class Impossible(ValueError):
    """The robot cannot be trained; the message says why."""


def best_start(
    config: Policy, model: Model, others: Sequence[Model], checks: Sequence[Model], workers: int
) -> Runner:  # fmt: skip
    """The winner of a race of starts, with what it has learned; the number of workers changes nothing.

    Args:
        config: of the training.
        model: of the robot.
        others: the same robot modelled otherwise; gaits have to hold on these, too.
        checks: models of it on which gaits that hold are judged, too.
        workers: processes.

    Raises:
        Impossible: if the physics explodes under every gait, or no start could be tried.
    """
    from sim.model import default_pose
    from sim.race import Runner, winner
    from sim.training import Start

    if config.task != "speed":
        return Runner(Start(0.0, default_pose(model)))
    say("searching open-loop gaits, whose direction is the first candidate for being forward")
    found = gaits(config, model, workers)
    ready: list[Runner] = []
    if config.held:
        held = sturdier(found, config, model, others, workers)
        if config.starts == 1:
            return Runner(candidates(found[0], held, 1)[0])
        best = _judged(config, model, checks, candidates(found[0], held, len(held)), workers)
        if best.merit >= ENOUGH * config.training(model).task.target_speed:
            return best
        ready = [best]
        runners = [Runner(start) for start in candidates(found[0], (), config.starts - len(ready))]
    else:
        runners = [Runner(start) for start in candidates(found[0], found[:2], config.starts)]
        if len(runners) == 1:
            return runners[0]
    return winner([*ready, *_race(config, model, runners, workers, needed=not ready)])


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """Of an open-loop gait on a robot as it is modelled; can be sent to another process."""

    model: Model
    seed: int

    def __call__(self, key: tuple[int, int]) -> GaitResult | None:
        """The gait of a search in a band of frequencies, by number; None where the physics explodes under all."""
        from sim.gaits import BANDS, search_gait
        from sim.rollout import Diverged

        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(GAIT, *key)))
        try:
            return search_gait(self.model, rng, band=BANDS[key[0]])
        except Diverged:
            return None


def gaits(config: Policy, model: Model, workers: int) -> list[GaitResult]:
    """Open-loop gaits of some searches in each band of frequencies, the best first.

    Raises:
        Impossible: if the physics explodes under every gait, or no search could be made.
    """
    from evo.pool import Pool
    from sim.gaits import BANDS

    keys = [(band, number) for band in range(len(BANDS)) for number in range(SEARCHES)]
    with Pool(Search(model, config.seed), workers, TIMEOUT) as pool:
        found, trouble = _in_order(pool, keys, "searches")
    if trouble:
        say(f"  a search was lost: {trouble}")
    alive = [gait for gait in found if gait is not None]
    if not alive:
        raise Impossible(f"no gait of {config.robot}: {trouble or 'its physics explodes under each that was tried'}")
    return sorted(alive, key=lambda gait: -gait.score)


def sturdier(
    found: Sequence[GaitResult], config: Policy, model: Model, others: Sequence[Model], workers: int
) -> list[Trial]:  # fmt: skip
    """Gaits that hold on all robots that training draws, the best first: two of each band of frequencies.

    Raises:
        Impossible: if none of them could be tried.
    """
    from sim.gaits import BANDS, band_of
    from sim.randomisation import EXACT
    from sim.sturdy import Course

    training = config.training(model)
    course = Course(model, tuple(others), training.task.target_speed, config.generations,
                    training.randomisation or EXACT, config.seed)  # fmt: skip
    # Quick gaits begin behind slow ones, so each band has its own course.
    shares = [[result.gait for result in found if band_of(result.gait) == band] for band in BANDS]
    say("making them hold where friction, contact, latency, gains and the ground differ")
    left = _tried(course, [share for share in shares if share], config.robot, workers)
    return sorted((trial for trials in left for trial in trials), key=lambda trial: -trial.score)


def _tried(course: Course, gaits: Sequence[Sequence[Gait]], robot: str, workers: int) -> list[tuple[Trial, ...]]:
    """What a course makes of gaits, in their order, without those that were lost."""
    from evo.pool import Pool

    with Pool(course, workers, TIMEOUT) as pool:
        tried, trouble = _in_order(pool, gaits, "gaits")
    done = [trials for trials in tried if trials[0].score > -course.pace]
    if len(done) < len(tried):
        trouble = "its physics explodes"
    if trouble:
        say(f"  a gait was lost: {trouble}")
    if not done:
        raise Impossible(f"no gait of {robot} could be tried: {trouble}")
    for best, *_ in done:
        reached = f"{best.score:.2f} of {course.pace:.2f} m/s, {best.least:.2f} at worst"
        say(f"  heading {best.heading:.2f} rad: {reached}")
    return done


def candidates(found: GaitResult, held: Sequence[GaitResult | Trial], count: int) -> tuple[Start, ...]:
    """So many starts: gaits that hold, to be corrected, the best first; then free ones along headings.

    The headings are spread from that of the gait found on the model alone, which may hold nowhere else but says along
    which of its directions the body moves at all.
    """
    from sim.race import starts
    from sim.training import Start

    corrected = tuple(Start(gait.heading, gait.gait.offset, gait.gait) for gait in held)[:count]
    return (*corrected, *starts(found.gait, found.heading, 1 + count - len(corrected))[1:])


def _judged(config: Policy, model: Model, checks: Sequence[Model], starts: Sequence[Start], workers: int) -> Runner:
    """The best of gaits as they are, by what they keep where they keep the least."""
    from evo.pool import Pool
    from sim.race import AsItIs
    from sim.verdict import stood

    judge = AsItIs(stood(model), tuple(stood(check) for check in checks), config.training(model))
    with Pool(judge, workers, TIMEOUT) as pool:
        judged, trouble = _in_order(pool, starts, "gaits")
    if not judged:
        raise Impossible(f"no gait of {config.robot} could be judged: {trouble}")
    for runner in judged:
        say(told(runner))
    return max(judged, key=lambda runner: runner.verdict.score if runner.verdict else 0.0)


def _race(config: Policy, model: Model, runners: Sequence[Runner], workers: int, *, needed: bool) -> list[Runner]:
    """The runners after a heat, in their order, without those that were lost.

    Raises:
        Impossible: if all were lost and one is needed.
    """
    from evo.pool import Pool
    from sim.race import Heat

    if not runners:
        return []
    say(f"{len(runners)} starts race for {config.race_steps} control periods each")
    with Pool(Heat(model, config.training(model), config.race_steps), workers, TIMEOUT) as pool:
        done, trouble = _in_order(pool, runners, "starts")
    if needed and not done:
        raise Impossible(f"no start of {config.robot} could be tried: {trouble}")
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


def worst_corner(verdict: Verdict) -> str:
    """What is kept in the worst corner, as the end of a line."""
    return "" if verdict.kept is None else f"; keeps {verdict.kept:.2f} in the worst corner"


def told(runner: Runner) -> str:
    """A runner in one line."""
    kind = "free" if runner.start.rhythm is None else "gait corrected" if runner.learned else "gait"
    line = f"  {kind}, heading {runner.start.heading:.2f} rad:"
    if runner.learned:
        line += f" {runner.exploring:.2f} m/s exploring"
    v = runner.verdict
    if v is None:
        return line
    policy = "; the policy itself" if runner.learned else ""
    return (
        f"{line}{policy} {v.speed:.2f} m/s, {v.robust_speed:.2f} m/s randomised with {v.falls} falls{worst_corner(v)}"
    )
