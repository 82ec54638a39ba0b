"""The picture of the README, from the winner of a run: `python -m experiments.cover RUN --out docs/robot.png`.

On top the body as the decoder drew it and as it will be built, whole and apart; below it how it walks.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from experiments.output import BAD_INPUT, say

PANEL = (480, 360)  # of the pictures on top [pixel]
MOMENTS = 6
EXPLODE = 0.35  # how far bodies move apart, as a share of their distance from the root
COLOURS = 256


def main() -> int:
    """Draw and write the picture."""
    parser = argparse.ArgumentParser(prog="python -m experiments.cover", description=__doc__)
    parser.add_argument("run", type=Path, help="a finished run")
    parser.add_argument("--out", type=Path, required=True, help="PNG to write")
    args = parser.parse_args()

    import numpy as np
    from PIL import Image

    from decoder.sketch import load_design
    from experiments.best import BLUEPRINT, BUNDLE
    from experiments.config import Evolve, Sketch, load_config
    from experiments.judging import judge_of
    from experiments.policy import load_driver
    from experiments.run_folder import CONFIG
    from mfg.picture import contact_sheet, picture_of_blueprint, picture_of_design
    from sim.closed_loop import roll_out_policy
    from sim.model import load_model
    from sim.video import strip

    robot = args.run / "best" / BLUEPRINT
    if not (robot / "design.npz").exists() or not isinstance(config := load_config(args.run / CONFIG), Evolve | Sketch):
        say(f"{args.run} has no winner; give the folder of a finished run that evolves or builds a sketch")
        return BAD_INPUT
    design = load_design(robot / "design.npz")
    judge = judge_of(config.solver, config.catalogue, config.parts, deployed=True)
    blueprint = judge.build(design).blueprint
    model = load_model(robot / "robot.xml")
    driver = load_driver(args.run / "best" / BUNDLE, model)
    rollouts = roll_out_policy(model, driver.actor, 10.0, time_constant=driver.time_constant)
    mass = sum(m.mass for m in blueprint.masses)
    pictures = [picture_of_design(design, PANEL), picture_of_blueprint(blueprint, PANEL),
                picture_of_blueprint(blueprint, PANEL, EXPLODE)]  # fmt: skip
    labels = ["a body from the decoder", f"its blueprint: {len(blueprint.seats)} motors, {mass:.1f} kg", "its parts"]
    width = len(pictures) * PANEL[0] // MOMENTS
    walk = strip(model, rollouts, count=MOMENTS, size=(width, width * 3 // 4))
    top = contact_sheet(pictures, labels, len(pictures))
    bottom = contact_sheet([walk], ["ten seconds of its walk"], 1)
    picture = Image.fromarray(np.concatenate([top, bottom])).quantize(COLOURS, dither=Image.Dither.NONE)
    picture.save(args.out, optimize=True)
    say(f"{args.out}: {args.out.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
