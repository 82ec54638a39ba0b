"""The last round: the best candidates built in full and measured as twins; the best twin that walks wins."""

from __future__ import annotations

from collections.abc import Iterator

from evo.evaluation import Evaluation
from evo.pool import Pool
from evo.record import Record
from mfg.outcome import Failure


def finals(record: Record, pool: Pool[Evaluation, Evaluation], heat: int) -> Iterator[Evaluation]:
    """Measure twins, `heat` of them at a time, best screened first, until one walks or none is left.

    A heat is always finished, so which rows exist does not depend on who was quicker. What is recorded is not worked
    out again. Yields every twin that was not recorded before, as it is committed.

    Args:
        record: holds the evaluations; twins go into its table "finals".
        pool: works out twins.
        heat: how many candidates run together, at least 1.

    Raises:
        ValueError: if `heat` is below 1.
    """
    if heat < 1:
        raise ValueError(f"heat is {heat}; it must be at least 1")
    entrants = ladder(record.evaluations())
    for start in range(0, len(entrants), heat):
        twins = {_name(twin): twin for twin in record.evaluations(table="finals")}
        entered = entrants[start : start + heat]
        for screened, result, seconds in pool.run([e for e in entered if _name(e) not in twins]):
            twin = Evaluation(screened.candidate, failure=result) if isinstance(result, Failure) else result
            record.add(twin, seconds, "finals")
            twins[_name(twin)] = twin
            yield twin
        if any(_wins(twins[_name(e)]) for e in entered):
            return


def winners(record: Record) -> list[Evaluation]:
    """The twins that could be built and walk, best first by their own measurement."""
    return sorted(filter(_wins, record.evaluations(table="finals")), key=lambda twin: twin.rank_key)


def ladder(evaluations: list[Evaluation]) -> list[Evaluation]:
    """Those that were simulated, best first; of several candidates with one design only the best."""
    seen: set[str | None] = set()
    ranked = []
    for evaluation in sorted((e for e in evaluations if e.walk is not None), key=lambda e: e.rank_key):
        if evaluation.design not in seen:
            seen.add(evaluation.design)
            ranked.append(evaluation)
    return ranked


def _wins(twin: Evaluation) -> bool:
    return twin.passed and twin.walk is not None and twin.walk.walks


def _name(evaluation: Evaluation) -> tuple[int, int]:
    return evaluation.candidate.generation, evaluation.candidate.index
