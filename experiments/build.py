"""`bodyplan build`: one design becomes the folder one prints, buys and wires from, or the reason why it cannot."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.judging import add_pipeline_options, judge_of, tell_round
from experiments.output import BAD_INPUT, DONE, INFEASIBLE, BadInput, emit, make_folder, say

if TYPE_CHECKING:
    from decoder.design import VoxelDesign
    from evo.judge import Judge
    from mfg.pipeline import Outcome
    from mfg.slicer import SliceReport

HELP = "a design (.npz or .vox) becomes a blueprint folder: parts, print file, models, wiring, assembly guide"

MESHES = (".stl", ".obj", ".glb", ".ply")
PICTURE = (1200, 900)  # [pixel]


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("design", type=Path, metavar="DESIGN", help="a design: .npz, or MagicaVoxel .vox")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="blueprint folder to write")
    add_pipeline_options(parser)
    parser.add_argument(
        "--repair", action="store_true", help="if it cannot be built, change the body as little as helps"
    )
    parser.add_argument("--no-guide", action="store_true", help="leave out guide.html, which takes seconds")
    parser.add_argument("--step", action="store_true", help="add step/: every rigid part as a solid for CAD programs")
    parser.add_argument("--slice", action="store_true", help="slice it with PrusaSlicer: time, filament, warnings")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Build one design; status 1 if it cannot be built."""
    from mfg.export import write_blueprint
    from mfg.picture import picture_of_blueprint
    from mfg.render import save_png
    from mfg.slicer import clock

    if args.slice:
        _need_slicer()
    design = read_design(args.design)
    judge = judge_of(args.solver, args.catalogue, args.parts)
    # Made before the work, so that a folder that cannot be written to is found at once.
    existed = args.out.is_dir()
    folder = make_folder(args.out)
    outcome = judge.build(design, tell_round)
    if not outcome.ok and args.repair:
        outcome = _repaired(outcome, judge, args.design)
    if not outcome.ok:
        if not existed:
            folder.rmdir()
        if args.json:
            emit(outcome.to_json(None))
        say(f"bodyplan: {args.design} cannot be built: {outcome.failure}")
        return INFEASIBLE
    write_blueprint(outcome, folder, guide=not args.no_guide, step=args.step)
    save_png(folder / "blueprint.png", picture_of_blueprint(outcome.blueprint, PICTURE))
    sliced, trouble = _slice(folder) if args.slice else (None, "")
    if trouble:
        say(f"bodyplan: error: the blueprint in {folder} is complete, but it was not sliced: {trouble}")
    status = BAD_INPUT if trouble else DONE
    if args.json:
        emit(outcome.to_json(str(folder)) | ({"slice": sliced and sliced.to_json()} if args.slice else {}))
        return status
    blueprint, scores = outcome.blueprint, outcome.scores
    mass = sum(m.mass for m in blueprint.masses)
    print(f"{args.design} can be built: {len(blueprint.hinges)} joints, {len(blueprint.parts)} printed parts, "
          f"{mass:.2f} kg, S_mfg = {scores.total:.2f} of 5")  # fmt: skip
    for note in blueprint.notes:
        print(f"  note: {note}")
    if sliced is not None:
        (rigid, soft), catalogue = sliced.grams, blueprint.catalogue
        print(f"{sliced.program}: {len(sliced.plates)} plates, {clock(sliced.seconds)}, {rigid:.0f} g of "
              f"{catalogue.rigid.name}, {soft:.0f} g of {catalogue.soft.name}")  # fmt: skip
        for warning in sliced.warnings:
            print(f"  slicer's warning: {warning}")
    print(f"blueprint in {folder}: look at {folder / 'blueprint.png'}, print {folder / 'print.3mf'}")
    if not args.no_guide:
        print(f"how to build it, step by step: {folder / 'guide.html'}")
    return status


def _repaired(outcome: Outcome, judge: Judge, path: Path) -> Outcome:
    """The blueprint of the body changed as little as helps, with notes of every change; the given one if none helps."""
    from mfg.repair import repaired

    say(f"{path} cannot be built as it is: {outcome.failure}")
    say("trying changes to the body, the smallest first")
    repair = repaired(outcome, judge.build)
    if not repair.ok:
        say(f"none of {repair.tried} bodies can be built")
        return outcome
    blueprint = repair.outcome.blueprint
    for change in repair.changes:
        blueprint = blueprint.noted(f"repaired: {change}")
    return replace(repair.outcome, blueprint=blueprint)


def _need_slicer() -> None:
    """Find out before the work that there is nothing to slice with."""
    from mfg.slicer import HOW_TO_GET, find_slicer

    if find_slicer() is None:
        raise BadInput(f"--slice needs PrusaSlicer, which is not here; get it with: {HOW_TO_GET}")


def _slice(folder: Path) -> tuple[SliceReport | None, str]:
    """Slice a blueprint and write down what came of it; a reason instead if nothing came."""
    from mfg.export import add_slice
    from mfg.slicer import SliceError, slice_blueprint

    try:
        report = slice_blueprint(folder)
    except SliceError as error:
        return None, str(error)
    add_slice(folder, report)
    return report, ""


def read_design(path: Path) -> VoxelDesign:
    """Read a design for a command.

    Raises:
        BadInput: if the path is not one of a design file.
        DesignError: if the file does not hold a design.
        OSError: if it cannot be read.
    """
    from decoder.sketch import load_design

    if path.is_dir():
        raise BadInput(f"{path} is a folder, expected a design file (.npz or .vox)")
    if path.suffix.lower() in MESHES:
        raise BadInput(f"{path}: bodies from a mesh arrive in a later version; give a .npz or a painted .vox")
    return load_design(path)
