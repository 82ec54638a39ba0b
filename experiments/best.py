"""The `best/` folder of a run: the winner's blueprint, its policy, how it walks, and its dry run."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.run_folder import write_json

if TYPE_CHECKING:
    from mfg.pipeline import Outcome
    from sim.actor import Policy

BLUEPRINT, BUNDLE, VIDEO, STRIP, DRY_RUN = "blueprint", "bundle", "walk.mp4", "walk.png", "dry_run.json"
PAGE = "behaviour.html"
EPISODE = 10.0  # of walking, measured and on the bus [s]
PICTURE = (1200, 900)  # [pixel]


@dataclass(frozen=True, slots=True)
class Best:
    """What was written.

    Attributes:
        behaviour: of the twin over the episode, under the names of `bodyplan simulate`.
        dry_run: of the policy on the virtual bus, under the names of `bodyplan deploy --dry-run`.
    """

    behaviour: dict[str, Any]
    dry_run: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Lame:
    """The exported robot does not do what was promised.

    Attributes:
        reason: in words, with numbers.
    """

    reason: str


def write_best(
    folder: Path, outcome: Outcome, actor: Policy, config_hash: str, film: float, *, must_walk: bool
) -> Best | Lame:
    """Write the blueprint of a design that was built, the policy bundle that drives it, its pictures and dry run.

    It is measured on the exported model, so that what is reported is what was written. Its numbers are those of its
    description but for rounding, and a gait near the edge may fall on one and not on the other.

    Args:
        folder: made afresh.
        outcome: of `mfg.pipeline.build`, a success.
        actor: a gait or a learned policy, for the hinges of its description.
        config_hash: of the configuration that found it.
        film: length of the video [s], 0 for none.
        must_walk: whether to stop at a robot that moves less than one body length; its blueprint is written then, and
            nothing else.

    Raises:
        OSError: if something cannot be written.
    """
    from experiments.behaviour_page import write_behaviour_page
    from experiments.deploy import bundle_of, dry_run
    from hardware.bundle import save_bundle
    from mfg.description import describe
    from mfg.export import write_blueprint
    from mfg.picture import picture_of_blueprint
    from mfg.render import save_png
    from sim.closed_loop import roll_out_policy
    from sim.model import load_model
    from sim.rollout import measure
    from sim.video import save_strip, save_video

    twin = describe(outcome.blueprint)
    robot = folder / BLUEPRINT
    if folder.exists():
        shutil.rmtree(folder)  # what a run that was stopped here left may be of another design.
    folder.mkdir(parents=True)
    write_blueprint(outcome, robot, guide=True)
    model = load_model(robot / "robot.xml")
    rollouts = roll_out_policy(model, actor, EPISODE)
    behaviour = measure(model, rollouts)[0]
    if behaviour is None:
        return Lame("the physics of the exported model explodes")
    if must_walk and not behaviour.distance >= behaviour.body_length:
        return Lame(
            f"the exported model goes {behaviour.distance:.3f} m in {EPISODE:g} s, less than its body length of "
            f"{behaviour.body_length:.3f} m"
        )
    save_png(robot / "blueprint.png", picture_of_blueprint(outcome.blueprint, PICTURE))
    save_bundle(folder / BUNDLE, bundle_of(twin, actor, config_hash=config_hash), robot)
    save_strip(folder / STRIP, model, rollouts)
    if film > 0:
        save_video(folder / VIDEO, model, roll_out_policy(model, actor, film))
    write_behaviour_page(folder / PAGE, model, rollouts, behaviour, title=f"How {twin.name} moves",
                         film=folder / VIDEO if film > 0 else None)  # fmt: skip
    dry = dry_run(folder / BUNDLE, EPISODE)
    write_json(folder / DRY_RUN, dry)
    return Best(behaviour.to_json(), dry)
