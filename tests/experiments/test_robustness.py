"""The conditions of the robustness table are what their names say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from decoder.design import VoxelDesign
from experiments import robustness
from experiments.output import BadInput
from experiments.robustness import NOMINAL, Condition, conditions, table
from mfg.description import describe
from mfg.export import write_blueprint
from mfg.parts import PAPER
from mfg.pipeline import RULES, Rules, build


def test_every_condition_has_a_name_of_its_own_and_the_first_is_as_trained() -> None:
    names = [condition.name for condition in conditions()]
    assert names[0] == NOMINAL
    assert len(set(names)) == len(names) == 14


@pytest.mark.parametrize("rules", RULES)
def test_full_hulls_keep_every_corner_of_the_robot_that_was_built(
    hinge: VoxelDesign, tmp_path: Path, rules: Rules
) -> None:
    outcome = build(hinge, rules=rules)
    write_blueprint(outcome, tmp_path / "robot")
    policy = tmp_path / "policy"
    policy.mkdir()
    (policy / "result.json").write_text(json.dumps({"robot": str(tmp_path / "robot")}))
    (policy / "robot.xml").write_text((tmp_path / "robot" / "robot.xml").read_text())
    (tmp_path / "robot" / "meshes").rename(policy / "meshes")
    assert robustness._full(tmp_path / "robot").mass == pytest.approx(describe(outcome.blueprint).mass, rel=1e-9)
    full = robustness._spec(policy, Condition("full hulls", full_hull=True)).compile()
    thinned = robustness._spec(policy, Condition(NOMINAL)).compile()
    assert (
        full.mesh_vertnum.max() > 2 * thinned.mesh_vertnum.max() or full.mesh_graph.size > 2 * thinned.mesh_graph.size
    )


def test_a_robot_of_other_parts_is_not_taken_for_that_of_its_design(hinge: VoxelDesign, tmp_path: Path) -> None:
    lighter = replace(PAPER, battery=replace(PAPER.battery, mass=0.1))
    write_blueprint(build(hinge, lighter), tmp_path / "robot")
    with pytest.raises(BadInput, match="another robot than its design gives"):
        robustness._full(tmp_path / "robot")


def test_the_table_gives_shares_and_the_worst() -> None:
    text = table({"a": {NOMINAL: [1.0, 1.0], "ice": [0.5, 0.7], "sand": [0.9, 0.9]}})
    assert "| ice | 0.60 |" in text
    assert "| **worst** | **0.60** |" in text


def test_folders_that_are_none_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["robustness", str(tmp_path), "--out", str(tmp_path / "out")])
    assert robustness.main() == 2
    assert "no bundle.json" in capsys.readouterr().err
