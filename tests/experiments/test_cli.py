"""The command line: what it teaches, how it fails, and what it leaves alone."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sqlite3
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from decoder.design import DesignError
from experiments import cli, output
from experiments.cli import COMMANDS, THREAD_VARIABLES, VERSION
from hardware.bundle import BundleError

ROOT = Path(cli.__file__).parent.parent


@pytest.fixture
def doctor_that(monkeypatch):
    """Replace what `bodyplan doctor` does."""

    def replace(action):
        monkeypatch.setattr("experiments.doctor.main", action)

    return replace


def raising(error):
    def action(args):
        raise error

    return action


def test_help_names_every_command_and_says_what_it_does(bodyplan):
    said = bodyplan("--help")
    assert said.status == 0
    assert said.err == ""
    for name in COMMANDS:
        assert re.search(rf"^    {name}\s", said.out, re.MULTILINE), name


def test_every_command_explains_each_of_its_arguments(bodyplan):
    for name, module in COMMANDS.items():
        parser = argparse.ArgumentParser()
        module.configure(parser)
        assert all(action.help for action in parser._actions), name
        said = bodyplan(name, "--help")
        assert (said.status, said.err) == (0, "")
        assert module.HELP.split()[0] in said.out


def test_version_is_the_version_of_the_project(bodyplan):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["version"] == VERSION
    assert bodyplan("--version").out == f"bodyplan {VERSION}\n"


def test_the_options_offer_what_the_library_has():
    from decoder.latent import DECODERS, DEFAULT_DECODER, PRIORS
    from decoder.weights import SUFFIX

    assert output.DECODERS == DECODERS
    assert output.DEFAULT_DECODER == DEFAULT_DECODER
    assert output.WEIGHTS_SUFFIX == SUFFIX
    assert output.PRIORS == PRIORS


@pytest.mark.parametrize("command", ["sample", "study"])
def test_a_decoder_is_a_name_or_a_file_whose_path_holds_everywhere(command, tmp_path, monkeypatch):
    parser = argparse.ArgumentParser()
    COMMANDS[command].configure(parser)
    monkeypatch.chdir(tmp_path)

    def chosen(*words):
        return parser.parse_args(["--out", "x", *words]).decoder

    assert chosen() == output.DEFAULT_DECODER
    assert [chosen("--decoder", name) for name in output.DECODERS] == list(output.DECODERS)
    assert chosen("--decoder", "own.safetensors") == str(tmp_path / "own.safetensors")
    for wrong in ("gnome", "", "VAE", "own.pt", "a\nb.safetensors", "\udc80.safetensors"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"no decoder; known are vae, genome, and files ending in"):
            output.decoder(wrong)


@pytest.mark.parametrize(("word", "hint"), [("biuld", "'build'"), ("scores", "'score'"), ("docter", "'doctor'")])
def test_an_unknown_command_is_met_with_the_nearest(bodyplan, word, hint):
    said = bodyplan(word)
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert f"did you mean {hint}" in said.err


def test_a_command_like_none_of_ours_gets_the_list(bodyplan):
    assert "run, sample, build" in bodyplan("xyzzy").err


def test_an_unknown_option_is_met_with_the_nearest(bodyplan):
    said = bodyplan("sample", "--out", "x", "--sed", "3")
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert "did you mean --seed" in said.err


def test_options_are_not_abbreviated(bodyplan):
    assert bodyplan("doctor", "--js").status == 2


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (output.BadInput("no\nsuch thing"), "no such thing"),
        (DesignError("empty grid"), "empty grid"),
        (BundleError("no joints"), "no joints"),
        (FileNotFoundError(2, "No such file or directory", "a.npz"), "a.npz: No such file or directory"),
        (OSError(28, "No space left on device"), "bodyplan doctor: No space left on device"),
        (sqlite3.DatabaseError("file is not a database"), "file is not a database"),
        (sqlite3.OperationalError("no such table: evaluations"), "no such table: evaluations"),
    ],
)
def test_what_the_user_can_mend_is_one_line_and_status_2(bodyplan, doctor_that, error, line):
    doctor_that(raising(error))
    assert bodyplan("doctor") == (2, "", f"bodyplan: error: {line}\n")


@pytest.mark.parametrize("error", [ValueError("shapes differ"), KeyError("x"), sqlite3.IntegrityError("twice")])
def test_a_defect_of_the_program_is_not_passed_off_as_bad_input(bodyplan, doctor_that, error):
    doctor_that(raising(error))
    said = bodyplan("doctor")
    assert said.status == 70  # neither 1, which means that a design cannot be built, nor 2
    assert said.err.startswith("Traceback")
    assert f"{type(error).__name__}: {error}\nbodyplan: this is a defect of the program" in said.err


def test_the_names_of_bad_input_errors_are_names_of_errors():
    for name in cli.BAD_INPUT_ERRORS:
        module, _, kind = name.rpartition(".")
        error = getattr(importlib.import_module(module), kind)
        assert issubclass(error, ValueError)
        assert error.__module__ == module, name  # where it is defined, not where it may be had


def test_an_interruption_is_status_3(bodyplan, doctor_that):
    doctor_that(raising(KeyboardInterrupt()))
    assert bodyplan("doctor").status == 3


def test_the_status_of_a_command_is_the_status(bodyplan, doctor_that):
    doctor_that(lambda _: 1)
    assert bodyplan("doctor").status == 1


def test_maths_libraries_get_one_thread_unless_told(bodyplan, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    bodyplan("--version")
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert all(os.environ[variable] for variable in THREAD_VARIABLES)
    assert os.environ["MKL_NUM_THREADS"] == "1"


def test_a_reader_that_leaves_early_is_not_an_error():
    code = "import sys; from experiments.cli import main; sys.exit(main(['doctor', '--json']))"
    stub = "import experiments.doctor as d\nd.main = lambda args: print('x' * 10_000_000) or 0\n"
    command = f'{sys.executable} -c "{stub}{code}" | head -c 1; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_emit_refuses_what_json_has_no_word_for(capsys):
    output.emit({"a": [1, None, "β"]})
    assert capsys.readouterr().out.startswith("{")
    with pytest.raises(ValueError, match="JSON"):
        output.emit(float("nan"))


def test_progress_passes_everything_through(capsys):
    assert list(output.progress(iter("abc"), 3, "letters")) == ["a", "b", "c"]
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("text", ["0", "-3", "1.5", "many", "1000001", "9" * 30])
def test_a_count_is_a_whole_number_of_at_least_one_and_fits_the_memory(text):
    with pytest.raises(argparse.ArgumentTypeError):
        output.count(text)
    assert output.count("1000000") == 1_000_000


@pytest.mark.parametrize("command", ["sample", "study"])
def test_a_thousand_million_bodies_are_refused_in_one_line(bodyplan, tmp_path, command):
    said = bodyplan(command, "-n", 10**9, "--out", tmp_path / "out")
    assert said.status == 2
    assert "1000000000 is out of bounds; it must lie in [1, 1000000]" in said.err
    assert said.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["studio"])
def test_a_command_to_come_is_told_from_a_mistyped_one(bodyplan, command):
    said = bodyplan(command, "robot", "--out", "x")
    assert said.status == 2
    assert "arrives in a later version" in said.err
    assert said.err.count("\n") == 1


def test_the_catalogues_on_offer_exist():
    from experiments.judging import judge_of
    from mfg.library import read_library
    from mfg.parts import PAPER

    libraries = {"paper": None, "auto": read_library()}
    assert set(libraries) == set(output.CATALOGUES)
    for name in output.CATALOGUES:
        judge = judge_of("search", name, None)
        assert (judge.rules, judge.catalogue, judge.library) == ("search", PAPER, libraries[name])


def test_the_rules_on_offer_are_those_of_the_pipeline():
    from typing import get_args

    from mfg.pipeline import DEFAULT, RULES, Rules

    assert output.SOLVERS == get_args(Rules) == tuple(RULES)
    assert output.DEFAULT_SOLVER == DEFAULT


@pytest.mark.parametrize("command", ["score", "build", "study", "simulate"])
def test_solvers_and_components_can_be_chosen_wherever_designs_are_solved(bodyplan, command):
    said = bodyplan(command, "--help")
    assert "--solver {paper,search}" in said.out
    assert "--catalogue {paper,auto}" in said.out
    assert "--parts DIR" in said.out


def test_a_seed_may_be_zero_and_must_fit_the_run_file():
    assert output.seed("0") == 0
    assert output.seed(str(2**63 - 1)) == 2**63 - 1
    for text in ("-1", str(2**63), "0x1"):
        with pytest.raises(argparse.ArgumentTypeError):
            output.seed(text)


def test_make_folder_makes_parents_and_refuses_a_file_in_the_way(tmp_path):
    assert output.make_folder(tmp_path / "a" / "b").is_dir()
    assert output.make_folder(tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(output.BadInput, match="is a file"):
            output.make_folder(path)


def test_the_story_names_only_commands_that_exist():
    told = {line.split()[1] for line in cli.STORY.splitlines() if line.startswith("  bodyplan ")}
    assert told <= set(COMMANDS)
