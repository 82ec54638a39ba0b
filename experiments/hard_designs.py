"""Throw designs of every kind at the pipeline: each must end in a robot, a reason or a refusal, and soon.

    python -m experiments.hard_designs --random 10000 --garbage 2000 --out DIR

Random bodies come from the default decoder's prior. Garbage is made of them and of noise: latents far out, voxels
turned over at random, joints anywhere, absurd sizes, arrays that mean nothing, files with broken bytes. Nothing may
raise, hang or leave a mesh that is not closed without a word. What is done already in DIR is not done again.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.json_lines import appending, read_rows
from experiments.output import BAD_INPUT, DONE, INFEASIBLE, add_solver_option, count, make_folder, progress, say
from experiments.run_folder import cores

if TYPE_CHECKING:
    import numpy as np

    from decoder.design import VoxelDesign
    from mfg.pipeline import Outcome, Rules

PATIENCE = 30.0  # for one design [s]
SEED = 0
BUILT = 20  # one in so many random bodies that pass is made of exact solids, too; of garbage every one
Garbage = Callable[["np.random.Generator"], "VoxelDesign"]


@dataclass(frozen=True, slots=True)
class Task:
    """One design: the `index`-th of its kind, random or garbage."""

    kind: str
    index: int


@dataclass(frozen=True, slots=True)
class Try:
    """Make one design and judge it, by the rules that are given; the answer depends on the task alone."""

    rules: Rules

    def __call__(self, task: Task) -> dict[str, Any]:
        """How it ended: refused (no design at all), failed (a solver's reason), passed, or invalid (an open mesh)."""
        import numpy as np

        from decoder.design import DesignError
        from mfg.pipeline import build, score

        rng = np.random.default_rng([SEED, len(task.kind), task.index])
        recipes = _garbage()
        name = list(recipes)[task.index % len(recipes)] if task.kind == "garbage" else "prior"
        answer = {"kind": task.kind, "index": task.index, "recipe": name}
        try:
            design = recipes[name](rng) if task.kind == "garbage" else _body(rng)
        except DesignError as error:
            return {**answer, "end": "refused", "why": str(error)[:200]}
        outcome = score(design, rules=self.rules)
        if outcome.failure is None and (task.kind == "garbage" or task.index % BUILT == 0):
            outcome = build(design, rules=self.rules)
            wrong = _flaws(outcome) if outcome.failure is None else []
            if wrong:
                return {**answer, "end": "invalid", "why": "; ".join(wrong)[:300]}
        if outcome.failure is None:
            return {**answer, "end": "passed", "why": ""}
        return {**answer, "end": "failed", "why": f"{outcome.failure.stage}: {outcome.failure.reason}"}


def _flaws(outcome: Outcome) -> list[str]:
    """What a foreign reader of the parts' STL files finds wrong with them."""
    from experiments.foreign_check import flaws, read_mesh
    from mfg.stl import stl_bytes, welded

    with tempfile.TemporaryDirectory() as folder:
        found = []
        for part in outcome.blueprint.parts:
            path = Path(folder) / "part.stl"
            path.write_bytes(stl_bytes(*welded(part.solid), part.name))
            found += [f"{part.name} {flaw}" for flaw in flaws(read_mesh(path))]
        return found


def _body(rng: np.random.Generator, spread: float = 1.0) -> VoxelDesign:
    from decoder.latent import DEFAULT_DECODER
    from experiments.study import decoder_of

    return decoder_of(DEFAULT_DECODER).decode(spread * rng.standard_normal((1, 512)))[0]


def _garbage() -> dict[str, Garbage]:
    """Recipes by name, each from an rng to a design or a `DesignError`."""
    import numpy as np

    from decoder.design import GRID, Joint, Material, VoxelDesign
    from decoder.latent import DEFAULT_DECODER
    from decoder.sketch import load_design
    from experiments.study import decoder_of

    def far_out(rng: np.random.Generator) -> VoxelDesign:
        return _body(rng, float(10.0 ** rng.uniform(0.3, 3.0)))

    def spiky(rng: np.random.Generator) -> VoxelDesign:
        latent = np.zeros((1, 512))
        latent[0, rng.integers(512, size=4)] = rng.uniform(-50, 50, 4)
        return decoder_of(DEFAULT_DECODER).decode(latent)[0]

    def flipped_voxels(rng: np.random.Generator) -> VoxelDesign:
        body = _body(rng)
        hit = rng.random(body.material.shape) < 10.0 ** rng.uniform(-4, -0.5)
        hit[[0, -1]] = hit[:, [0, -1]] = hit[:, :, [0, -1]] = False
        material = np.where(hit, rng.integers(0, 3, body.material.shape), body.material)
        near = rng.choice(body.segments, body.material.shape)
        segment = np.where(material == Material.RIGID, np.where(body.segment > 0, body.segment, near), 0)
        return VoxelDesign(material.astype(np.uint8), segment.astype(np.int16), body.pitch, body.joints)

    def swapped_materials(rng: np.random.Generator) -> VoxelDesign:
        body = _body(rng)
        order = rng.permutation(3)
        material = order[body.material].astype(np.uint8)
        return VoxelDesign(material, np.where(material == 2, 1, 0).astype(np.int16), body.pitch, ())

    def joints_anywhere(rng: np.random.Generator) -> VoxelDesign:
        body = _body(rng)
        low, high = body.bounds

        def moved(joint: Joint) -> Joint:
            axis = rng.standard_normal(3)
            return replace(
                joint, position=rng.uniform(low, high), axis=axis / np.linalg.norm(axis),
                range=np.array([-1.0, 1.0]) * 10.0 ** rng.uniform(-6, 0.49),
            )  # fmt: skip

        return replace(body, joints=tuple(moved(joint) for joint in body.joints))

    def absurd_size(rng: np.random.Generator) -> VoxelDesign:
        body = _body(rng)
        factor = float(10.0 ** rng.uniform(-2.5, 1.5))
        joints = tuple(replace(joint, position=joint.position * factor) for joint in body.joints)
        return VoxelDesign(body.material, body.segment, body.pitch * factor, joints, body.depth)

    def relinked(rng: np.random.Generator) -> VoxelDesign:
        body = _body(rng)
        links = rng.integers(0, 9, (len(body.joints), 2)).tolist()
        joints = [replace(j, parent=p, child=c) for j, (p, c) in zip(body.joints, links, strict=True)]
        return replace(body, joints=tuple(joints + joints[: rng.integers(0, 2)]))

    def noise(rng: np.random.Generator) -> VoxelDesign:
        material = np.zeros((GRID,) * 3, np.uint8)
        inner = (slice(1, -1),) * 3
        material[inner] = rng.choice(3, (GRID - 2,) * 3, p=rng.dirichlet([1, 1, 1]))
        count = int(rng.integers(1, 30))
        segment = np.where(material == 2, rng.integers(1, count + 1, material.shape), 0).astype(np.int16)
        joints = [Joint(rng.uniform(0.1, 0.5, 3), np.eye(3)[k % 3], np.array([-1.0, 1.0]), k, k + 1)
                  for k in range(1, count)]  # fmt: skip
        return VoxelDesign(material, segment, 0.01, tuple(joints))

    def blocks(rng: np.random.Generator) -> VoxelDesign:
        material, segment = np.zeros((GRID,) * 3, np.uint8), np.zeros((GRID,) * 3, np.int16)
        for s in range(1, int(rng.integers(2, 22))):
            low = rng.integers(1, GRID - 2, 3)
            cut = tuple(slice(a, min(GRID - 1, a + w)) for a, w in zip(low, rng.integers(1, 30, 3), strict=True))
            material[cut], segment[cut] = rng.integers(1, 3), s
        segment[material == Material.SOFT] = 0
        ids = np.unique(segment[segment > 0])
        joints = []
        for a, b in itertools.pairwise(ids):
            where = (np.argwhere(segment == a).mean(0) + np.argwhere(segment == b).mean(0) + 1) / 2 * 0.01
            joints.append(Joint(where, np.eye(3)[rng.integers(3)], np.array([-1.0, 1.0]), int(a), int(b)))
        return VoxelDesign(material, segment, 0.01, tuple(joints))

    def wrong_arrays(rng: np.random.Generator) -> VoxelDesign:
        shape = tuple(int(n) for n in rng.choice([0, 1, 63, 64, 65], rng.integers(1, 4)))
        values = rng.choice([0, 1, 2, 7, -1, 300], shape) if rng.random() < 0.5 else rng.standard_normal(shape)
        return VoxelDesign(values, values, float(rng.choice([0.01, 0.0, -1.0, np.nan, np.inf])))  # type: ignore[arg-type]

    def broken_file(rng: np.random.Generator) -> VoxelDesign:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "body.npz"
            _body(rng).save(path)
            data = bytearray(path.read_bytes())
            for at in rng.integers(len(data), size=rng.integers(1, 6)):
                data[at] = rng.integers(256)
            path.write_bytes(data[: len(data) if rng.random() < 0.5 else rng.integers(len(data))])
            return load_design(path)

    recipes = (far_out, spiky, flipped_voxels, swapped_materials, joints_anywhere, absurd_size, relinked, noise,
               blocks, wrong_arrays, broken_file)  # fmt: skip
    return {recipe.__name__: recipe for recipe in recipes}


def main(argv: list[str] | None = None) -> int:
    """Try them all; status 1 if any ended otherwise than it may."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.hard_designs", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--random", type=count, default=10000, help="bodies of the default decoder (10000)")
    parser.add_argument("--garbage", type=count, default=2000, help="mutants and garbage (2000)")
    add_solver_option(parser)
    parser.add_argument("--workers", type=count, default=cores(), help="processes (one per core)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="hard_designs.jsonl and .md")
    args = parser.parse_args(argv)
    make_folder(args.out)
    path = args.out / "hard_designs.jsonl"
    try:
        rows = read_rows(path)
    except ValueError:
        say(f"{path} holds something else than rows of this program; choose another --out")
        return BAD_INPUT
    others = sorted({str(row.get("solver")) for row in rows} - {args.solver})
    if others:
        earlier = f"--solver {others[0]}" if others[0] != "None" else "an unknown --solver"
        say(f"{path} was made by {earlier}, now it is {args.solver}; choose another --out")
        return BAD_INPUT
    known = {(row["kind"], row["index"]) for row in rows}
    tasks = [Task(kind, k) for kind, n in (("garbage", args.garbage), ("random", args.random)) for k in range(n)]
    left = [task for task in tasks if (task.kind, task.index) not in known]
    with appending(path) as add:
        for row in progress(_tried(left, args.solver, args.workers), len(left), "designs"):
            rows.append(row)
            add(row)
    (args.out / "hard_designs.md").write_text(table(rows) + "\n", encoding="utf-8")
    print(table(rows))
    wrong = [row for row in rows if row["end"] in ("invalid", "lost")]
    for row in wrong:
        say(f"WRONG {row['kind']} {row['index']} ({row['recipe']}): {row['why']}")
    return INFEASIBLE if wrong else DONE


def _tried(tasks: list[Task], rules: Rules, workers: int) -> Iterator[dict[str, Any]]:
    from evo.pool import Pool

    with Pool[Task, dict[str, Any]](Try(rules), workers, PATIENCE) as pool:
        for task, answer, seconds in pool.run(tasks):
            if not isinstance(answer, dict):  # an exception, a crash or a hang
                answer = {"kind": task.kind, "index": task.index, "recipe": "", "end": "lost", "why": str(answer)}
            yield {"solver": rules, **answer, "seconds": round(seconds, 2)}


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown: how designs of every recipe ended, and the slowest of them."""
    ends = ("refused", "failed", "passed", "invalid", "lost")
    lines = [f"| made by | designs | {' | '.join(ends)} | slowest |", "|---|" + "---:|" * (len(ends) + 2)]
    for recipe in dict.fromkeys(row["recipe"] for row in sorted(rows, key=lambda row: (row["kind"], row["recipe"]))):
        mine = [row for row in rows if row["recipe"] == recipe]
        found = Counter(row["end"] for row in mine)
        cells = " | ".join(str(found[end]) for end in ends)
        lines.append(f"| {recipe or '(lost)'} | {len(mine)} | {cells} | {max(r['seconds'] for r in mine):.1f} s |")
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
