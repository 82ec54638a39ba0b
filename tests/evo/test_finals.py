from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evo.evaluation import Candidate, Evaluation, Walk
from evo.finals import finals, ladder, winners
from evo.pool import Pool
from evo.record import Record
from mfg.outcome import Failure, Reason, Scores, Stage
from sim.actor import Gait

GAIT = Gait(1.0, np.ones(1), np.zeros(1), np.zeros(1))
UNBUILDABLE, LAME, BROKEN = "unbuildable", "lame", "broken"


def walk(task: float, distance: float = 1.0) -> Walk:
    return Walk(GAIT, task, task, 0.0, distance, 10.0, 0.4, 3.0)


def screened(index: int, fitness: float | None, design: str) -> Evaluation:
    return Evaluation(Candidate(0, index, np.full(2, index, np.float32)), design, Scores(0.5), None, walk(1.0), fitness)


def build(evaluation: Evaluation) -> Evaluation:
    kind = str(evaluation.design).split("-")[0]
    if kind == BROKEN:
        raise ArithmeticError("planted")
    if kind == UNBUILDABLE:
        failure = Failure(Stage.PRINT, Reason.TOO_LARGE, "planted")
        return Evaluation(evaluation.candidate, evaluation.design, failure=failure)
    moved = walk(1.0, 0.3999 if kind == LAME else 0.4)
    # The name of a design ends in its fitness as a twin.
    fitness = float(str(evaluation.design).split("-")[-1]) if "-" in str(evaluation.design) else 9.0
    return Evaluation(evaluation.candidate, evaluation.design, Scores(0.5), None, moved, fitness)


def tournament(folder: Path, designs: list[tuple[float | None, str]], heat: int) -> tuple[list[int], str | None]:
    """Who was built, and which design won."""
    with Record.create(folder / "run.sqlite", 16, {}) as record:
        for index, (fitness, design) in enumerate(designs):
            record.add(screened(index, fitness, design), 0.0)
        with Pool(build, 0, 30.0) as pool:
            list(finals(record, pool, heat))
        champion = next(iter(winners(record)), None)
        built = [twin.candidate.index for twin in record.evaluations(table="finals")]
        return built, None if champion is None else champion.design


def test_the_best_twin_of_the_first_heat_with_a_walker_wins(tmp_path: Path) -> None:
    designs: list[tuple[float | None, str]] = [
        (0.1, "good-0.9"), (0.9, UNBUILDABLE), (0.8, LAME), (0.6, "good-0.2"), (0.7, BROKEN), (0.2, "good-0.4"),
        (0.5, "good-0.3"),
    ]  # fmt: skip
    assert tournament(tmp_path, designs, 3) == ([1, 2, 3, 4, 5, 6], "good-0.4")


@pytest.mark.parametrize("heat", [1, 2, 3, 7])
def test_a_heat_is_always_finished(tmp_path: Path, heat: int) -> None:
    designs: list[tuple[float | None, str]] = [(0.9, LAME), (0.8, "good-0.5"), (0.7, "good-0.4"), (0.6, "good-0.3")]
    built, won = tournament(tmp_path, designs, heat)
    assert won == "good-0.5"
    assert built == list(range(min(4, heat * -(-2 // heat))))


def test_without_a_walker_everybody_was_tried_and_nobody_wins(tmp_path: Path) -> None:
    assert tournament(tmp_path, [(0.9, LAME), (0.8, UNBUILDABLE), (None, LAME + "-2")], 2) == ([0, 1, 2], None)


def test_the_ladder_holds_each_design_once_and_only_what_was_simulated() -> None:
    failure = Failure(Stage.MOTOR, Reason.NO_OVERLAP, "planted")
    lost = Evaluation(Candidate(0, 9, np.zeros(2, np.float32)), "lost", failure=failure)
    twice = [screened(0, 0.2, "a"), screened(1, 0.5, "a"), screened(2, None, "b"), screened(3, 0.3, "c"), lost]
    assert [e.candidate.index for e in ladder(twice)] == [1, 3, 2]


def test_a_heat_holds_at_least_one(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="heat is 0"):
        tournament(tmp_path, [], 0)
