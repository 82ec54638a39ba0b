"""The study of fitness keeps bodies of different rules apart."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from experiments import fitness_study
from experiments.output import BadInput


@pytest.mark.parametrize(
    ("row", "rules"), [({}, "search"), ({"solver": "search"}, "paper"), ({"solver": "paper"}, "search")]
)
def test_bodies_of_other_rules_are_not_gone_on_with(row: dict[str, str], rules: str, tmp_path: Path) -> None:
    (tmp_path / "bodies.jsonl").write_text(json.dumps({"design": "0" * 16, **row}) + "\n")
    with pytest.raises(BadInput, match=f"by other rules than {rules}; choose another --out"):
        fitness_study.run(1, 0, 1000, "genome", rules, 1, tmp_path)  # type: ignore[arg-type]


def test_a_body_passes_by_the_rules_of_the_study(monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    from decoder.latent import make_decoder, sample_latents

    monkeypatch.setattr("mfg.pipeline.build", lambda _, rules: SimpleNamespace(ok=rules == "paper"))
    latent = sample_latents(1, np.random.default_rng(77))[0]
    assert fitness_study.Passes("genome", "search")(latent) is None
    assert fitness_study.Passes("genome", "paper")(latent) == make_decoder("genome").decode(latent[None])[0].key
