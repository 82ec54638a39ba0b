"""Ask, evaluate, tell; every answer is on disk before the optimiser hears of it, and a stopped run goes on exactly.

There is no second code path for resuming: the loop always starts at generation 0, asks the optimiser, takes the
answers that are recorded and works out those that are not. Because the optimiser's state follows from its seed and the
orders it was told, it arrives where it was, and this is checked: the latents it asks for must be the recorded ones,
byte for byte, and its state must hash to what the checkpoint says.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from evo.cma_es import CmaEs
from evo.evaluation import Candidate, Evaluation
from evo.pool import Pool
from evo.record import Record
from mfg.outcome import Failure

CHECKPOINT_FILE = "progress.json"


class ResumeError(ValueError):
    """What is on disk is not the past of this run."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """How far a run is: a check on the rows, which hold all that is needed to go on.

    Attributes:
        generations: how many have been told.
        optimiser: digest of its state after the last of them.
    """

    generations: int
    optimiser: str

    def save(self, folder: Path) -> None:
        """Write it so that a reader finds the old one or the new one, whole."""
        partial = folder / (CHECKPOINT_FILE + ".partial")
        with partial.open("w", encoding="utf-8") as file:
            file.write(json.dumps(asdict(self)) + "\n")
            file.flush()
            os.fsync(file.fileno())
        partial.replace(folder / CHECKPOINT_FILE)

    @classmethod
    def load(cls, folder: Path) -> Checkpoint | None:
        """Read it; None if there is none yet.

        Raises:
            ResumeError: if it is damaged.
        """
        path = folder / CHECKPOINT_FILE
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            return cls(generations=int(stored["generations"]), optimiser=str(stored["optimiser"]))
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError):
            raise ResumeError(f"{path} is damaged; delete it, the run file alone is enough to go on") from None


def evolve(
    optimiser: CmaEs,
    record: Record,
    pool: Pool[Candidate, Evaluation],
    generations: int,
    checkpoint: Path,
) -> Iterator[Evaluation]:
    """Run to the last generation; yields every evaluation that was not recorded before, as it is committed.

    Closing the iterator, Ctrl-C and kill -9 lose nothing but the evaluations that were being worked out.

    Args:
        optimiser: fresh, at generation 0.
        record: open for writing.
        pool: works out candidates.
        generations: how many in all.
        checkpoint: an existing folder.

    Raises:
        ResumeError: if the record or the checkpoint is not the past of this optimiser.
        ValueError: if the optimiser is not fresh.
    """
    if optimiser.generation != 0:
        raise ValueError(f"the optimiser is at generation {optimiser.generation}; give a fresh one, it is replayed")
    past = Checkpoint.load(checkpoint)
    for generation in range(generations):
        latents = optimiser.ask()
        known = {evaluation.candidate.index: evaluation for evaluation in record.evaluations(generation)}
        _check_latents(generation, latents, known)
        missing = [Candidate(generation, i, latents[i]) for i in range(len(latents)) if i not in known]
        if missing and past is not None and generation < past.generations:
            raise ResumeError(
                f"the checkpoint says that {past.generations} generations are done, but the run file lacks "
                f"{len(missing)} rows of generation {generation}; restore the file or start in another folder"
            )
        for candidate, result, seconds in pool.run(missing):
            evaluation = Evaluation(candidate, failure=result) if isinstance(result, Failure) else result
            record.add(evaluation, seconds)
            known[candidate.index] = evaluation
            yield evaluation
        optimiser.tell(sorted(known, key=lambda index: known[index].rank_key))
        done = Checkpoint(generation + 1, optimiser.state_digest())
        if past is None or done.generations > past.generations:
            done.save(checkpoint)
        elif done.generations == past.generations and done != past:
            raise ResumeError(
                f"after {done.generations} generations the optimiser's state is {done.optimiser}, the checkpoint says "
                f"{past.optimiser}; resume with the versions of cma and numpy that started the run"
            )


def _check_latents(generation: int, latents: np.ndarray, known: dict[int, Evaluation]) -> None:
    for index, evaluation in known.items():
        stored = evaluation.candidate.latent
        if index >= len(latents) or stored.tobytes() != latents[index].tobytes():
            raise ResumeError(
                f"candidate {index} of generation {generation} in the run file has another latent than the optimiser "
                f"asks for; the run was made with another seed, configuration or version of cma or numpy"
            )
