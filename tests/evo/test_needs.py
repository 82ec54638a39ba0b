"""Needs are quantiles and means of the rollout itself."""

from __future__ import annotations

import numpy as np
from gaits_in_brief import QUADRUPED, TINY

from decoder.sketch import load_design
from evo.needs import needs_of
from mfg.catalogue import Motor
from mfg.description import describe
from mfg.pipeline import score
from sim.gaits import search_gait
from sim.model import compile_model
from sim.rollout import roll_out


def test_needs_are_those_of_the_rollout():
    description = describe(score(load_design(QUADRUPED)).blueprint)
    model = compile_model(description)
    gait = search_gait(model, np.random.default_rng(3), TINY).gait
    needs = needs_of(model, gait, 60.0, seconds=2.0)
    rollout = roll_out(model, [gait], 2.0)
    motor: Motor = description.joints[0].motor
    assert [n.name for n in needs.joints] == [joint.name for joint in description.joints]
    for k, need in enumerate(needs.joints):
        share = (np.abs(rollout.torque[0, :, k]) <= need.peak_torque + 1e-12).mean()
        assert 0.98 <= share <= 1.0
        assert need.rms_torque == rollout.rms_torque[0, k]
        assert need.rms_torque <= need.peak_torque <= rollout.peak_torque[0, k] + 1e-9 <= motor.peak_torque + 1e-6
        assert 0.0 <= need.speed <= need.top_speed
    assert 1 / len(needs.joints) <= needs.together <= 1.0
