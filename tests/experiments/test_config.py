from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evo.fitness import FitnessRule
from experiments import config as c
from experiments import output, toml_document
from experiments.output import BadInput
from sim.gaits import SCREENING, THOROUGH

# Those of `bodyplan train-decoder` are another command's, and tested with it.
CONFIGS = [path for path in sorted((Path(c.__file__).parent / "configs").glob("*.toml")) if "decoder" not in path.stem]

numbers = st.floats(allow_nan=False, allow_infinity=False)
gaits = st.builds(
    c.ThoroughGait, random=st.integers(2, 99), seconds=st.floats(0.1, 1000.0), hopeless=st.floats(0.0, 10.0)
)
configs: st.SearchStrategy[c.Config] = st.one_of(
    st.builds(
        c.Evolve,
        kind=st.just("evolve"),
        seed=st.integers(0, 2**63 - 1),
        workers=st.none() | st.integers(0, 1024),
        search=st.builds(c.Search, generations=st.integers(1, 99), sigma=st.floats(0.001, 10.0)),
        fitness=st.builds(c.Fitness, mode=st.sampled_from(["penalty", "constraint", "speed"])),
        finals=st.builds(c.Finals, gait=gaits),
    ),
    st.builds(c.Study, kind=st.just("study"), n=st.integers(1, 10**6), prior=st.sampled_from(["normal", "uniform"])),
    st.builds(c.Sketch, kind=st.just("sketch"), design=st.text(st.characters(codec="utf-8"), min_size=1)),
)


@given(configs)
def test_what_is_written_reads_back_equal(config: c.Config) -> None:
    text = c.to_toml(config)
    assert c.parse_config(tomllib.loads(text), "f") == config
    assert c.to_toml(c.parse_config(tomllib.loads(text), "f")) == text


@given(configs, configs)
def test_equal_hashes_mean_equal_but_for_workers(one: c.Config, two: c.Config) -> None:
    assert c.config_hash(one) == c.config_hash(one)
    same = c.differences(one, two) == []
    assert same == (c.config_hash(one) == c.config_hash(two))
    if isinstance(one, c.Evolve):
        moved = msgspec.structs.replace(one, workers=7)
        assert c.config_hash(moved) == c.config_hash(one)
        assert c.differences(one, moved) == []


def test_differences_name_key_and_values() -> None:
    one = c.parse_config({"kind": "evolve"}, "f")
    two = c.parse_config({"kind": "evolve", "seed": 3, "finals": {"gait": {"seconds": 2.0}}}, "f")
    assert c.differences(one, two) == ["seed was 0 and is now 3", "finals.gait.seconds was 6.0 and is now 2.0"]


def wrong(document: dict[str, Any]) -> str:
    with pytest.raises(BadInput) as caught:
        c.parse_config(document, "f.toml")
    return str(caught.value)


def evolve(**keys: Any) -> dict[str, Any]:
    return {"kind": "evolve", **keys}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({}, 'kind is missing; add a line kind = "evolve" | "study" | "sketch" | "policy"'),
        (
            {"kind": "evlove"},
            'kind = "evlove"; it must be "evolve" | "study" | "sketch" | "policy"; did you mean "evolve"?',
        ),
        ({"kind": 3}, 'kind = 3; it must be "evolve" | "study" | "sketch" | "policy"'),
        ({"kind": ["evolve"]}, 'kind = ["evolve"]; it must be "evolve" | "study" | "sketch" | "policy"'),
        ({"kind": "policy"}, "robot is missing; it must be a text that is not empty"),
        (
            evolve(decoder="gnome"),
            'decoder = "gnome"; it must be "vae" | "genome" | a file ending in .safetensors; did you mean "genome"?',
        ),
        (evolve(decoder="a\nb.safetensors"), 'decoder = "a\\u000ab.safetensors"; it must be "vae" | "genome" | a file'),
        (evolve(decoder=""), 'decoder = ""; it must be "vae" | "genome"'),
        (evolve(decoder=7), 'decoder = 7; it must be "vae" | "genome"'),
        (evolve(solver="seek"), 'solver = "seek"; it must be "paper" | "search"'),
        ({"kind": "study", "repair": 1}, "repair = 1; it must be true | false"),
        (evolve(parts="shelf"), 'parts = "shelf"; there is nothing to choose from them but with catalogue = "auto"'),
        (evolve(parts="", catalogue="auto"), 'parts = ""; it must be a text that is not empty'),
        (evolve(catalogue="atuo"), 'catalogue = "atuo"; it must be "paper" | "auto"; did you mean "auto"?'),
        (evolve(sed=1), "unknown key sed; did you mean seed?"),
        (evolve(search={"popsiz": 8}), "unknown key search.popsiz; did you mean popsize?"),
        (evolve(zzz=1), "unknown key zzz; known here are kind, seed, decoder"),
        (evolve(popsize=8), "unknown key popsize; known here are"),
        (evolve(search={"popsize": 3}), "search.popsize = 3; it must be a whole number in [4, 100000]"),
        (evolve(search={"popsize": 8.5}), "search.popsize = 8.5; it must be a whole number in [4, 100000]"),
        (evolve(search={"popsize": True}), "search.popsize = true; it must be a whole number"),
        (evolve(search={"sigma": 0}), "search.sigma = 0; it must be a number in (0, 10]"),
        (evolve(search={"sigma": float("nan")}), "search.sigma = nan; it must be a number in (0, 10]"),
        (evolve(search={"sigma": float("inf")}), "search.sigma = inf; it must be a number in (0, 10]"),
        (evolve(search=4), "search = 4; it must be a table: write [search]"),
        (evolve(seed={"a": 1}), "seed = a table; it must be a whole number"),
        (evolve(seed=-1), "seed = -1; it must be a whole number in [0, 9223372036854775807]"),
        (evolve(seed=2**80), "it must be a whole number in [0, 9223372036854775807]"),
        (evolve(seed="1"), 'seed = "1"; it must be a whole number'),
        (evolve(seed=[1]), "seed = [1]; it must be a whole number"),
        (evolve(workers=-2), "workers = -2; it must be a whole number in [0, 1024]"),
        (evolve(timeout=0.5), "timeout = 0.5; it must be a number in [1, 1e+06]"),
        (
            evolve(fitness={"mode": "penaltee"}),
            'fitness.mode = "penaltee"; it must be "penalty" | "constraint" | "speed"',
        ),
        (evolve(fitness={"mode": "penaltee"}), 'did you mean "penalty"?'),
        (evolve(fitness={"bound": 6}), "fitness.bound = 6; it must be a number in [0, 5]"),
        (evolve(finals={"gait": {"sceonds": 1.0}}), "unknown key finals.gait.sceonds; did you mean seconds?"),
        (evolve(finals={"gait": {"seconds": 0.0}}), "finals.gait.seconds = 0.0; it must be a number in [0.1, 1000]"),
        ({"kind": "study", "n": 0}, "n = 0; it must be a whole number in [1, 1000000]"),
        ({"kind": "study", "search": {}}, "unknown key search"),
        ({"kind": "sketch"}, "design is missing; it must be a text that is not empty"),
        ({"kind": "sketch", "design": ""}, 'design = ""; it must be a text that is not empty'),
    ],
)
def test_every_mistake_is_one_line_that_names_file_key_value_bound_and_remedy(
    document: dict[str, Any], message: str
) -> None:
    text = wrong(document)
    assert text.startswith("f.toml: ")
    assert message in text
    assert "\n" not in text
    assert len(text) < 250


@given(st.dictionaries(st.sampled_from([*c.Evolve.__struct_fields__, "x"]), st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)))  # fmt: skip
def test_no_document_gets_through_as_anything_but_a_config_or_bad_input(document: dict[str, Any]) -> None:
    try:
        config = c.parse_config({"kind": "evolve", **document}, "f")
    except BadInput:
        assert "\n" not in wrong({"kind": "evolve", **document})
    else:
        assert c.parse_config(tomllib.loads(c.to_toml(config)), "f") == config


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"kind = ", "is not a TOML file: Invalid value (at end of document)"),
        (b"kind = 'evolve'\nseed = 01\n", "(at line 2, column 9)"),
        (b"\xff\xfe\x00", "is not a text file in UTF-8"),
        (b"kind = 'evolve'\nkind = 'study'\n", "is not a TOML file"),
        (b"", "kind is missing"),
    ],
)
def test_what_is_not_toml_is_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_bytes(content)
    with pytest.raises(BadInput, match=re.escape(message)) as caught:
        c.load_config(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_configurations_that_ship_are_good(path: Path) -> None:
    config = c.load_config(path)
    assert c.parse_config(tomllib.loads(c.to_toml(config)), "f") == config


def test_every_kind_has_a_configuration_that_ships() -> None:
    assert {c.load_config(path).kind for path in CONFIGS} == set(c.KINDS)
    assert {"quickstart", "tiny"} <= {path.stem for path in CONFIGS}


def test_a_sketch_is_found_beside_its_configuration(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('kind = "sketch"\ndesign = "bodies/dog.vox"')
    config = c.load_config(tmp_path / "s.toml")
    assert isinstance(config, c.Sketch)
    assert config.design == str((tmp_path / "bodies" / "dog.vox").resolve())


@pytest.mark.parametrize("kind", ["evolve", "study"])
def test_weights_are_found_beside_their_configuration(tmp_path: Path, kind: str) -> None:
    (tmp_path / "c.toml").write_text(f'kind = "{kind}"\ndecoder = "mine/own.safetensors"')
    config = c.load_config(tmp_path / "c.toml")
    assert isinstance(config, c.Evolve | c.Study)
    assert config.decoder == str((tmp_path / "mine" / "own.safetensors").resolve())
    (tmp_path / "held.toml").write_text(c.to_toml(config))
    assert c.load_config(tmp_path / "held.toml") == config


@pytest.mark.parametrize("name", output.DECODERS)
def test_the_name_of_a_decoder_is_no_path(tmp_path: Path, name: str) -> None:
    (tmp_path / "c.toml").write_text(f'kind = "study"\ndecoder = "{name}"')
    config = c.load_config(tmp_path / "c.toml")
    assert isinstance(config, c.Study)
    assert config.decoder == name


def test_defaults_are_those_of_the_library() -> None:
    assert c.Gait().budget() == SCREENING
    assert c.Finals().gait.budget() == THOROUGH
    assert c.Fitness().rule() == FitnessRule()


def test_choices_are_those_of_the_command_line() -> None:
    assert tuple(toml_document.choices(c.DecoderName)) == output.DECODERS
    assert c.Evolve("evolve").decoder == c.Study("study").decoder == output.DEFAULT_DECODER
    kinds = (c.Evolve("evolve"), c.Study("study"), c.Sketch("sketch", "x.vox"), c.Policy("policy", "x.vox"))
    assert {kind.solver for kind in kinds} == {output.DEFAULT_SOLVER}
