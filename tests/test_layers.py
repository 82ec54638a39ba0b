"""The layers: imports point down only, and a few pairs may share a few modules only."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ALL = ("decoder", "mfg", "sim", "evo", "analysis", "hardware", "experiments")

# What each folder may import: a folder, or single modules of it.
ALLOWED: dict[str, tuple[str, ...]] = {
    "decoder": (),
    "mfg": ("decoder",),
    "sim": ("decoder", "mfg"),
    "evo": ("decoder", "mfg", "sim"),
    "analysis": ("mfg.outcome",),
    "hardware": ("sim.observation", "sim.actor"),
    "experiments": ALL,
}


def imported_modules(source: str, package: str) -> Iterator[str]:
    """Every module a source names, wherever the import stands: top level, function or TYPE_CHECKING."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = f"{package}.{base}".rstrip(".") if node.level == 1 else f"(above {package})"
            # `from sim import actor` names the module sim.actor.
            yield from (f"{base}.{alias.name}" for alias in node.names)


def violations(source: str, package: str) -> list[str]:
    permitted = (package, *ALLOWED[package])
    found = []
    for module in imported_modules(source, package):
        ours = module.split(".")[0] in (*ALL, "tests") or module.startswith("(")
        if ours and not any(module == p or module.startswith(f"{p}.") for p in permitted):
            found.append(module)
    return found


@pytest.mark.parametrize("package", ALL)
def test_imports_point_down(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files, f"{package} has no source"
    wrong = {str(f.relative_to(ROOT)): bad for f in files if (bad := violations(f.read_text("utf-8"), package))}
    assert wrong == {}


@pytest.mark.parametrize(
    ("package", "planted"),
    [
        ("decoder", "import mfg.outcome"),
        ("mfg", "from sim.model import compile_model"),
        ("mfg", "def f():\n    from evo import loop"),
        ("sim", "if TYPE_CHECKING:\n    from evo.loop import Loop"),
        ("evo", "from analysis import lda"),
        ("analysis", "from mfg import pipeline"),
        ("analysis", "from mfg.outcomes import Stage"),
        ("hardware", "from sim import model"),
        ("hardware", "import sim"),
        ("hardware", "import analysis.records"),
        ("mfg", "from .. import sim"),
        ("sim", "import experiments"),
        ("mfg", "from tests import conftest"),
    ],
)
def test_a_planted_violation_is_caught(package: str, planted: str) -> None:
    assert violations(planted, package)


@pytest.mark.parametrize(
    ("package", "fine"),
    [
        ("analysis", "from mfg.outcome import Stage"),
        ("hardware", "from sim import actor, observation"),
        ("hardware", "import sim.actor"),
        ("mfg", "from . import fields\nfrom .outcome import Stage\nimport numpy as np"),
        ("experiments", "from evo import loop\nfrom hardware.bus import Bus"),
    ],
)
def test_a_permitted_import_passes(package: str, fine: str) -> None:
    assert violations(fine, package) == []


def test_the_test_tree_cannot_shadow_a_package() -> None:
    assert list((ROOT / "tests").rglob("__init__.py")) == []
