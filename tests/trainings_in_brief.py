"""A training that is over in a moment, and what it may begin with; imported by name from the tests beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.actor import Gait
from sim.plan import USUAL, Training
from sim.training import Start

SMALL = Training(
    seed=5, steps=192, chunk=64, ppo=replace(USUAL, copies=4, horizon=16, minibatch=32, epochs=2, units=16)
)
GAIT = Gait(1.5, np.full(4, 0.4), np.arange(4.0), np.zeros(4))
FREE, CORRECTED = Start(0.3, np.zeros(4)), Start(0.3, np.zeros(4), GAIT)
