"""How well cheap fitness ranks bodies: the ladder from random gaits to a long training, on the same random bodies.

    python -m experiments.fitness_study -n 30 --seed 0 --out DIR

Every body is measured on each rung as a virtual robot, then its best policy is let loose on its twin, unchanged. A body
is one line of DIR/bodies.jsonl, written when it is done, so that the study may be stopped and goes on where it was; the
line has the policy, too, in the form of a policy bundle, to measure it again elsewhere.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.json_lines import appending, read_rows
from experiments.output import DONE, BadInput, add_decoder_option, add_solver_option, make_folder, progress, say
from experiments.run_folder import cores

if TYPE_CHECKING:
    import numpy as np

    from experiments.output import Solvers
    from sim.model import Model
    from sim.rollout import Behaviour

GAITS, GAIT_SECONDS = 24, 6.0  # of the first rung
STARTS, RACE_STEPS = 4, 60_000
CHECKPOINTS = 10  # evaluations of the long training
BODY_TIMEOUT = 7200.0  # [s]


@dataclass(frozen=True, slots=True)
class Ladder:
    """Measure one body on every rung; the answer depends on the body and these fields alone.

    Attributes:
        seed: of everything but the body.
        steps: of the long training.
        decoder: that made the latents' bodies.
        rules: by which its twin is built.
    """

    seed: int
    steps: int
    decoder: str
    rules: Solvers

    def __call__(self, latent: np.ndarray) -> dict[str, Any] | None:
        """None for a body that cannot be built."""
        import numpy as np

        from decoder.latent import make_decoder
        from hardware.actor_document import actor_document
        from mfg import pipeline
        from mfg.description import describe
        from sim.gaits import SCREENING, THOROUGH, search_gait
        from sim.herd import with_latency_room
        from sim.model import make_spec
        from sim.plan import Training
        from sim.race import speed, starts
        from sim.surfaces import body_length
        from sim.training import Trainer

        design = make_decoder(self.decoder).decode(latent[None])[0]
        built = pipeline.build(design, rules=self.rules)
        bare = pipeline.virtual(design)
        if not built.ok or not bare.ok:
            return None
        virtual = describe(bare.blueprint)
        model = with_latency_room(make_spec(virtual))
        seated = describe(built.blueprint)
        twin = with_latency_room(make_spec(seated))
        row: dict[str, Any] = {
            "design": design.key, "solver": self.rules, "joints": model.nu, "mass_kg": virtual.mass,
            "body_length_m": body_length(model),
        }  # fmt: skip
        clock = time.process_time()

        def lap(name: str) -> None:
            nonlocal clock
            row[f"cpu_{name}"] = time.process_time() - clock
            clock = time.process_time()

        rng = np.random.default_rng(self.seed)
        row["random"] = random_gaits(model, rng)
        lap("random")
        for name, budget in (("screening", SCREENING), ("thorough", THOROUGH)):
            found = search_gait(model, np.random.default_rng(self.seed), budget)
            row[name] = {"score": found.score, "speed": found.speed, "heading": found.heading}
            lap(name)
        training = Training(self.seed, self.steps, -(-self.steps // CHECKPOINTS))
        candidates = starts(found.gait, found.heading, STARTS)
        row["race"] = [speed(model, training, RACE_STEPS, start) for start in candidates]
        lap("race")
        trainer = Trainer(model, training, candidates[int(np.argmax(row["race"]))])
        row["training"] = []
        while trainer.done < training.chunks:
            chunk = trainer.advance()
            v = chunk.verdict
            row["training"].append({"steps": chunk.steps, "cpu": chunk.seconds, "exploring": chunk.exploring_speed,
                                    "speed": v.speed, "robust": v.robust_speed, "falls": v.falls})  # fmt: skip
        lap("training")
        assert trainer.best is not None
        row["virtual"], row["twin"] = (episode(robot, trainer.best) for robot in (model, twin))
        row["twin_ranges_differ"] = not np.allclose(model.jnt_range, twin.jnt_range, atol=1e-3)
        row["twin_mass_kg"] = float(twin.body_subtreemass[1])
        row["twin_hull_shift_m"] = abs(body_length(model) - body_length(twin))
        row["twin_imu_link"], row["twin_imu_turn_rad"] = seated.imu_link, _angle(seated.T_link_imu[:3, :3])
        row["policy"] = actor_document(trainer.best)
        return row


def random_gaits(model: Model, rng: np.random.Generator) -> list[dict[str, float]]:
    """What random gaits do; nothing where the physics exploded."""
    from sim.gaits import decode, random_points
    from sim.model import drive_of
    from sim.rollout import measure, roll_out

    drive = drive_of(model)
    gaits = [decode(drive, point) for point in random_points(drive, GAITS, rng)]
    return [_numbers(b) for b in measure(model, roll_out(model, gaits, GAIT_SECONDS)) if b is not None]


def episode(model: Model, actor: Any) -> dict[str, float] | None:
    """What a policy does in 10 s on a model as it is; None if its physics explodes."""
    from sim.closed_loop import roll_out_actor
    from sim.rollout import measure

    behaviour = measure(model, roll_out_actor(model, actor, 10.0))[0]
    return None if behaviour is None else _numbers(behaviour)


def _numbers(behaviour: Behaviour) -> dict[str, float]:
    return {"speed": behaviour.speed, "distance": behaviour.distance, "upright": behaviour.upright,
            "seconds": behaviour.seconds, "overload": behaviour.overload}  # fmt: skip


def _angle(R: np.ndarray) -> float:
    """Of a rotation matrix [rad]."""
    return math.acos(min(1.0, max(-1.0, (float(R.trace()) - 1.0) / 2.0)))


def main() -> int:
    """Run the study as far as it is not done, then tell what it says."""
    parser = argparse.ArgumentParser(prog="python -m experiments.fitness_study", description=__doc__)
    parser.add_argument("-n", type=int, default=30, help="bodies that can be built (30)")
    parser.add_argument("--seed", type=int, default=0, help="of the bodies and of everything else (0)")
    parser.add_argument("--steps", type=int, default=2_000_000, help="of the long training (2000000)")
    add_decoder_option(parser)
    add_solver_option(parser)
    parser.add_argument("--workers", type=int, default=cores(), help="processes (one per core)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    args = parser.parse_args()
    from experiments.fitness_table import write_tables

    try:
        run(args.n, args.seed, args.steps, args.decoder, args.solver, args.workers, make_folder(args.out))
    except BadInput as trouble:
        parser.error(str(trouble))
    print(write_tables(args.out))
    return DONE


def run(n: int, seed: int, steps: int, decoder: str, rules: Solvers, workers: int, folder: Path) -> None:
    """Measure the first n bodies of the prior that can be built, those of them that are not measured yet.

    Raises:
        BadInput: if the folder holds bodies that were built by other rules.
    """
    import numpy as np

    from decoder.latent import sample_latents
    from evo.pool import Pool
    from mfg.outcome import Failure

    path = folder / "bodies.jsonl"
    rows = read_rows(path)
    if any(row.get("solver", "paper") != rules for row in rows):  # an older row is of the paper's rules
        raise BadInput(f"{path} holds bodies built by other rules than {rules}; choose another --out")
    done = {row["design"] for row in rows}
    latents = sample_latents(20 * n, np.random.default_rng(seed))
    chosen: list[tuple[str, Any]] = []
    with Pool[Any, Any](Passes(decoder, rules), workers, BODY_TIMEOUT) as pool:
        keys: dict[bytes, str | None] = {}
        for latent, key, _ in progress(pool.run(latents[: 6 * n]), 6 * n, "scoring"):
            keys[latent.tobytes()] = None if isinstance(key, Failure) else key
    chosen = [(key, latent) for latent in latents[: 6 * n] if (key := keys[latent.tobytes()]) is not None][:n]
    todo = [latent for key, latent in chosen if key not in done]
    with Pool[Any, Any](Ladder(seed, steps, decoder, rules), workers, BODY_TIMEOUT) as pool, appending(path) as add:
        for _, row, seconds in progress(pool.run(todo), len(todo), "bodies"):
            if isinstance(row, Failure) or row is None:
                say(f"a body is lost: {row}")
                continue
            add(row | {"seconds": seconds})


@dataclass(frozen=True, slots=True)
class Passes:
    """The key of a latent's body if it can be built by some rules, else None."""

    decoder: str
    rules: Solvers

    def __call__(self, latent: np.ndarray) -> str | None:
        """Decode and build: what passes on fields may, rarely, fail on exact solids."""
        from decoder.latent import make_decoder
        from mfg import pipeline

        design = make_decoder(self.decoder).decode(latent[None])[0]
        built = pipeline.score(design, rules=self.rules).ok and pipeline.build(design, rules=self.rules).ok
        return design.key if built else None


if __name__ == "__main__":
    raise SystemExit(main())
