"""How many of the same random bodies can be built by each set of rules: the pass-through table, paired.

    python -m experiments.passthrough_study -n 1000 --seed 0 --out DIR --auto 100 --repair 200

Every body is scored by the paper's rules and by the search; of the first few, those that the search refuses are also
repaired, and all have parts sized to them. Every verdict is a line of verdicts.jsonl before the next one starts: the
same command goes on where it was stopped or killed, and -n, --auto and --repair may grow. A body that crashes or takes
longer than --timeout is a worker's failure by those rules.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from experiments.json_lines import Row, appending, read_rows
from experiments.output import (
    BAD_INPUT,
    DONE,
    INTERRUPTED,
    BadInput,
    add_decoder_option,
    count,
    make_folder,
    progress,
    say,
    seed,
)
from experiments.passthrough_table import table
from experiments.run_folder import cores, locked, terminable, worker_count, write_json

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mfg.outcome import Failure
    from mfg.pipeline import Outcome

VERDICTS, RESULT, TABLE = "verdicts.jsonl", "passthrough.json", "passthrough.md"
TIMEOUT = 60.0  # for one task of one body [s]
Part = Literal["rules", "repair", "auto"]  # of the work on one body, in the order in which they are done
RULES_OF: dict[Part, tuple[str, ...]] = {"rules": ("paper", "search"), "repair": ("repair",), "auto": ("auto",)}


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """One part of the work on one body."""

    body: int
    part: Part
    latent: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Work:
    """The verdicts of one task, by the name of the rules; they depend on the decoder and the task alone."""

    decoder: str

    def __call__(self, task: Task) -> dict[str, Any]:
        """A line for the file, without what names the task."""
        from experiments.study import decoder_of

        design = decoder_of(self.decoder).decode(task.latent[None])[0]
        verdicts = {"rules": self._rules, "repair": self._repair, "auto": self._auto}[task.part](design)
        return {"design": design.key, "verdicts": verdicts}

    def _rules(self, design: Any) -> dict[str, Any]:
        """Both rules; bones and skins, before any hardware, are made once."""
        from mfg.blueprint import Blueprint
        from mfg.parts import PAPER
        from mfg.pipeline import BODIES, run, scoring

        bare = run(BODIES, Blueprint(design, PAPER))
        found = {}
        for rules in RULES_OF["rules"]:
            solvers = scoring(rules)  # type: ignore[arg-type]
            assert solvers[: len(BODIES)] == BODIES
            found[rules] = bare if bare.failure is not None else run(solvers[len(BODIES) :], bare.blueprint)
        return {rules: _verdict(outcome) for rules, outcome in found.items()}

    def _repair(self, design: Any) -> dict[str, Any]:
        from evo.judge import Judge
        from mfg.repair import repaired

        judge = Judge("search")
        found = repaired(judge.score(design), judge.score)
        return {"repair": _verdict(found.outcome) | {"changes": list(map(str, found.changes)), "tried": found.tried}}

    def _auto(self, design: Any) -> dict[str, Any]:
        from evo.judge import Judge

        found = Judge("search").sized(design, _library())
        told = {"end": str(found.end), "rounds": len(found.rounds), "why": found.reason}
        return {"auto": _verdict(found.verdict) | told | {"catalogue": found.outcome.to_json()["catalogue"]}}


def main() -> int:
    """Judge the bodies and write the table."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.passthrough_study", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("-n", type=count, default=1000, help="how many bodies (1000)")
    parser.add_argument("--seed", type=seed, default=0, help="seed of the draw, as of `bodyplan study` (0)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--auto", type=_some, default=0, metavar="M", help="size parts for the first M bodies (0)")
    parser.add_argument("--repair", type=_some, default=0, metavar="M", help="repair among the first M bodies (0)")
    parser.add_argument("--workers", type=worker_count, help="processes; 0 works in this one (one per core)")
    parser.add_argument(
        "--timeout", type=float, default=TIMEOUT, help=f"of one body by one set of rules [s] ({TIMEOUT:g})"
    )
    add_decoder_option(parser)
    args = parser.parse_args()
    make_folder(args.out)
    try:
        with terminable(), locked(args.out):
            return study(args)
    except KeyboardInterrupt:
        say("\ninterrupted; every verdict so far is kept, and the same command goes on")
        return INTERRUPTED


def study(args: argparse.Namespace) -> int:
    """Judge what is missing; write tables."""
    import numpy as np

    from decoder.latent import sample_latents

    path = args.out / VERDICTS
    head = {"seed": args.seed, "decoder": args.decoder, "program": _program(args.decoder)}
    try:
        lines = read_rows(path)
    except BadInput as trouble:
        say(str(trouble))
        return BAD_INPUT
    if lines and lines[0] != head:
        say(
            f"{path} was made otherwise: it says {json.dumps(lines[0])}, now it is {json.dumps(head)}; "
            "choose another --out"
        )
        return BAD_INPUT
    latents = sample_latents(args.n, np.random.default_rng(args.seed))
    with appending(path) as add:
        if not lines:
            add(head)
        _judge(args, latents, lines[1:], add)
    verdicts = by_rules(read_rows(path)[1:], args.n, {"repair": args.repair, "auto": args.auto})
    text, result = table(verdicts)
    write_json(args.out / RESULT, head | {"n": args.n} | result)
    (args.out / TABLE).write_text(text + "\n", encoding="utf-8")
    print(text)
    return DONE


def by_rules(lines: list[dict[str, Any]], n: int, limits: dict[str, int]) -> dict[str, dict[int, dict[str, Any]]]:
    """Verdicts by rules and body, of the first `n` bodies and for some rules of fewer.

    A body that the search passes needs no repair, and one that it loses gets none.
    """
    found: dict[str, dict[int, dict[str, Any]]] = {"paper": {}, "search": {}, "auto": {}, "repair": {}}
    for line in lines:
        for rules, verdict in line["verdicts"].items():
            if line["body"] < min(n, limits.get(rules, n)):
                found[rules][line["body"]] = verdict
    for body, verdict in found["search"].items():
        if body < limits["repair"] and not _refused(verdict):
            found["repair"][body] = verdict
    return {rules: dict(sorted(verdicts.items())) for rules, verdicts in found.items() if verdicts}


def _judge(
    args: argparse.Namespace, latents: NDArray[np.float32], lines: list[Row], add: Callable[[Row], None]
) -> None:
    from evo.pool import Pool
    from mfg.outcome import Failure

    done = {(line["body"], line["part"]) for line in lines}
    refused = {line["body"] for line in lines if _refused(line["verdicts"].get("search"))}
    workers = cores() if args.workers is None else args.workers
    with Pool[Task, "dict[str, Any]"](Work(args.decoder), workers, args.timeout) as pool:
        for part in RULES_OF:
            bodies = {
                "rules": range(args.n),
                "repair": sorted(body for body in refused if body < min(args.n, args.repair)),
                "auto": range(min(args.n, args.auto)),
            }[part]
            tasks = [Task(body, part, latents[body]) for body in bodies if (body, part) not in done]
            for task, answer, seconds in progress(pool.run(tasks), len(tasks), part) if tasks else ():
                if isinstance(answer, Failure):
                    answer = {"design": None, "verdicts": {rules: _failed(answer) for rules in RULES_OF[part]}}
                add({"body": task.body, "part": part, **answer, "seconds": round(seconds, 3)})
                if _refused(answer["verdicts"].get("search")):
                    refused.add(task.body)


def _refused(verdict: dict[str, Any] | None) -> bool:
    """Whether solvers refused a body; one that was lost might be lost again."""
    return verdict is not None and verdict["outcome"] not in ("passed", "worker")


def _verdict(outcome: Outcome) -> dict[str, Any]:
    told = {"outcome": "passed"} if outcome.failure is None else _failed(outcome.failure)
    return told | {"scores": list(outcome.scores.values()), "seconds": round(sum(outcome.seconds.values()), 3)}


def _failed(failure: Failure) -> dict[str, Any]:
    return {"outcome": str(failure.stage), "reason": str(failure.reason), "detail": failure.detail}


def _program(decoder: str) -> str:
    """Digest of the numbers that verdicts follow from and no option names."""
    from decoder.latent import decoder_digest, make_decoder
    from mfg.parts import PAPER
    from mfg.pipeline import RULES

    text = repr((decoder_digest(make_decoder(decoder)), dict(RULES), PAPER, _library()))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _library() -> Any:
    from mfg.library import read_library

    return read_library()


def _some(text: str) -> int:
    return 0 if text == "0" else count(text)


if __name__ == "__main__":
    raise SystemExit(main())
