"""`bodyplan train`: from a blueprint to a bundle that drives, through interruptions and nonsense."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import ellipsoid, painted

from experiments import cli
from experiments.output import SOLVERS, Solvers
from experiments.policy_training import _robot, keep_explosions
from hardware.bundle import load_bundle
from sim.environment import Explosion

ROOT = Path(cli.__file__).parent.parent
TRIPOD = ROOT / "experiments" / "examples" / "tripod.vox"
SMALL = "steps = 3000\nchunk = 1000\ncopies = 8\ngenerations = 0\nstarts = 1\nfilm = 0\nseed = 3\n"


@pytest.fixture(scope="module")
def blueprint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("blueprint") / "tripod"
    assert cli.main(["build", str(TRIPOD), "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def config(blueprint: Path) -> Path:
    path = blueprint.parent / "small.toml"
    path.write_text(f'kind = "policy"\nrobot = "tripod"\n{SMALL}', encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def trained(config: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "policy"
    assert cli.main(["run", str(config), "--out", str(folder), "--workers", "1"]) == 0
    return folder


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def started(config: Path, folder: Path, *more: str) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "experiments.cli", "run", str(config), "--out", str(folder), *more]
    return subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # Tests that run in the background of a shell inherit that Ctrl-C is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 120
    while not path.exists():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end
        time.sleep(0.01)


def test_the_folder_is_a_bundle_and_says_what_was_measured(trained: Path) -> None:
    bundle, result = load_bundle(trained), json.loads((trained / "result.json").read_text("utf-8"))
    assert len(bundle.joints) == len(result["motors"]) == 3
    assert result["kind"] == "policy"
    assert result["steps"] == 3072  # three chunks of 1000, each in four updates of 256
    assert result["behaviour"]["seconds"] == 20.0
    assert result["randomised"]["episodes"] == 20
    assert 0 <= result["randomised"]["falls"] <= 20
    assert result["rhythm"] is True
    assert list((trained / "events").iterdir())
    left = {"walk.png", "behaviour.html", "robot.xml", "meshes", "config.toml", "checkpoint"}
    assert left <= {path.name for path in trained.iterdir()}


def test_states_in_which_physics_was_lost_are_written_down(tmp_path: Path) -> None:
    draws = {"mass": np.ones(3)}
    lost = [Explosion(np.arange(5.0) + k, np.array([0.1, 0.2]), draws, "a reason") for k in range(2)]
    keep_explosions([], tmp_path / "none", 0)
    assert not (tmp_path / "none").exists()
    keep_explosions(lost, tmp_path / "some", 7)
    with np.load(tmp_path / "some" / "chunk_0007.npz") as kept:
        assert sorted(kept.files) == [f"{k}/{name}" for k in (0, 1) for name in ("control", "draws/mass", "state")]
        np.testing.assert_array_equal(kept["1/state"], lost[1].state)


def test_simulate_and_a_dry_run_take_it(bodyplan: Callable[..., Any], trained: Path, blueprint: Path) -> None:
    said = bodyplan("simulate", blueprint, "--policy", trained, "--seconds", 2, "--json")
    assert said.status == 0, said.err
    assert json.loads(said.out)["seconds"] == 2.0
    said = bodyplan("deploy", trained, "--bus", "virtual", "--dry-run", "--seconds", 2, "--json")
    assert said.status == 0, said.err
    assert json.loads(said.out)["latched"] is None


def test_a_finished_training_is_neither_written_over_nor_done_again(
    bodyplan: Callable[..., Any], config: Path, trained: Path
) -> None:
    before = digest(trained / "bundle.json")
    said = bodyplan("run", config, "--out", trained)
    assert said.status == 2
    assert "go on with it by --resume" in said.err
    said = bodyplan("run", config, "--out", trained, "--resume", "--json")
    assert said.status == 0
    assert json.loads(said.out)["kind"] == "policy"
    assert "is finished" in said.err
    assert digest(trained / "bundle.json") == before


def test_kill_9_and_other_threads_change_no_byte(config: Path, trained: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    process = started(config, folder, "--workers", "2")
    wait_for(folder / "checkpoint" / "training.npz", process)
    process.kill()
    process.communicate()
    assert not (folder / "result.json").exists()
    process = started(config, folder, "--workers", "1", "--resume")
    _, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    for name in ("bundle.json", "result.json", "checkpoint/training.npz", "walk.png"):
        assert digest(folder / name) == digest(trained / name), name


def test_ctrl_c_saves_and_says_how_to_go_on(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "stopped"
    process = started(config, folder)
    wait_for(folder / "checkpoint" / "training.npz", process)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 3, error
    assert "--resume" in error.splitlines()[-1]
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--steps", "0"), "steps = 0"),
        (("--pace", "nan"), "pace"),
        (("--pace", "-1"), "pace = -1.0"),
        (("--starts", "0"), "starts = 0"),
        (("--task", "fly"), "invalid choice: 'fly'"),
        (("--pads", "1"), "pads = 1.0"),
        (("--history", "x"), "invalid int value: 'x'"),
        (("--solver", "paper"), "is built already: leave it out"),
    ],
)
def test_bad_arguments_are_one_line(
    bodyplan: Callable[..., Any], blueprint: Path, tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    said = bodyplan("train", blueprint, "--out", tmp_path / "x", *words)
    assert said.status == 2
    assert message in said.err
    assert said.err.count("\n") == 1


def test_a_robot_that_is_none_is_refused(bodyplan: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    said = bodyplan("train", tmp_path / "empty", "--out", tmp_path / "x")
    assert said.status == 2
    assert "no robot.xml" in said.err
    said = bodyplan("train", tmp_path / "missing.vox", "--out", tmp_path / "x")
    assert said.status == 2
    assert "missing.vox" in said.err
    assert said.err.count("\n") == 1


def test_a_body_that_cannot_be_built_is_status_1(bodyplan: Callable[..., Any], tmp_path: Path) -> None:
    design = painted([ellipsoid((20, 32, 32), (8, 8, 8)), ellipsoid((44, 32, 32), (8, 8, 8))], ())
    design.save(tmp_path / "d.npz")
    said = bodyplan("train", tmp_path / "d.npz", "--out", tmp_path / "x")
    assert said.status == 1
    assert "cannot be built" in said.err


@pytest.mark.parametrize("rules", SOLVERS)
def test_a_design_is_built_by_the_rules_that_are_asked_for(tmp_path: Path, rules: Solvers) -> None:
    _, source = _robot(TRIPOD, rules, tmp_path)
    assert ("lids" in json.loads((source / "blueprint.json").read_text())) == (rules == "search")


def test_a_damaged_checkpoint_is_refused_in_one_line(
    bodyplan: Callable[..., Any], config: Path, trained: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "damaged"
    (folder / "checkpoint").mkdir(parents=True)
    (folder / "config.toml").write_bytes((trained / "config.toml").read_bytes())
    whole = (trained / "checkpoint" / "training.npz").read_bytes()
    plain = io.BytesIO()
    np.save(plain, np.zeros(3))
    for content in (b"", b"nonsense", whole[: len(whole) // 2], plain.getvalue()):
        (folder / "checkpoint" / "training.npz").write_bytes(content)
        said = bodyplan("run", config, "--out", folder, "--resume")
        assert said.status == 2
        assert "training.npz" in said.err
        assert "Traceback" not in said.err


def test_a_training_is_not_resumed_with_another_robot(
    bodyplan: Callable[..., Any], config: Path, trained: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "other"
    shutil.copytree(trained / "checkpoint", folder / "checkpoint")
    (folder / "config.toml").write_bytes((trained / "config.toml").read_bytes())
    (folder / "checkpoint" / "robot.sha256").write_text("0" * 64 + "\n")
    said = bodyplan("run", config, "--out", folder, "--resume")
    assert said.status == 2
    assert "has changed since this training began" in said.err
    assert said.err.count("\n") == 1


def test_a_bundle_of_another_origin_is_not_written_over(
    bodyplan: Callable[..., Any], blueprint: Path, trained: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "bundle.json").write_bytes((trained / "bundle.json").read_bytes())
    said = bodyplan("train", blueprint, "--out", folder)
    assert said.status == 2
    assert "not trained there" in said.err
    assert set(os.listdir(folder)) <= {"bundle.json", ".lock"}
