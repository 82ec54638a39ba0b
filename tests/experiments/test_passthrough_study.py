"""The paired study: the same bodies by every set of rules, each verdict kept as it comes, counts that add up."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from decoder.latent import make_decoder, sample_latents
from evo.judge import Judge
from experiments import passthrough_study as command
from experiments.json_lines import read_rows
from experiments.passthrough_study import Task, Work, by_rules
from experiments.passthrough_table import table
from mfg.pipeline import score

ROOT = Path(command.__file__).parent.parent
STAGES = {"skeleton", "motor", "electronics", "wire", "print", "worker", "passed"}


class Fake:
    """Stands in for the solvers: paper refuses odd bodies, the search every third, one body breaks its worker."""

    calls: ClassVar[list[tuple[int, str]]] = []
    broken = -1
    stop_at = -1

    def __init__(self, decoder: str) -> None:
        pass

    def __call__(self, task: Task) -> dict[str, Any]:
        if len(Fake.calls) == Fake.stop_at:
            raise KeyboardInterrupt
        Fake.calls.append((task.body, task.part))
        if task.body == Fake.broken:
            raise ZeroDivisionError("planted")
        refused = {"outcome": "motor", "reason": "no_overlap", "detail": "planted"}
        passed = {"outcome": "passed"}
        verdicts = {
            "rules": {"paper": refused if task.body % 2 else passed, "search": passed if task.body % 3 else refused},
            "repair": {"repair": passed if task.body % 2 else refused},
            "auto": {"auto": passed | {"end": "fixed"}},
        }[task.part]
        return {"design": f"{task.latent[0]:.6f}", "verdicts": verdicts}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(command, "Work", Fake)
    for name, value in (("calls", []), ("broken", -1), ("stop_at", -1)):
        monkeypatch.setattr(Fake, name, value)

    def call(*words: object, out: Path = tmp_path / "out") -> tuple[int, str]:
        argv = ["study", "--decoder", "genome", "--workers", "0", "--out", str(out), *map(str, words)]
        monkeypatch.setattr(sys, "argv", argv)
        capsys.readouterr()
        status = command.main()
        return status, capsys.readouterr().out

    return call


def result(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "passthrough.json").read_text())


def lines(folder: Path) -> list[dict[str, Any]]:
    found = list(read_rows(folder / "verdicts.jsonl"))
    return [{name: value for name, value in line.items() if name != "seconds"} for line in found]


def test_every_rule_counts_every_body_once(run, tmp_path: Path) -> None:
    status, said = run("-n", 12, "--auto", 5, "--repair", 12)
    assert status == 0
    found = result(tmp_path / "out")
    rules = found["rules"]
    assert {name: r["n"] for name, r in rules.items()} == {"paper": 12, "search": 12, "auto": 5, "repair": 12}
    for r in rules.values():
        assert set(r["counts"]) == STAGES
        assert sum(r["counts"].values()) == r["n"]
    assert rules["paper"]["counts"]["passed"] == 6
    assert rules["search"]["counts"]["passed"] == 8
    assert rules["repair"]["counts"]["passed"] == 8 + 2  # 3 and 9 are mended, 0 and 6 are not
    assert rules["paper"]["reasons"] == {"motor: no_overlap": 6}
    pair = found["paired"]["search - paper"]
    assert (pair["both"], pair["only_first"], pair["only_second"], pair["neither"]) == (4, 2, 4, 2)
    assert found["paired"]["auto - search"]["n"] == 5
    assert found["ends_of_sizing"] == {"fixed": 5}
    assert said.strip() == (tmp_path / "out" / "passthrough.md").read_text().strip()
    assert "| motor | 6 | 4 | 0 | 2 |" in said
    assert "**6** of 12" in said


def test_only_what_the_search_refuses_is_repaired(run) -> None:
    run("-n", 12, "--repair", 7)
    assert [body for body, part in Fake.calls if part == "repair"] == [0, 3, 6]
    assert not [body for body, part in Fake.calls if part == "auto"]


@pytest.mark.parametrize("moment", [0, 5, 14])
def test_a_stopped_study_goes_on_and_a_torn_line_is_done_again(run, tmp_path: Path, moment: int) -> None:
    words = ("-n", 12, "--auto", 2, "--repair", 12)
    run(*words, out=tmp_path / "whole")
    whole, told = lines(tmp_path / "whole"), result(tmp_path / "whole")
    Fake.calls, Fake.stop_at = [], moment
    assert run(*words)[0] == 3
    path = tmp_path / "out" / "verdicts.jsonl"
    with path.open("a") as file:
        file.write('{"body": 11, "part": "rul')  # what kill -9 may leave
    Fake.stop_at = -1
    assert run(*words)[0] == 0
    assert lines(tmp_path / "out") == whole
    assert result(tmp_path / "out") == told
    done = len(Fake.calls)
    assert run(*words)[0] == 0
    assert len(Fake.calls) == done


def test_more_bodies_and_rules_may_be_asked_for_later_and_fewer_too(run, tmp_path: Path) -> None:
    run("-n", 12, "--auto", 3, "--repair", 12, out=tmp_path / "once")
    run("-n", 6)
    assert set(result(tmp_path / "out")["rules"]) == {"paper", "search"}
    run("-n", 12, "--auto", 3, "--repair", 12)
    assert result(tmp_path / "out") == result(tmp_path / "once")
    run("-n", 6)
    assert result(tmp_path / "out")["rules"]["paper"]["n"] == 6


def test_another_seed_is_not_mixed_in(run, tmp_path: Path) -> None:
    run("-n", 3)
    before = (tmp_path / "out" / "verdicts.jsonl").read_bytes()
    assert run("-n", 3, "--seed", 1)[0] == 2
    assert (tmp_path / "out" / "verdicts.jsonl").read_bytes() == before


def test_a_body_that_breaks_its_worker_is_a_failure_of_all_rules_and_the_run_goes_on(run, tmp_path: Path) -> None:
    Fake.broken = 3
    assert run("-n", 12, "--auto", 5, "--repair", 12)[0] == 0
    rules = result(tmp_path / "out")["rules"]
    assert {name: r["counts"]["worker"] for name, r in rules.items()} == {
        "paper": 1, "search": 1, "auto": 1, "repair": 1,
    }  # fmt: skip
    assert sum(rules["paper"]["counts"].values()) == 12
    assert [body for body, part in Fake.calls if part == "repair"] == [0, 6, 9]


def test_both_rules_say_what_the_pipeline_says() -> None:
    latents = sample_latents(4, np.random.default_rng(1))
    for body, design in enumerate(make_decoder("genome").decode(latents)):
        found = Work("genome")(Task(body, "rules", latents[body]))
        assert found["design"] == design.key
        for rules in ("paper", "search"):
            outcome, verdict = score(design, rules=rules), found["verdicts"][rules]  # type: ignore[arg-type]
            assert verdict["scores"] == list(outcome.scores.values())
            assert verdict["outcome"] == ("passed" if outcome.failure is None else str(outcome.failure.stage))
            assert verdict.get("detail") == (None if outcome.failure is None else outcome.failure.detail)


def test_repair_tells_what_was_changed() -> None:
    latents = sample_latents(12, np.random.default_rng(0))
    decoder = make_decoder("vae")  # whose bodies the search refuses sooner
    body = next(k for k, z in enumerate(latents) if not Judge("search").score(decoder.decode(z[None])[0]).ok)
    found = Work("vae")(Task(body, "repair", latents[body]))["verdicts"]["repair"]
    assert found["tried"] > 1
    assert (found["outcome"] == "passed") == bool(found["changes"])


def test_a_table_of_one_rule_has_no_pairs() -> None:
    text, numbers = table({"paper": {0: {"outcome": "passed"}, 1: {"outcome": "wire", "reason": "no_route"}}})
    assert numbers["paired"] == {}
    assert numbers["rules"]["paper"]["counts"]["wire"] == 1
    assert "| wire: no_route | 1 |" in text


def test_lines_beyond_what_is_asked_for_are_left_out() -> None:
    found = by_rules(
        [{"body": k, "verdicts": {"paper": {"outcome": "passed"}, "search": {"outcome": "passed"}}} for k in range(4)],
        3, {"repair": 2, "auto": 0},
    )  # fmt: skip
    assert {rules: list(verdicts) for rules, verdicts in found.items()} == {
        "paper": [0, 1, 2], "search": [0, 1, 2], "repair": [0, 1],
    }  # fmt: skip


def test_killed_it_loses_no_line(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "experiments.passthrough_study", "-n", "4", "--decoder", "genome", "--workers", "1",
             "--out", str(tmp_path / "out")]  # fmt: skip
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    path = tmp_path / "out" / "verdicts.jsonl"
    while process.poll() is None and (not path.exists() or path.read_bytes().count(b"\n") < 3):
        time.sleep(0.05)
    process.kill()
    process.wait()
    kept = lines(tmp_path / "out")
    assert len(kept) >= 3
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    whole = lines(tmp_path / "out")
    assert whole[: len(kept)] == kept
    assert [line["body"] for line in whole[1:]] == [0, 1, 2, 3]
