"""A painted body and a search for its gait that is over in a moment; imported by name from the tests beside it."""

from __future__ import annotations

from pathlib import Path

from sim.gaits import GaitBudget

QUADRUPED = Path(__file__).resolve().parents[1] / "experiments" / "examples" / "quadruped.vox"
TINY = GaitBudget(
    random=6, random_seconds=1.0, generations=1, population=4, seconds=1.0, finalists=1, final_seconds=1.0
)
