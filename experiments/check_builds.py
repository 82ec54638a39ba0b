"""Check the files of many builds by foreign eyes: every STL and 3MF read back, every clearance by exact booleans.

    python -m experiments.check_builds -n 50 --seed 0

Random designs are drawn until n of them pass the solvers; then each is written, read back and measured. One line per
design, a summary with the agreement of fast scores and exact ones, and status 1 if anything is wrong.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.output import DONE, INFEASIBLE, add_decoder_option, progress, say

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from mfg.blueprint import Blueprint
    from mfg.solids import Solid

TOUCH = 1e-9  # overlap that rounding to the files' lattice may leave [m3]
MOST_DRAWN = 20  # designs drawn for one that passes, before the script gives up


@dataclass
class Tally:
    """What was seen so far."""

    drawn: int = 0
    passed: int = 0
    refused_late: list[str] = field(default_factory=list)  # passed the fast path, not the exact one
    problems: list[str] = field(default_factory=list)
    difference: dict[str, float] = field(default_factory=dict)  # largest, between a fast score and the exact one
    seconds: list[float] = field(default_factory=list)  # of the finish solver


def main(argv: list[str] | None = None) -> int:
    """Run the check; status 1 on any violation."""
    parser = argparse.ArgumentParser(prog="python -m experiments.check_builds", description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=50, help="designs that must pass (50)")
    parser.add_argument("--seed", type=int, default=0, help="of the random designs (0)")
    add_decoder_option(parser)
    args = parser.parse_args(argv)
    tally = Tally()
    print(f"{'design':16}  bodies  parts  motors  wires   kg    cm3   finish  files")
    for _ in progress(range(args.n), args.n, "builds"):
        if not _next(tally, args.decoder, args.seed, MOST_DRAWN * args.n):
            say(f"only {tally.passed} of {tally.drawn} designs passed; gave up")
            break
    print(_summary(tally))
    for problem in tally.problems:
        print(f"WRONG {problem}")
    return INFEASIBLE if tally.problems or tally.passed < args.n else DONE


def _next(tally: Tally, name: str, seed: int, most: int) -> bool:
    """Draw designs until one is built and checked."""
    import numpy as np

    from decoder.latent import make_decoder, sample_latents
    from mfg.finish import FinishSolver
    from mfg.outcome import Failure
    from mfg.pipeline import Outcome, score

    decoder = make_decoder(name)
    while tally.drawn < most:
        # One stream per design: the sample does not depend on how many were refused.
        latent = sample_latents(1, np.random.default_rng([seed, tally.drawn]))
        design: VoxelDesign = decoder.decode(latent)[0]
        tally.drawn += 1
        fast = score(design)
        if not fast.ok:
            continue
        start = time.process_time()
        finished = FinishSolver().solve(fast.blueprint)
        tally.seconds.append(time.process_time() - start)
        if isinstance(finished, Failure):
            tally.refused_late.append(f"{design.key}: {finished}")
            continue
        tally.passed += 1
        for name, a, b in zip(SCORES, fast.scores.values(), finished.scores.values(), strict=True):
            tally.difference[name] = max(tally.difference.get(name, 0.0), abs((a or 0.0) - (b or 0.0)))
        with tempfile.TemporaryDirectory() as folder:
            problems = check(Outcome(finished, None, {}), Path(folder) / "robot")
        tally.problems += [f"{design.key}: {problem}" for problem in problems]
        print(_row(finished, tally.seconds[-1], problems), flush=True)
        return True
    return False


SCORES = ("motor", "electronics", "cable", "electronics_install", "body_install")


def check(outcome: Any, folder: Path) -> list[str]:
    """Write a built blueprint and return everything that is wrong with its files and its geometry."""
    import numpy as np

    from mfg.export import write_blueprint
    from mfg.manifest import changed_files, part_file
    from mfg.plate import fits_printer
    from mfg.solids import Solid

    blueprint: Blueprint = outcome.blueprint
    write_blueprint(outcome, folder)
    problems = [f"{path} does not match its hash" for path in changed_files(folder)]
    solids: dict[str, Solid] = {}
    for part in blueprint.parts:
        mesh = read_mesh(folder / part_file(part))
        problems += [f"{part.name}.stl {flaw}" for flaw in flaws(mesh)]
        solids[part.name] = Solid(np.asarray(mesh.vertices) / 1e3, np.asarray(mesh.faces, np.int64))
        if abs(solids[part.name].volume / part.solid.volume - 1) > 1e-5:
            problems.append(f"{part.name}.stl has another volume than the part")
    for index, body in enumerate(blueprint.bodies):
        points = np.concatenate([solids[p.name].vertices for p in blueprint.parts if p.body == index])
        if not fits_printer(points, blueprint.catalogue.printer.volume):
            problems.append(f"{body.name} does not fit the printer")
    problems += printed_objects(blueprint, folder, solids)
    return problems + overlaps(blueprint, solids)


def read_mesh(path: Path) -> Any:
    """A mesh file as a foreign library reads it, equal corners merged."""
    import trimesh

    return trimesh.load(path, force="mesh")


def flaws(mesh: Any) -> list[str]:
    """What keeps a mesh from being one closed solid."""
    found = []
    if not mesh.is_watertight:
        found.append("is not watertight")
    if not mesh.is_winding_consistent:
        found.append("has triangles of both senses")
    if not mesh.volume > 0:
        found.append(f"has volume {mesh.volume:g}")
    if mesh.body_count != 1:
        found.append(f"has {mesh.body_count} pieces")
    return found


def printed_objects(blueprint: Blueprint, folder: Path, solids: dict[str, Solid]) -> list[str]:
    """Flaws of the objects in both 3MF files: one per body, each part a closed solid equal to its STL, on the plate."""
    import numpy as np

    problems = []
    wanted = {body.name: [part.name for part in blueprint.parts if part.body == index]
              for index, body in enumerate(blueprint.bodies)}  # fmt: skip
    for name in ("print.3mf", "print_bambu.3mf"):
        objects = read_3mf(folder / name)
        if [len(meshes) for meshes, _ in objects] != [len(parts) for parts in wanted.values()]:
            problems.append(f"{name} holds other objects than one per body")
            continue
        for (meshes, pose), (body, parts) in zip(objects, wanted.items(), strict=True):
            problems += [
                f"{name}: {part} {flaw}" for part, mesh in zip(parts, meshes, strict=True) for flaw in flaws(mesh)
            ]
            for part, mesh in zip(parts, meshes, strict=True):
                if abs(mesh.volume / 1e9 / solids[part].volume - 1) > 1e-5:
                    problems.append(f"{name}: {part} has another volume than its STL file")
            laid = np.concatenate([np.asarray(mesh.vertices) for mesh in meshes]) @ pose[:3] + pose[3]
            size = np.ptp(laid, axis=0) / 1e3
            if abs(laid[:, 2].min()) > 1e-3:
                problems.append(f"{name}: {body} stands at z = {laid[:, 2].min():.3f} mm")
            if (size > np.asarray(blueprint.catalogue.printer.volume) + 1e-5).any():
                problems.append(f"{name}: {body} is larger than the printer")
    return problems


def read_3mf(path: Path) -> list[tuple[list[Any], Any]]:
    """(part meshes [mm], pose (4, 3) for row vectors) of every built object of a 3MF file of either flavour."""
    import zipfile
    from xml.etree import ElementTree

    import numpy as np
    import trimesh

    space = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    with zipfile.ZipFile(path) as archive:
        model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
        prusa = "Metadata/Slic3r_PE_model.config"
        config = ElementTree.fromstring(archive.read(prusa)) if prusa in archive.namelist() else None
    meshes: dict[str, list[Any]] = {}
    for thing in model.iter(f"{space}object"):
        key = thing.get("id", "")
        vertices = np.array([[float(v.get(c, "nan")) for c in "xyz"] for v in thing.iter(f"{space}vertex")])
        faces = np.array([[int(t.get(c, "")) for c in ("v1", "v2", "v3")] for t in thing.iter(f"{space}triangle")])
        meshes[key] = [mesh for part in thing.iter(f"{space}component") for mesh in meshes[part.get("objectid", "")]]
        if len(faces):
            ranges = [(0, len(faces) - 1)]
            if config is not None:
                volumes = config.findall(f"object[@id='{key}']/volume")
                ranges = [(int(v.get("firstid", "")), int(v.get("lastid", ""))) for v in volumes]
            meshes[key] = [trimesh.Trimesh(vertices, faces[a : b + 1]) for a, b in ranges]
    return [
        (meshes[item.get("objectid", "")], np.array(item.get("transform", "").split(), float).reshape(4, 3))
        for item in model.iter(f"{space}item")
    ]


def overlaps(blueprint: Blueprint, solids: dict[str, Solid]) -> list[str]:
    """Pairs that share room: hardware with hardware, bodies with other bodies, parts with hardware."""
    from mfg.exact import box_solid, motor_solid, tunnel

    hardware = {f"motor_{seat.hinge + 1}": motor_solid(blueprint, seat) for seat in blueprint.seats}
    hardware |= {box.kind: box_solid(box) for box in blueprint.boxes}
    tunnels = {wire.name: tunnel(wire) for wire in blueprint.wires}
    pairs = list(itertools.combinations(hardware.items(), 2))
    pairs += list(itertools.product(hardware.items(), tunnels.items()))
    pairs += list(itertools.combinations(tunnels.items(), 2))
    pairs += list(itertools.product(solids.items(), hardware.items()))
    pairs += list(itertools.product(solids.items(), tunnels.items()))
    body = {part.name: part.body for part in blueprint.parts}
    pairs += [pair for pair in itertools.combinations(solids.items(), 2) if body[pair[0][0]] != body[pair[1][0]]]
    return [
        f"{a} and {b} share {1e9 * volume:.2f} mm3"
        for (a, one), (b, two) in pairs
        if (volume := one.overlap(two)) > TOUCH
    ]


def _row(blueprint: Blueprint, seconds: float, problems: list[str]) -> str:
    mass = sum(m.mass for m in blueprint.masses)
    volume = 1e6 * sum(part.solid.volume for part in blueprint.parts)
    return (
        f"{blueprint.design.key:16}  {len(blueprint.bodies):6}  {len(blueprint.parts):5}  {len(blueprint.seats):6}  "
        f"{len(blueprint.wires):5}  {mass:4.1f}  {volume:5.0f}  {seconds:5.2f} s  "
        + (f"{len(problems)} WRONG" if problems else "right")
    )


def _summary(tally: Tally) -> str:
    agree = 1 - len(tally.refused_late) / max(len(tally.seconds), 1)
    lines = [
        f"{tally.passed} builds of {tally.drawn} designs; {len(tally.problems)} problem(s)",
        f"exact verdict agrees with the fast one on {100 * agree:.1f} % of designs that passed it",
        "largest difference of a score: " + ", ".join(f"{k} {v:.3f}" for k, v in tally.difference.items()),
        f"finish: median {sorted(tally.seconds)[len(tally.seconds) // 2]:.2f} CPU-s" if tally.seconds else "",
    ]
    return "\n".join([*lines, *(f"late: {line}" for line in tally.refused_late)])


if __name__ == "__main__":
    sys.exit(main())
