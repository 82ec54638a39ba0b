"""The policy of a bundle, fitted to the robot that is to be simulated under it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.output import BadInput

if TYPE_CHECKING:
    from hardware.bundle import Bundle
    from sim.actor import Policy
    from sim.model import Model


@dataclass(frozen=True, slots=True)
class Driver:
    """What drives a simulated robot.

    Attributes:
        actor: its joints in the order of the model's.
        time_constant: of the low-pass of its targets [s].
    """

    actor: Policy
    time_constant: float = 0.0


def load_driver(folder: Path, model: Model) -> Driver:
    """Read a bundle for a model; joints are matched by name.

    Raises:
        BundleError: if the bundle is unusable.
        BadInput: if the robot has other joints, or the policy acts at another rate than the simulator.
    """
    from hardware.bundle import load_bundle

    return driver_of(load_bundle(folder), model, str(folder))


def driver_of(bundle: Bundle, model: Model, source: str) -> Driver:
    """Fit a bundle to a model; `source` names it in complaints, see `load_driver`."""
    from sim.actor import Gait
    from sim.model import drive_of
    from sim.rollout import CONTROL_PERIOD

    names = drive_of(model).names
    if sorted(names) != sorted(bundle.names):
        raise BadInput(f"{source} drives joints {sorted(bundle.names)}, the robot has {sorted(names)}")
    # A gait is a function of time; a policy that sees was made for the time that passes between two looks.
    if not isinstance(bundle.actor, Gait) and abs(bundle.dt - CONTROL_PERIOD) > 1e-9:
        raise BadInput(f"{source} acts every {bundle.dt:g} s; what is simulated here acts every {CONTROL_PERIOD:g} s")
    order = [bundle.names.index(name) for name in names]
    return Driver(bundle.actor.arranged(order), bundle.time_constant)
