"""The `bodyplan` command: find the command, run it, turn every expected trouble into one clear line."""

from __future__ import annotations

import argparse
import difflib
import os
import sqlite3
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from experiments import build, deploy, doctor, replay, report, run, sample, score, simulate, study, train, train_decoder
from experiments.output import BAD_INPUT, DEFECT, INTERRUPTED, VERSION, BadInput, say

# In the order in which a new user meets them. Their files import nothing heavy until they run.
COMMANDS = {
    "run": run, "sample": sample, "build": build, "score": score, "study": study, "simulate": simulate,
    "train": train, "deploy": deploy, "replay": replay, "report": report, "train-decoder": train_decoder,
    "doctor": doctor,
}  # fmt: skip

# Commands of the design that this version does not know yet.
LATER = {"studio": "the studio"}

# Workers are processes, one per core; a maths library that starts threads of its own makes all of them slower, and its
# sums depend on the number of threads. Must be set before numpy is imported.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
                    "NUMEXPR_NUM_THREADS")  # fmt: skip

# Errors of the library that say what is wrong with a file. By name, so that a command loads no more than it uses.
BAD_INPUT_ERRORS = frozenset({
    "decoder.design_file.DesignError", "mfg.manifest.ManifestError", "sim.model.ModelError",
    "hardware.document.BundleError", "evo.loop.ResumeError", "hardware.log.LogError", "decoder.weights.WeightsError",
    "mfg.component_file.ComponentError",
})  # fmt: skip

STORY = """\
Evolve robots that can be built: a latent vector becomes a body, solvers put motors, electronics and wires into it or
say why they cannot, a simulator lets it walk, evolution asks for more, and the winner leaves as a folder to print.

a first session:
  bodyplan sample -n 8 --out bodies            propose eight bodies and look at bodies/sheet.png
  bodyplan score bodies/*.npz                  can each one be built, and how easily?
  bodyplan build experiments/examples/quadruped.vox --out robot      a painted one, as a folder to print
  bodyplan simulate robot --video walk.mp4     find a gait for it and film it
  bodyplan build experiments/examples/tripod.vox --out tripod --catalogue auto     with the parts that its gait asks for

an experiment:
  bodyplan run experiments/configs/quickstart.toml --out runs/first
  bodyplan run experiments/configs/quickstart.toml --out runs/first --resume     after Ctrl-C or a crash
  bodyplan report runs/first                   one HTML file about what happened, as the run leaves it too
  bodyplan deploy runs/first/best/bundle --bus virtual --dry-run     rehearse on simulated motors
  bodyplan study -n 1000 --out runs/study      what share of random bodies can be built, and what stops the others

another decoder:
  bodyplan train-decoder experiments/configs/decoder_cpu.toml --out runs/decoder     some hours; --resume goes on

exit status: 0 done, 1 the design cannot be built, 2 bad input or configuration, 3 interrupted:
give the same command again (`run` and `train-decoder` with --resume); `deploy` never gives 3, see its help.
70 is a defect of this program.
"""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print the one line and leave with status 2."""
        say(f"bodyplan: error: {message} (see `{self.prog} --help`)")
        raise SystemExit(BAD_INPUT)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        args = _parse(argv)
        status: int = args.main(args)
        sys.stdout.flush()
    except KeyboardInterrupt:
        say("bodyplan: interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output, `head` for example, has seen enough. Python would complain again while it closes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # noqa: BLE001 - Python's own status 1 would say that the design cannot be built.
        if _is_bad_input(error):
            say(f"bodyplan: error: {_one_line(error, argv)}")
            return BAD_INPUT
        traceback.print_exc()
        say("bodyplan: this is a defect of the program; please report it with all of the lines above")
        return DEFECT
    return status


def _parse(argv: list[str]) -> argparse.Namespace:
    parser = Parser(
        prog="bodyplan", description=STORY, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"bodyplan {VERSION}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    if argv and argv[0] in LATER:
        parser.error(f"{argv[0]}: {LATER[argv[0]]} arrives in a later version")
    if argv and not argv[0].startswith("-") and argv[0] not in COMMANDS:
        close = difflib.get_close_matches(argv[0], COMMANDS, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(COMMANDS)}"
        parser.error(f"unknown command {argv[0]!r}; {hint}")
    for name, module in COMMANDS.items():
        command = commands.add_parser(name, help=module.HELP, description=module.HELP, allow_abbrev=False)
        module.configure(command)
        command.set_defaults(main=module.main, parser=command)
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        known = [option for action in args.parser._actions for option in action.option_strings]
        close = difflib.get_close_matches(unknown[0].partition("=")[0], known, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        args.parser.error(f"unknown argument {unknown[0]!r}{hint}")
    return args


def _is_bad_input(error: BaseException) -> bool:
    """Tell what the user can mend from a defect of this program, which must show its traceback."""
    if isinstance(error, (BadInput, OSError)):
        return True
    if isinstance(error, sqlite3.DatabaseError):
        return not isinstance(error, (sqlite3.ProgrammingError, sqlite3.IntegrityError))
    return any(f"{kind.__module__}.{kind.__qualname__}" in BAD_INPUT_ERRORS for kind in type(error).__mro__)


def _one_line(error: BaseException, argv: list[str]) -> str:
    if isinstance(error, OSError) and error.strerror:
        # A full disk is reported without a name; the command line says what was being written.
        name = error.filename if error.filename is not None else f"bodyplan {' '.join(argv)}"
        return f"{name}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__


if __name__ == "__main__":
    sys.exit(main())
