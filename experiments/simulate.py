"""`bodyplan simulate`: how a blueprint or a design moves, by a policy or by a gait found on the spot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.build import read_design
from experiments.judging import add_pipeline_options, judge_of, tell_round
from experiments.output import DONE, INFEASIBLE, BadInput, emit, say, seed

if TYPE_CHECKING:
    from mujoco import MjSpec

    from experiments.policy import Driver
    from sim.actor import Gait
    from sim.model import Model
    from sim.rollout import Behaviour, Rollouts

HELP = "let a blueprint or a design walk, measure it and film it"
MODEL_FILE = "robot.xml"
FILMS = (".mp4", ".png")
FIDELITIES = ("compliant", "hull", "sprung", "flex", "flex-fine")  # of sim.skin.Fidelity, whose import is heavy
TERRAINS = ("flat", "rough", "potholes", "slope", "steps")  # of sim.terrain.Kind


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "robot", type=Path, metavar="BLUEPRINT|DESIGN", help=f"a blueprint folder, its {MODEL_FILE}, a .npz or a .vox"
    )
    parser.add_argument("--policy", type=Path, metavar="BUNDLE", help="policy bundle; without one a gait is searched")
    parser.add_argument("--seconds", type=_seconds, default=10.0, help="how long to measure (10)")
    parser.add_argument("--video", type=Path, metavar="FILE", help="film it: .mp4, or .png for a strip of moments")
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FOLDER|FILE.html",
        help="write a page about it: gait diagram, motors against their limits; with the film, if .mp4",
    )
    parser.add_argument("--seed", type=seed, default=0, help="of the search for a gait, and of the terrain (0)")
    parser.add_argument("--virtual", action="store_true", help="a design as drawn, before any hardware is put into it")
    parser.add_argument("--terrain", choices=TERRAINS, default="flat", help="what it walks on (flat)")
    parser.add_argument("--fidelity", choices=FIDELITIES, default=FIDELITIES[0], metavar="|".join(FIDELITIES),
                        help="how the soft skin is modelled; a gait is searched on the first, the default")  # fmt: skip
    add_pipeline_options(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Simulate one robot; status 1 if the design cannot be built or its physics explodes."""
    from experiments.policy import load_driver
    from sim.behaviour import motor_limits, motor_uses, motor_warnings
    from sim.closed_loop import roll_out_policy
    from sim.rollout import Diverged, measure

    if args.video is not None:
        _check_film(args.video)
    if args.report is not None:
        _check_report(args.report)
    model = _model(args, args.fidelity)
    if model is None:
        return INFEASIBLE
    # Finite elements are much too slow to search on: the gait is found on the default model and tried on the other.
    quick = _model(args, FIDELITIES[0]) if args.policy is None and args.fidelity != FIDELITIES[0] else model
    assert quick is not None
    try:
        driver = _search(quick, args) if args.policy is None else load_driver(args.policy, model)
    except Diverged as error:
        say(f"bodyplan: {error}")
        return INFEASIBLE
    rollouts = roll_out_policy(model, driver.actor, args.seconds, time_constant=driver.time_constant)
    behaviour = measure(model, rollouts)[0]
    if behaviour is None:
        say(
            f"bodyplan: the physics of {args.robot} exploded within {args.seconds:g} s under this policy, or the "
            "policy said what is no number"
        )
        return INFEASIBLE
    if args.video is not None:
        from sim.video import save_strip, save_video

        say(f"drawing {args.video}")
        save = save_strip if args.video.suffix.lower() == ".png" else save_video
        save(args.video, model, rollouts)
    limits, uses = motor_limits(model), motor_uses(model, rollouts)
    cannot = motor_warnings(limits, uses)
    page = None if args.report is None else _report(args, model, driver, rollouts, behaviour)
    if args.json:
        found = _document(args, model, driver, behaviour)
        emit(
            found
            | {
                "motors": [use.to_json() for use in uses],
                "warnings": list(cannot),
                "report": None if page is None else str(page),
            }
        )
    else:
        _tell(args, behaviour)
        for line in cannot:
            print(f"warning: {line}")
        if page is not None:
            print(f"report in {page}")
    return DONE


def _model(args: argparse.Namespace, level: str) -> Model | None:
    """The model of a blueprint or a design, or None where the design cannot be built and the reason was said."""
    from sim.model import load_spec, make_spec
    from sim.skin import Fidelity

    path, virtual, fidelity = args.robot, args.virtual, Fidelity(level)
    if path.is_dir() or path.suffix.lower() == ".xml":
        file = path / MODEL_FILE if path.is_dir() else path
        if path.is_dir() and not file.exists():
            raise BadInput(
                f"{path} has no {MODEL_FILE}; give a blueprint folder (`bodyplan build` makes one) or a design"
            )
        if virtual:
            raise BadInput(f"--virtual needs a design, and {path} is a blueprint: its hardware is in it already")
        try:
            return _compiled(load_spec(file, fidelity=fidelity), args)
        except ValueError as error:
            raise BadInput(f"{file}: {str(error).removeprefix(f'{file}: ')}".splitlines()[0]) from None
    from mfg import pipeline
    from mfg.description import FULL_HULL, HULL_VERTICES, describe

    design = read_design(path)
    judge = judge_of(args.solver, args.catalogue, args.parts)
    if virtual and judge.library is not None:
        raise BadInput("--virtual has no hardware in it, so there are no parts to choose; leave --catalogue auto out")
    outcome = pipeline.virtual(design) if virtual else judge.score(design, tell_round)
    if not outcome.ok:
        hint = "" if virtual else "; --virtual simulates it all the same"
        say(f"bodyplan: {path} cannot be built: {outcome.failure}{hint}")
        return None
    corners = FULL_HULL if fidelity is Fidelity.HULL else HULL_VERTICES
    description = describe(outcome.blueprint, hull_vertices=corners)
    return _compiled(make_spec(description, fidelity=fidelity), args)


def _compiled(spec: MjSpec, args: argparse.Namespace) -> Model:
    from sim.terrain import Kind, Terrain, lay

    lay(spec, Terrain(Kind(args.terrain), seed=args.seed))
    return spec.compile()


def _search(model: Model, args: argparse.Namespace) -> Driver:
    from dataclasses import replace

    import numpy as np

    from experiments.policy import Driver
    from sim.gaits import SCREENING, search_gait

    say("searching a gait")
    budget = replace(SCREENING, final_seconds=args.seconds)
    return Driver(search_gait(model, np.random.default_rng(args.seed), budget).gait)


def _check_film(path: Path) -> None:
    if path.suffix.lower() not in FILMS:
        raise BadInput(f"--video {path}: a film ends in {' or '.join(FILMS)}")
    if not path.parent.is_dir():
        raise BadInput(f"--video {path}: there is no folder {path.parent}")


def _check_report(path: Path) -> None:
    if path.suffix.lower() == ".html":
        if not path.parent.is_dir():
            raise BadInput(f"--report {path}: there is no folder {path.parent}")
    elif path.exists() and not path.is_dir():
        raise BadInput(f"--report {path}: it is a file that does not end in .html, and no folder")


def _report(args: argparse.Namespace, model: Model, driver: Driver, rollouts: Rollouts, behaviour: Behaviour) -> Path:
    from experiments.behaviour_page import write_behaviour_page
    from sim.actor import Gait
    from sim.model import model_name

    kind = "open-loop gait" if isinstance(driver.actor, Gait) else "learned policy"
    facts = [
        ("robot", f"{model_name(model)}, from {args.robot}"),
        ("policy", f"{kind}, {'found by a search just now' if args.policy is None else f'from {args.policy}'}"),
        ("ground", args.terrain), ("skin", args.fidelity), ("measured", f"{behaviour.seconds:g} s after half a second"),
    ]  # fmt: skip
    film = args.video if args.video is not None and args.video.suffix.lower() == ".mp4" else None
    title = f"How {args.robot.stem} moves"
    return write_behaviour_page(args.report, model, rollouts, behaviour, title=title, facts=facts, film=film)


def _document(args: argparse.Namespace, model: Model, driver: Driver, behaviour: Behaviour) -> dict[str, Any]:
    from sim.actor import Gait
    from sim.model import model_name

    gait = driver.actor if isinstance(driver.actor, Gait) else None
    return {
        **behaviour.to_json(),
        "robot": model_name(model),
        "terrain": args.terrain,
        "fidelity": args.fidelity,
        "policy": None if args.policy is None else str(args.policy),
        "actor": "perceptron" if gait is None else "gait",
        "gait": None if gait is None else _numbers(gait),
        "video": None if args.video is None else str(args.video),
    }


def _numbers(gait: Gait) -> dict[str, Any]:
    return {
        "frequency_hz": gait.frequency,
        "amplitude_rad": gait.amplitude.tolist(),
        "phase_rad": gait.phase.tolist(),
        "offset_rad": gait.offset.tolist(),
    }


def _tell(args: argparse.Namespace, behaviour: Behaviour) -> None:
    lengths = behaviour.distance / behaviour.body_length
    fell = "fell over" if behaviour.fell else "stayed upright"
    print(f"{args.robot} went {behaviour.distance:.2f} m ({lengths:.1f} body lengths) in {behaviour.seconds:.0f} s "
          f"and {fell}; speed {behaviour.speed:.3f} m/s along its best heading")  # fmt: skip
    print(f"torque up to {behaviour.max_torque:.1f} N.m, {behaviour.overload:.0%} of what the motors bear for long; "
          + ("no cost of transport" if behaviour.cost_of_transport is None
             else f"cost of transport {behaviour.cost_of_transport:.2f}"))  # fmt: skip
    if args.video is not None:
        print(f"film in {args.video}")


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.1 <= value <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text} is out of bounds; it must lie in [0.1, 1000] s")
    return value
