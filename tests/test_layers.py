"""The package's floors: imports run one way, and `import torch_mcaa` brings and changes next to nothing."""

from __future__ import annotations

import ast
import graphlib
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import torch_mcaa

ROOT = Path(torch_mcaa.__file__).parent
# A module imports from floors below its own; the files of one folder import each other without a circle.
FLOORS = (
    {"errors", "picking", "sums", "dense"},
    {"rng", "moments", "allocation", "compiling", "tolerance", "scene_file"},
    {"grid", "filters", "patterns", "strata"},
    {"densities", "integrand", "texture", "scenes"},
    {"edges", "traced"},
    {"estimators"},
    {"progress", "rendering", "arguments", "picture", "sharing_out", "replicates"},
    {"history"},
    {"rounds"},
    {"render", "replay"},
    {"supersampler"},
    {"warp"},
    {"image_io"},
    {"charting"},
    {"demo", "cli"},
)
FLOOR = {module: floor for floor, modules in enumerate(FLOORS) for module in modules}
# beside the standard library; what else is needed is imported inside functions
EVERYWHERE = {"torch", "numpy", "torch_mcaa"}
HEAVY = ("scipy", "kornia", "kornia_rs", "skimage", "matplotlib", "typer", "rich", "PIL", "tifffile", "OpenEXR")


def files() -> list[Path]:
    return sorted(ROOT.rglob("*.py"))


def name_of(file: Path) -> str:
    """torch_mcaa.filters.box, torch_mcaa.filters (for its __init__), torch_mcaa.grid."""
    parts = ["torch_mcaa", *file.relative_to(ROOT).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(file): file for file in files()}


def statements(node: ast.AST, lazily: bool) -> Iterator[ast.Import | ast.ImportFrom]:
    """The import statements that run when a module is imported; with `lazily` those inside functions too."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        elif lazily or not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from statements(child, lazily)


def imports(module: str, lazily: bool = False) -> set[str]:
    """The modules that a module imports, by their full names."""
    found: set[str] = set()
    for statement in statements(ast.parse(MODULES[module].read_text(encoding="utf-8")), lazily):
        if isinstance(statement, ast.Import):
            found |= {alias.name for alias in statement.names}
        else:
            assert statement.level == 0, f"{module} imports relatively"
            assert statement.module is not None
            inner = {f"{statement.module}.{alias.name}" for alias in statement.names}
            found |= {name if name in MODULES else statement.module for name in inner}
    return found


def part(module: str) -> str:
    """The part of the package that a module belongs to: filters for torch_mcaa.filters.box."""
    return module.split(".")[1]


def test_every_module_has_one_floor() -> None:
    assert {part(module) for module in MODULES if "." in module} == set(FLOOR)
    assert sum(map(len, FLOORS)) == len(FLOOR)


@pytest.mark.parametrize("module", sorted(MODULES))
def test_imports_run_down(module: str) -> None:
    for other in imports(module):
        if other.split(".")[0] != "torch_mcaa" or module == "torch_mcaa":
            continue
        assert other in MODULES, f"{module} imports {other} from the top of the package"
        assert other != "torch_mcaa", f"{module} imports the whole package"
        if part(other) != part(module):
            assert FLOOR[part(other)] < FLOOR[part(module)], f"{module} imports {other}, which is not on a floor below"


def test_no_circles() -> None:
    inside = {module: {other for other in imports(module) if other in MODULES and other != module} for module in MODULES}
    order = list(graphlib.TopologicalSorter(inside).static_order())
    assert len(order) == len(MODULES)


@pytest.mark.parametrize("module", sorted(MODULES))
def test_only_torch_and_numpy_at_module_level(module: str) -> None:
    allowed = EVERYWHERE | sys.stdlib_module_names | ({"typer"} if module == "torch_mcaa.cli" else set())
    assert {name.split(".")[0] for name in imports(module)} <= allowed
    # a dependency of the tests only
    assert "scipy" not in {name.split(".")[0] for name in imports(module, lazily=True)}


PROGRAM = """
import json, sys, time, warnings
start = time.process_time()
import torch
torchs = time.process_time() - start
def state():
    return [torch.get_rng_state().tolist(), str(torch.get_default_dtype()), torch.get_num_threads(), torch.is_grad_enabled(),
            [str(f) for f in warnings.filters], sys.path]
before, modules, start = state(), set(sys.modules), time.process_time()
import torch_mcaa
spent = time.process_time() - start
print(json.dumps({"share": spent / torchs, "new": sorted(set(sys.modules) - modules), "same": state() == before}))
"""


def test_import_is_light_and_changes_nothing() -> None:
    """Three processes; the time is the processor's, not the clock's, in parts of torch's own, and the first may have to compile."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT.parent)}
    runs = [
        json.loads(
            subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, env=environment).stdout
        )
        for _ in range(3)
    ]
    assert statistics.median(run["share"] for run in runs) <= 0.2
    for run in runs:
        assert run["same"]
        new = set(run["new"])
        assert "torch_mcaa" in new
        assert not {name for name in new if name.split(".")[0] in HEAVY}
        assert not {name for name in new if name.startswith("torch.")}
        assert {name.split(".")[0] for name in new} <= EVERYWHERE | sys.stdlib_module_names
        for lazy in ("torch_mcaa.cli", "torch_mcaa.demo", "torch_mcaa.image_io", "torch_mcaa.charting"):
            assert lazy not in new


def test_what_is_exported_exists() -> None:
    assert sorted(torch_mcaa.__all__) == list(torch_mcaa.__all__)
    for name in torch_mcaa.__all__:
        assert hasattr(torch_mcaa, name)
