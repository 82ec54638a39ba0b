"""Every heavy dependency has one door per layer that needs it, and the command line opens none before it must."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.cli import COMMANDS

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("decoder", "mfg", "sim", "evo", "analysis", "hardware", "experiments")

# Who imports what. Exactly these files: a door that is no longer used is a mistake in this table.
DOORS: dict[str, set[str]] = {
    "manifold3d": {"mfg/solids.py"},
    "skimage": {"mfg/solids.py"},
    "embreex": {"mfg/ray_soup.py"},
    "trimesh": {"mfg/export.py", "experiments/foreign_check.py"},
    "mujoco": {
        "sim/model.py",
        "sim/surfaces.py",
        "sim/skin.py",
        "sim/self_collision.py",
        "sim/rollout.py",
        "sim/plant.py",
        "sim/terrain.py",
        "sim/randomisation.py",
        "sim/herd.py",
        "sim/closed_loop.py",
        "sim/behaviour.py",
        "experiments/bench.py",
    },
    "cma": {"evo/cma_es.py", "sim/gaits.py"},
    "matplotlib": {"analysis/plots.py"},
    "sklearn": {"analysis/lda.py"},
    "pandas": {"analysis/records.py"},
    "can": {"hardware/bus.py"},
    "serial": set(),
    "msgspec": {
        "experiments/config.py",
        "experiments/decoder_config.py",
        "experiments/policy_config.py",
        "experiments/toml_document.py",
        "experiments/toml_text.py",
    },
    "gymnasium": {"sim/gym_env.py", "experiments/bench_training.py"},
    "stable_baselines3": {"sim/ppo.py", "experiments/bench_training.py"},
    "tqdm": {"experiments/output.py"},
    "torch": {
        "decoder/examples.py",
        "decoder/formulas.py",
        "decoder/growth.py",
        "decoder/linear_start.py",
        "decoder/room.py",
        "decoder/synthetic.py",
        "decoder/training.py",
        "experiments/bench_training.py",
        "experiments/decoder_training.py",
        "experiments/doctor.py",
        "sim/learning.py",
        "sim/ppo.py",
    },
    "safetensors": {"decoder/weights.py"},
    "tensorboardX": {"experiments/events.py"},
    "imageio_ffmpeg": {"sim/video.py", "experiments/doctor.py"},
}
# A command file is read for `bodyplan --help`; its top level may import these and nothing else.
LIGHT = set(sys.stdlib_module_names) | {"experiments"}


def is_type_checking(node: ast.AST) -> bool:
    """Whether this is an `if TYPE_CHECKING:`, whose imports only a type checker sees."""
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def roots(*nodes: ast.AST) -> set[str]:
    """Top-level names of every module that is imported below these nodes when the program runs."""
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add((node.module or "").split(".")[0])
        elif not is_type_checking(node):
            found |= roots(*ast.iter_child_nodes(node))
    return found


@functools.cache
def sources() -> dict[str, ast.Module]:
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    return {file.relative_to(ROOT).as_posix(): ast.parse(file.read_text("utf-8")) for file in files}


@pytest.mark.parametrize("library", DOORS)
def test_a_heavy_dependency_has_exactly_its_doors(library: str) -> None:
    assert {name for name, tree in sources().items() if library in roots(tree)} == DOORS[library]


@pytest.mark.parametrize("command", ["cli", "output", *COMMANDS])
def test_the_top_level_of_a_command_is_light(command: str) -> None:
    tree = ast.parse((ROOT / "experiments" / f"{command.replace('-', '_')}.py").read_text("utf-8"))
    top = [node for node in tree.body if not isinstance(node, ast.FunctionDef | ast.ClassDef)]
    assert roots(*top) <= LIGHT


def test_help_imports_no_numpy() -> None:
    code = (
        "import sys\n"
        "from experiments.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        f"print(sorted({{m.split('.')[0] for m in sys.modules}} & {set(DOORS) | {'numpy', 'scipy', 'PIL'}!r}))"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert shown.splitlines()[-1] == "[]"


def test_no_package_imports_anything_heavy_by_itself() -> None:
    for package in PACKAGES:
        tree = ast.parse((ROOT / package / "__init__.py").read_text("utf-8"))
        assert roots(tree) <= {"__future__"}, package
