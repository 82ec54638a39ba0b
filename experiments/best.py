"""The `best/` folder of a run: the winner's blueprint, its policy, pictures of it walking, and its dry run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.run_folder import write_json

if TYPE_CHECKING:
    from mfg.pipeline import Outcome
    from sim.actor import Gait

BLUEPRINT, BUNDLE, VIDEO, STRIP, DRY_RUN = "blueprint", "bundle", "walk.mp4", "walk.png", "dry_run.json"
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


def write_best(folder: Path, outcome: Outcome, gait: Gait, config_hash: str, film: float) -> Best:
    """Write the blueprint of a design that was built, the policy bundle that drives it, its strip, video and dry run.

    Args:
        folder: made if missing; what is there under the same names is replaced.
        outcome: of `mfg.pipeline.build`, a success.
        gait: for the hinges of its description.
        config_hash: of the configuration that found it.
        film: length of the video [s], 0 for none.

    Raises:
        OSError: if something cannot be written.
    """
    from experiments.deploy import bundle_of, dry_run
    from mfg.description import describe
    from mfg.export import write_blueprint
    from mfg.picture import picture_of_blueprint
    from mfg.render import save_png
    from sim.actor import save_bundle
    from sim.model import load_model
    from sim.rollout import measure, roll_out
    from sim.video import save_strip, save_video

    twin = describe(outcome.blueprint)
    robot = folder / BLUEPRINT
    folder.mkdir(parents=True, exist_ok=True)
    write_blueprint(outcome, robot)
    save_png(robot / "blueprint.png", picture_of_blueprint(outcome.blueprint, PICTURE))
    save_bundle(folder / BUNDLE, bundle_of(twin, gait, config_hash=config_hash), robot)
    # Filmed from the exported model, so that what is seen is what was written.
    model = load_model(robot / "robot.xml")
    rollouts = roll_out(model, [gait], EPISODE)
    behaviour = measure(model, rollouts)[0]
    if behaviour is None:
        raise RuntimeError(f"the exported model {robot / 'robot.xml'} explodes under a gait that its twin walks with")
    save_strip(folder / STRIP, model, rollouts)
    if film > 0:
        save_video(folder / VIDEO, model, roll_out(model, [gait], film))
    dry = dry_run(folder / BUNDLE, EPISODE)
    write_json(folder / DRY_RUN, dry)
    return Best(behaviour.to_json(), dry)
