"""The house rules that a tool can check: sizes, broad excepts, import-time side effects, import cycles."""

import ast
import runpy
import statistics
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("mavdiag", "sitl_plant", "detector")
FILES = {path: path.read_text() for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))}
TREES = {path: ast.parse(text) for path, text in FILES.items()}


def test_no_function_is_longer_than_60_lines_and_nine_in_ten_have_25() -> None:
    """Signatures and docstrings left out."""
    lengths = {}
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                length = (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0
                lengths[f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"] = length
    assert [name for name, length in lengths.items() if length > 60] == []
    assert statistics.quantiles(lengths.values(), n=10)[8] <= 25


def test_no_broad_except_but_the_one_that_parts_vehicles_and_no_mavutil() -> None:
    """ruff refuses what has no such mark. One session's exception must not end the daemon for all vehicles."""
    assert [str(path.relative_to(ROOT)) for path, text in FILES.items() if "BLE001" in text] == ["detector/fleet.py"]
    assert not any("mavutil" in text for text in FILES.values())


def loaded_by(statement: str) -> set[str]:
    """Top-level modules, and scipy.signal, that are there after a statement in a fresh interpreter."""
    code = f"import sys; {statement}; print(*sorted(m for m in sys.modules if '.' not in m or m == 'scipy.signal'))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(run.stdout.split())


def test_detector_and_plant_start_without_heavy_imports() -> None:
    heavy = {"matplotlib", "control", "scipy.signal", "pandas"}
    assert not loaded_by("import detector, mavdiag.__main__; import sitl_plant") & {"numpy", "typer", "email"}
    assert not loaded_by("import detector.daemon") & {*heavy, "sitl_plant", "http.client", "serial", "statistics"}
    own = "import sitl_plant.__main__; from sitl_plant.autopilot.telemetry import *; from sitl_plant.plant import *"
    flown = f"{own}; flight_telemetry(PlantConfig(turbulence_m_s=5.0), 0.1, LinkSpec('ardupilot'))"
    assert not loaded_by(flown) & heavy


def test_no_import_cycles() -> None:
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}
    graph = dict[str, set[str]]()
    for name, path in names.items():
        found = set[str]()
        for node in TREES[path].body:
            if isinstance(node, ast.ImportFrom) and node.module:
                found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
        graph[name] = found & names.keys() - {name}
    TopologicalSorter(graph).prepare()


def test_the_tests_that_the_mutation_run_names_are_there() -> None:
    rooms = runpy.run_path(str(ROOT / "benchmarks" / "mutants.py"))["ROOMS"]
    named = [ROOT / "tests" / "unit" / f"test_{name}.py" for _, tests in rooms.values() for name in tests]
    assert [path.name for path in named if not path.exists()] == []
