"""What share of its speed a policy keeps when the robot is not quite the one it was trained on.

    python -m experiments.robustness runs/walk runs/tripod --out DIR

Every folder is one that `bodyplan train` left. Speeds are means over starts that differ by a hair, because one walk
says little about a walk that is nearly the same.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import BAD_INPUT, DONE, BadInput, make_folder, progress, say
from experiments.run_folder import cores, write_json

if TYPE_CHECKING:
    from mujoco import MjSpec

    from mfg.description import Description
    from sim.randomisation import Draws

SECONDS, COPIES = 10.0, 8  # of each walk, and walks of each condition
NOMINAL = "as trained"
PER_JOINT = ("stiffness", "damping")  # what is drawn for each joint
SAME_MASS = 1e-4  # relative difference of mass that versions may make; rules and parts make more


@dataclass(frozen=True, slots=True)
class Condition:
    """One way in which the robot differs.

    Attributes:
        name: in the table.
        change: of what is drawn for each copy.
        level: of the skin, a name of `sim.skin.Fidelity`.
        timestep: of the physics; None for the level's own [s].
        full_hull: every corner of the hulls.
    """

    name: str
    change: Callable[[Draws], Draws] = lambda draws: draws
    level: str = "compliant"
    timestep: float | None = None
    full_hull: bool = False


def conditions() -> tuple[Condition, ...]:
    """The table's rows, the robot as trained first."""
    import numpy as np

    from sim.randomisation import WHITE

    def every(field: str, value: float) -> Callable[[Draws], Draws]:
        def change(draws: Draws) -> Draws:
            copies, n = draws.encoder_offset.shape
            changed: dict[str, Any] = {field: np.full((copies, n) if field in PER_JOINT else copies, value)}
            return replace(draws, **changed)

        return change

    def gains(factor: float) -> Callable[[Draws], Draws]:
        return lambda draws: every("damping", factor)(every("stiffness", factor)(draws))

    return (
        Condition(NOMINAL),
        Condition("latency 20 ms", every("latency", 0.020)),
        Condition("latency 40 ms", every("latency", 0.040)),
        Condition("gains x 0.7", gains(0.7)),
        Condition("gains x 1.4", gains(1.4)),
        Condition("friction 0.4", every("friction", 0.4)),
        Condition("friction 1.2", every("friction", 1.2)),
        Condition("mass - 20 %", every("mass", 0.8)),
        Condition("mass + 20 %", every("mass", 1.2)),
        Condition("sensor noise", lambda draws: replace(draws, noise=WHITE)),
        Condition("step 1 ms", timestep=0.001),
        Condition("full hulls", full_hull=True),
        Condition("sprung pads", level="sprung"),
        Condition("flex skin", level="flex"),
    )


def speeds(folder: Path, condition: Condition, seed: int = 0, nthread: int = 1) -> list[float]:
    """Speed of every walk of the bundle's policy under a condition, times the share upright; 0 where it exploded."""
    import numpy as np

    from experiments.policy import load_driver
    from sim.closed_loop import roll_out_actor
    from sim.herd import with_latency_room
    from sim.randomisation import nominal
    from sim.rollout import measure
    from sim.verdict import HAIR

    model = with_latency_room(_spec(folder, condition))
    driver = load_driver(folder, model)
    rng = np.random.default_rng(seed)
    draws = condition.change(
        replace(nominal(COPIES, model.nu), encoder_offset=rng.uniform(-HAIR, HAIR, (COPIES, model.nu)))
    )
    if draws.mass is not None:
        draws = replace(draws, mass=np.repeat(draws.mass[:, None], model.nbody - 1, axis=1))
    rollouts = roll_out_actor(model, driver.actor, SECONDS, copies=COPIES, draws=draws, rng=rng, nthread=nthread)
    return [0.0 if b is None else b.speed * b.upright for b in measure(model, rollouts)]


def _spec(folder: Path, condition: Condition) -> MjSpec:
    from sim.model import load_spec, make_spec
    from sim.skin import Fidelity

    level = Fidelity(condition.level)
    if condition.full_hull:
        spec = make_spec(_full(_blueprint(folder)), fidelity=level)
        for mesh in spec.meshes:
            mesh.maxhullvert = -1  # no limit
        return spec
    return load_spec(folder / "robot.xml", fidelity=level, timestep=condition.timestep)


@cache
def _full(folder: Path) -> Description:
    """The robot of a blueprint folder with every corner of its hulls, by the rules that it was built by.

    Raises:
        BadInput: if another mass comes out by them.
    """
    from experiments.build import read_design
    from mfg.description import FULL_HULL, describe
    from mfg.manifest import read_description, read_manifest
    from mfg.pipeline import DEFAULT, RULES, build

    design, mass = read_design(folder / "design.npz"), read_description(folder).mass
    stated = read_manifest(folder).get("rules")  # older folders do not tell
    named = [rules for rules in RULES if rules == stated]
    for rules in named or dict.fromkeys((DEFAULT, *RULES)):
        outcome = build(design, rules=rules)
        if not outcome.ok:
            continue
        robot = describe(outcome.blueprint, hull_vertices=FULL_HULL)
        if math.isclose(robot.mass, mass, rel_tol=SAME_MASS):
            return robot
    raise BadInput(f"{folder} holds another robot than its design gives by the folder's rules with the paper's parts")


def _blueprint(folder: Path) -> Path:
    """Of the robot that a policy was trained on: beside the policy where it was made for it, else where it lay."""
    own = folder / "blueprint"
    return own if own.is_dir() else Path(json.loads((folder / "result.json").read_text("utf-8"))["robot"])


def table(results: dict[str, dict[str, list[float]]]) -> str:
    """Markdown: one row per condition, one column per policy with the share of speed it keeps, and the worst."""
    names = list(results)
    mean = {name: {row: sum(walks) / len(walks) for row, walks in found.items()} for name, found in results.items()}
    lines = ["| | " + " | ".join(names) + " |", "|---|" + "---:|" * len(names)]
    rows = list(next(iter(mean.values())))
    for row in rows:
        cells = [
            f"{mean[n][row]:.2f} m/s" if row == NOMINAL else f"{mean[n][row] / mean[n][NOMINAL]:.2f}" for n in names
        ]
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    worst = [f"**{min(v for k, v in mean[n].items() if k != NOMINAL) / mean[n][NOMINAL]:.2f}**" for n in names]
    return "\n".join([*lines, "| **worst** | " + " | ".join(worst) + " |"])


def main() -> int:
    """Measure every folder under every condition."""
    parser = argparse.ArgumentParser(prog="python -m experiments.robustness", description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="folders of `bodyplan train`")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="robustness.md and robustness.json")
    args = parser.parse_args()
    for folder in args.folders:
        if not (folder / "bundle.json").exists():
            say(f"{folder} has no bundle.json; give folders that `bodyplan train` left")
            return BAD_INPUT
        if not (_blueprint(folder) / "design.npz").exists():
            say(f"{folder}: the blueprint it was trained on is no longer at {_blueprint(folder)}")
            return BAD_INPUT
    try:
        for folder in args.folders:
            _full(_blueprint(folder))  # before any walk is spent on the others
    except BadInput as trouble:
        say(str(trouble))
        return BAD_INPUT
    make_folder(args.out)
    work = [(folder, condition) for folder in args.folders for condition in conditions()]
    results: dict[str, dict[str, list[float]]] = {folder.name: {} for folder in args.folders}
    for folder, condition in progress(work, len(work), "walks"):
        results[folder.name][condition.name] = speeds(folder, condition, nthread=cores())
        write_json(args.out / "robustness.json", results)
    (args.out / "robustness.md").write_text(table(results) + "\n", encoding="utf-8")
    print(table(results))
    return DONE


if __name__ == "__main__":
    raise SystemExit(main())
