"""`bodyplan run` as users start it, with nothing replaced: what it leaves, and that kill -9 changes nothing of it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decoder.design import VoxelDesign
from experiments.best import Lame, write_best
from mfg.pipeline import build
from sim.actor import Gait

ROOT = Path(__file__).parents[2]
Command = Callable[..., Any]

# Four bodies of which two can be built and one walks; the budgets are the least that finds a gait for it.
CONFIG = """
kind = "evolve"
seed = 3
decoder = "genome"
film = 0.0

[search]
generations = 1
popsize = 4

[gait]
random = 4
random_seconds = 2.0
generations = 0
population = 4
seconds = 1.0
finalists = 1

[finals]
heat = 1

[finals.gait]
random = 4
random_seconds = 2.0
generations = 1
population = 4
seconds = 2.0
finalists = 1
"""
COLUMNS = {"id", "generation", "candidate", "design", "latent", "stage", "reason", "speed", "s_motor", "s_elec",
           "s_cable", "s_elec_inst", "s_body_inst", "s_mfg", "fitness", "seconds"}  # fmt: skip
BLUEPRINT = {"blueprint.json", "parts", "print.3mf", "assembly.glb", "robot.urdf", "robot.xml", "meshes", "bom.csv",
             "wiring.csv"}  # fmt: skip
DRY_RUN = {"ticks", "overruns", "tracking_rms_rad", "speed_m_s", "state", "latched"}
WALL_TIME = {"steps_per_s"}  # of the winner


def start(config: Path, folder: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "experiments.cli", "run", str(config), "--out", str(folder), "--json", *words]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def finish(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, err = process.communicate()
    assert process.returncode == 0, err
    result: dict[str, Any] = json.loads(out)
    return result


def kill_when(process: subprocess.Popen[str], condition: Callable[[], bool]) -> None:
    """Kill -9 the program and all of its workers as soon as this is so."""
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL


def table(folder: Path, name: str, columns: str = "") -> list[Any]:
    path = folder / "run.sqlite"
    if not path.exists():
        return []
    with sqlite3.connect(path) as connection:
        names = [row[1] for row in connection.execute(f"PRAGMA table_info({name})") if row[1] != "seconds"]
        rows = connection.execute(f"SELECT {columns or ', '.join(names)} FROM {name} ORDER BY id").fetchall()
    connection.close()
    return rows


def hashes(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def lasting(winner: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in winner.items() if name not in WALL_TIME}


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("config") / "small.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture(scope="module")
def undisturbed(config: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("runs") / "undisturbed"
    return folder, finish(start(config, folder, "--workers", "0"))


def test_a_run_leaves_what_the_contract_says(undisturbed: tuple[Path, dict[str, Any]]) -> None:
    folder, result = undisturbed
    assert {"config.toml", "run.sqlite", "checkpoint", "best", "report.html", "result.json"} <= {
        path.name for path in folder.iterdir()
    }
    assert json.loads((folder / "result.json").read_text("utf-8")) == result
    with sqlite3.connect(folder / "run.sqlite") as connection:
        assert {row[1] for row in connection.execute("PRAGMA table_info(evaluations)")} >= COLUMNS
    connection.close()
    assert [len(blob) for (blob,) in table(folder, "evaluations", "latent")] == [4 * 512] * 4
    assert {path.name for path in (folder / "best" / "blueprint").iterdir()} >= BLUEPRINT
    assert list((folder / "best" / "blueprint" / "parts").glob("*.stl"))
    assert (folder / "best" / "bundle" / "bundle.json").is_file()
    assert (folder / "best" / "walk.png").read_bytes().startswith(b"\x89PNG")
    assert "Motors" in (folder / "best" / "behaviour.html").read_text("utf-8")
    html = (folder / "report.html").read_text("utf-8")
    assert html.rstrip().endswith("</html>")
    assert result["winner"]["design"] in html


def test_the_winner_is_a_finalist_that_walks_as_it_was_exported(undisturbed: tuple[Path, dict[str, Any]]) -> None:
    folder, result = undisturbed
    winner = result["winner"]
    assert winner["distance_m"] >= winner["body_length_m"]
    assert winner["seconds"] == 10.0
    assert result["evaluations"] == 4
    assert result["passed"] == sum(stage is None for (stage,) in table(folder, "evaluations", "stage")) > 0
    finalists = table(folder, "finals", "design, fitness")
    assert (winner["design"], winner["fitness"]) in finalists
    manifest = json.loads((folder / "best" / "blueprint" / "blueprint.json").read_text("utf-8"))
    assert manifest["design"] == winner["design"]
    assert manifest["scores"]["total"] == pytest.approx(winner["s_mfg"])


def test_the_dry_run_went_through(undisturbed: tuple[Path, dict[str, Any]]) -> None:
    folder, result = undisturbed
    dry = json.loads((folder / "best" / "dry_run.json").read_text("utf-8"))
    assert dry == result["winner"]["dry_run"]
    assert set(dry) >= DRY_RUN
    assert dry["ticks"] > 500
    assert dry["overruns"] == 0
    assert dry["latched"] is None
    assert dry["state"] == "off"


def test_kill_9_changes_nothing(
    config: Path, undisturbed: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:  # fmt: skip
    expected, result = undisturbed
    folder = tmp_path / "killed"
    kill_when(start(config, folder, "--workers", "1"), lambda: len(table(folder, "evaluations")) > 0)
    assert table(folder, "finals") == []
    kill_when(start(config, folder, "--workers", "1", "--resume"), (folder / "best").exists)
    assert not (folder / "result.json").exists()
    resumed = finish(start(config, folder, "--workers", "1", "--resume"))
    assert table(folder, "evaluations") == table(expected, "evaluations")
    assert table(folder, "finals") == table(expected, "finals")
    assert lasting(resumed["winner"]) == lasting(result["winner"])
    assert hashes(folder / "best" / "blueprint") == hashes(expected / "best" / "blueprint")
    assert hashes(folder / "best" / "bundle") == hashes(expected / "best" / "bundle")


def test_a_sketch(bodyplan: Command, hinge: VoxelDesign, hinge_file: Path) -> None:
    config, folder = hinge_file.parent / "s.toml", hinge_file.parent / "out"
    budget = "random = 2\nrandom_seconds = 1.0\ngenerations = 0\nfinalists = 1\nfinal_seconds = 1.0"
    config.write_text(f'kind = "sketch"\ndesign = "hinge.npz"\nfilm = 0\n[gait]\n{budget}\n')
    said = bodyplan("run", config, "--out", folder, "--json")
    assert said.status == 0, said.err
    result = json.loads(said.out)
    assert result["ok"]
    assert result["winner"]["design"] == result["design"]
    assert result["winner"]["dry_run"]["latched"] is None
    assert {"config.toml", "best", "report.html", "result.json"} <= {path.name for path in folder.iterdir()}
    assert {path.name for path in (folder / "best" / "blueprint").iterdir()} >= BLUEPRINT
    before = hashes(folder)
    said = bodyplan("run", config, "--out", folder)
    assert said.status == 2
    assert "holds a run already" in said.err
    said = bodyplan("run", config, "--out", folder, "--json", "--resume")
    assert (said.status, json.loads(said.out)) == (0, result)
    joint = replace(hinge.joints[0], range=np.array([-0.5, 0.5]))
    replace(hinge, joints=(joint,)).save(hinge_file)
    said = bodyplan("run", config, "--out", folder, "--resume")
    assert said.status == 2
    assert "hinge.npz has changed since" in said.err
    assert hashes(folder) == before


def test_a_robot_that_stands_still_once_it_is_exported_does_not_pass(hinge: VoxelDesign, tmp_path: Path) -> None:
    still = Gait(1.0, np.zeros(1), np.zeros(1), np.zeros(1))
    found = write_best(tmp_path / "best", build(hinge), still, "", 0.0, must_walk=True)
    assert isinstance(found, Lame)
    assert re.fullmatch(
        r"the exported model goes 0\.\d+ m in 10 s, less than its body length of 0\.\d+ m", found.reason
    )
    assert {path.name for path in (tmp_path / "best").iterdir()} == {"blueprint"}
