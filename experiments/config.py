"""The configuration of every experiment: frozen records, read from TOML files and written to them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from experiments.output import (
    DECODERS,
    DEFAULT_DECODER,
    DEFAULT_SOLVER,
    MOST_BODIES,
    SEED_BOUND,
    WEIGHTS_SUFFIX,
    BadInput,
    Catalogues,
    Priors,
    Solvers,
)
from experiments.policy_config import Policy
from experiments.toml_document import checked, read_document, remedy, shown
from experiments.toml_text import flat, toml_table, toml_value

if TYPE_CHECKING:
    from evo.evaluate import Learning as Rung
    from evo.fitness import FitnessRule
    from sim.gaits import GaitBudget

Seed = Annotated[int, Meta(ge=0, le=SEED_BOUND - 1)]
Seconds = Annotated[float, Meta(ge=0.1, le=1000.0)]
Film = Annotated[float, Meta(ge=0.0, le=100.0)]
Workers = Annotated[int, Meta(ge=0, le=1024)]
DecoderName = Annotated[
    str,
    Meta(
        pattern=rf"^({'|'.join(DECODERS)}|[^\x00-\x1f\x7f]*{re.escape(WEIGHTS_SUFFIX)})\Z",
        description=" | ".join([*(f'"{name}"' for name in DECODERS), f"a file ending in {WEIGHTS_SUFFIX}"]),
        examples=list(DECODERS),
    ),
]
Folder = Annotated[str, Meta(min_length=1)]

NO_RESULT = ("workers", "film")  # keys that change no number of a run


class Search(Struct, frozen=True, forbid_unknown_fields=True):
    """CMA-ES over the latent space.

    Attributes:
        generations: how many.
        popsize: candidates of each.
        start: "best" samples the prior once and goes on from the best; "origin" narrows down from the whole prior.
        sigma: first standard deviation of the search, 1 for "origin".
    """

    generations: Annotated[int, Meta(ge=1, le=1_000_000)] = 40
    popsize: Annotated[int, Meta(ge=4, le=100_000)] = 22
    start: Literal["best", "origin"] = "best"
    sigma: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.35


class Fitness(Struct, frozen=True, forbid_unknown_fields=True):
    """How speed and manufacturability are combined, see `evo.fitness.FitnessRule`.

    Attributes:
        mode: the rule.
        weight: of "penalty" [m/s].
        bound: of "constraint".
    """

    mode: Literal["penalty", "constraint", "speed"] = "penalty"
    weight: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.2
    bound: Annotated[float, Meta(ge=0.0, le=5.0)] = 2.5

    def rule(self) -> FitnessRule:
        """As evolution wants it."""
        from evo.fitness import FitnessRule

        return FitnessRule(self.mode, self.weight, self.bound)


class Gait(Struct, frozen=True, forbid_unknown_fields=True):
    """What the search for a gait may spend, see `sim.gaits.GaitBudget`."""

    random: Annotated[int, Meta(ge=2, le=10_000)] = 12
    random_seconds: Seconds = 3.0
    generations: Annotated[int, Meta(ge=0, le=10_000)] = 13
    population: Annotated[int, Meta(ge=4, le=10_000)] = 8
    seconds: Seconds = 4.0
    finalists: Annotated[int, Meta(ge=1, le=1000)] = 3
    final_seconds: Seconds = 10.0
    hopeless: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.005

    def budget(self) -> GaitBudget:
        """As the search wants it."""
        from sim.gaits import GaitBudget

        return GaitBudget(**msgspec.structs.asdict(self))


class ThoroughGait(Gait, frozen=True, forbid_unknown_fields=True):
    """The same for a body that will be built: keys that are left out have larger values."""

    random: Annotated[int, Meta(ge=2, le=10_000)] = 16
    generations: Annotated[int, Meta(ge=0, le=10_000)] = 20
    population: Annotated[int, Meta(ge=4, le=10_000)] = 12
    seconds: Seconds = 6.0


class Learning(Struct, frozen=True, forbid_unknown_fields=True):
    """Short trainings of a policy on every body whose gait earns them, see `evo.evaluate.Learning`.

    Attributes:
        steps: control periods of each, 0 for none.
        starts: how many compete on a body.
        least: score of a gait that earns them [m/s].
    """

    steps: Annotated[int, Meta(ge=0, le=100_000_000)] = 0
    starts: Annotated[int, Meta(ge=1, le=64)] = 4
    least: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.02

    def rung(self) -> Rung | None:
        """As evolution wants it."""
        from evo.evaluate import Learning

        return Learning(self.steps, self.starts, self.least) if self.steps else None


class Finals(Struct, frozen=True, forbid_unknown_fields=True):
    """The last round, on twins.

    Attributes:
        heat: how many of the best are built and measured together; further heats follow until one walks.
        gait: budget of each.
    """

    heat: Annotated[int, Meta(ge=1, le=1000)] = 4
    gait: ThoroughGait = ThoroughGait()


class Evolve(Struct, frozen=True, forbid_unknown_fields=True):
    """An evolution.

    Attributes:
        kind: "evolve".
        seed: of everything random.
        decoder: what turns latents into bodies: a name, or a file of weights for the learned decoder; in a
            configuration file its path is relative to that file.
        solver: how manufacturing constraints are solved.
        catalogue: which components: the paper's, or "auto" for those that each robot's own gait asks for.
        parts: with "auto", a folder of component files to choose from too; in a configuration file its path is
            relative to that file.
        workers: processes; none given means one per core. It changes no result.
        film: length of the winner's film [s], 0 for none. It changes no result.
        timeout: how long one evaluation may take before it is stopped [s]; a hang, for whatever takes seconds.
        search: the optimiser.
        fitness: the rule.
        gait: budget of every evaluation.
        learning: what follows the gait, in every evaluation and in the last round.
        finals: the last round.
    """

    kind: Literal["evolve"]
    seed: Seed = 0
    decoder: DecoderName = DEFAULT_DECODER
    solver: Solvers = DEFAULT_SOLVER
    catalogue: Catalogues = "paper"
    parts: Folder | None = None
    workers: Workers | None = None
    film: Film = 6.0
    timeout: Annotated[float, Meta(ge=1.0, le=1e6)] = 1800.0
    search: Search = Search()
    fitness: Fitness = Fitness()
    gait: Gait = Gait()
    learning: Learning = Learning()
    finals: Finals = Finals()


class Study(Struct, frozen=True, forbid_unknown_fields=True):
    """The paper's experiment: what share of random bodies can be built, and what stops the others.

    Attributes:
        kind: "study".
        n: how many bodies.
        seed: of the draw.
        decoder: what turns latents into bodies: a name, or a file of weights for the learned decoder; in a
            configuration file its path is relative to that file.
        prior: law of the latents.
        solver: how manufacturing constraints are solved.
        catalogue: which components: the paper's, or "auto" for those that each robot's own gait asks for.
        parts: with "auto", a folder of component files to choose from too; in a configuration file its path is
            relative to that file.
        repair: whether bodies that cannot be built are changed as little as helps; they are counted apart.
        workers: processes; none given means one per core. It changes no result.
    """

    kind: Literal["study"]
    n: Annotated[int, Meta(ge=1, le=MOST_BODIES)] = 1000
    seed: Seed = 0
    decoder: DecoderName = DEFAULT_DECODER
    prior: Priors = "normal"
    solver: Solvers = DEFAULT_SOLVER
    catalogue: Catalogues = "paper"
    parts: Folder | None = None
    repair: bool = False
    workers: Workers | None = None


class Sketch(Struct, frozen=True, forbid_unknown_fields=True):
    """A body that somebody painted: its blueprint, a gait for it and a dry run.

    Attributes:
        kind: "sketch".
        design: the file (.npz or .vox); in a configuration file its path is relative to that file.
        seed: of the search for a gait.
        solver: how manufacturing constraints are solved.
        catalogue: which components: the paper's, or "auto" for those that each robot's own gait asks for.
        parts: with "auto", a folder of component files to choose from too; in a configuration file its path is
            relative to that file.
        film: length of the film [s], 0 for none. It changes no result.
        gait: budget of the search.
    """

    kind: Literal["sketch"]
    design: Annotated[str, Meta(min_length=1)]
    seed: Seed = 0
    solver: Solvers = DEFAULT_SOLVER
    catalogue: Catalogues = "paper"
    parts: Folder | None = None
    film: Film = 6.0
    gait: ThoroughGait = ThoroughGait()


Config = Evolve | Study | Sketch | Policy
KINDS: dict[str, type[Config]] = {"evolve": Evolve, "study": Study, "sketch": Sketch, "policy": Policy}


def load_config(path: Path) -> Config:
    """Read a configuration file.

    Raises:
        BadInput: naming the file, the key, its value, what is allowed and, for a typo, what was probably meant.
        OSError: if it cannot be read.
    """
    document = read_document(path)
    config = parse_config(document, str(path))
    if not isinstance(config, Policy) and config.parts is not None:
        config = msgspec.structs.replace(config, parts=str((path.parent / config.parts).resolve()))
    if isinstance(config, Sketch):
        return msgspec.structs.replace(config, design=str((path.parent / config.design).resolve()))
    if isinstance(config, Policy):
        return msgspec.structs.replace(config, robot=str((path.parent / config.robot).resolve()))
    if config.decoder not in DECODERS:
        return msgspec.structs.replace(config, decoder=str((path.parent / config.decoder).resolve()))
    return config


def parse_config(document: dict[str, Any], name: str) -> Config:
    """Check a document read from TOML.

    Args:
        document: tables and values.
        name: of the file, for messages.

    Raises:
        BadInput: as `load_config`.
    """
    kind = document.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        known = " | ".join(f'"{k}"' for k in KINDS)
        if kind is None:
            raise BadInput(f"{name}: kind is missing; add a line kind = {known}")
        if kind == "train-decoder":
            raise BadInput(f'{name}: kind = "{kind}"; give this file to `bodyplan train-decoder`')
        raise BadInput(f"{name}: kind = {shown(kind)}; it must be {known}{remedy(kind, list(KINDS))}")
    config = checked(document, KINDS[kind], name)
    if not isinstance(config, Policy) and config.parts is not None and config.catalogue != "auto":
        raise BadInput(f"{name}: parts = {shown(config.parts)}; there is nothing to choose from them but with "
                       'catalogue = "auto"')  # fmt: skip
    return config


def to_toml(config: Struct) -> str:
    """Write a configuration with every value, so that it says all there is to say about a run."""
    return "".join(toml_table(msgspec.to_builtins(config), ""))


def config_hash(config: Config) -> str:
    """16 hex digits over everything that can change a result."""
    lines = [f"{key} = {toml_value(value)}" for key, value in flat(config) if key not in NO_RESULT]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def differences(then: Struct, now: Struct, free: Sequence[str] = NO_RESULT) -> list[str]:
    """What two configurations disagree on, but for the keys that are free to differ: those that change no result."""
    before, after = dict(flat(then)), dict(flat(now))
    keys = [key for key in {**before, **after} if key not in free and before.get(key) != after.get(key)]
    return [f"{key} was {shown(before.get(key))} and is now {shown(after.get(key))}" for key in keys]
