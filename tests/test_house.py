"""Rules of the house that no linter knows."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

MAX_LINES = 400
ROOMS = ("contracts", "drivers", "sim", "processing", "rig", "bench")
HEAVY = ("numpy", "cv2", "pycolmap", "matplotlib", "PIL", "tifffile", "pydantic")
REGISTRY_HOST = re.compile(r"https?://(registry|files|static|index|proxy|repo1?|deb|pypi)\.", re.IGNORECASE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)#\s]+)[^)]*\)")


def tracked(repository: Path, *patterns: str) -> list[Path]:
    """Files of the checkout by pattern, without what tools leave there."""
    hidden = {".git", ".venv", "build", "dist", "demo", "out", ".types"}
    found = [path for pattern in patterns for path in sorted(repository.rglob(pattern))]
    return [path for path in found if path.is_file() and not hidden & set(path.relative_to(repository).parts)]


def modules_after(code: str) -> set[str]:
    """Top-level modules that a fresh interpreter holds after ``code``."""
    script = f"import sys\n{code}\nprint(' '.join(sorted({{name.partition('.')[0] for name in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.split("\n")[-2].split())


def test_source_files_are_short(repository: Path) -> None:
    sources = [path for room in ROOMS for path in tracked(repository / room, "*.py", "*.cpp", "*.hpp")]
    assert len(sources) > 50
    too_long = {str(p.relative_to(repository)): n for p in sources if (n := _lines(p)) > MAX_LINES}
    assert too_long == {}


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_importing_processing_costs_nothing() -> None:
    assert not modules_after("import lfrig.processing, lfrig.rig, lfrig.sim, lfrig.drivers, lfrig.bench") & set(HEAVY)


HEAVIEST = ("cv2", "pycolmap", "matplotlib", "PIL", "tifffile", "rawpy", "scipy")
"""What takes tenths of a second, or tens of megabytes, to load: for the functions that need it."""


def test_importing_the_pipeline_loads_no_library_that_few_runs_need() -> None:
    loaded = modules_after("import lfrig.processing.pipeline, lfrig.processing.live, lfrig.rig.process")
    assert "numpy" in loaded and not loaded & set(HEAVIEST)


def test_importing_a_benchmark_loads_no_library_that_few_runs_need() -> None:
    loaded = modules_after("from lfrig.bench import BENCHES, load\nfor name in BENCHES: load(name)")
    assert not loaded & set(HEAVIEST)


def test_help_loads_typer_and_rich_alone() -> None:
    loaded = modules_after("from lfrig.rig.cli import main\nassert main(['--help']) == 0")
    assert {"typer", "rich"} <= loaded
    assert not loaded & set(HEAVY)


def test_every_native_kernel_has_a_numpy_twin(repository: Path) -> None:
    kernels = repository / "processing" / "kernels"
    names = {path.stem for path in kernels.glob("*.cpp")} - {"module"}
    assert names
    assert {name for name in names if not (kernels / f"{name}.py").is_file()} == set()


def test_constraints_are_plain_and_cover_what_is_declared(repository: Path) -> None:
    lines = (repository / "constraints.txt").read_text(encoding="utf-8").split()
    pinned = {}
    for line in lines:
        name, _, version = line.partition("==")
        assert re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.+!-]+", line), line
        pinned[_canonical(name)] = version
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    declared = [
        *project["project"]["dependencies"],
        *project["project"]["optional-dependencies"]["dev"],
        *project["build-system"]["requires"],
    ]
    names = {_canonical(re.split(r"[<>=!~ \[;]", requirement)[0]) for requirement in declared}
    assert names - set(pinned) == set()


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_wheel_holds_every_room(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))
    packages = project["tool"]["scikit-build"]["wheel"]["packages"]
    assert packages == {f"lfrig/{room}": room for room in ROOMS}
    assert {link.name for link in (repository / ".types" / "lfrig").iterdir()} == set(ROOMS)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_in_the_documents_lead_somewhere(repository: Path, name: str) -> None:
    text = (repository / name).read_text(encoding="utf-8")
    local = [link for link in LINK.findall(text) if "://" not in link]
    assert [link for link in local if not (repository / link).exists()] == []


def test_no_registry_host_or_foreign_path_is_written_down(repository: Path) -> None:
    files = tracked(repository, "*.py", "*.cpp", "*.hpp", "*.md", "*.toml", "*.txt", "Makefile", "CMakeLists.txt")
    files += tracked(repository / ".ci", "*")
    assert len(files) > 60
    here = Path(__file__).resolve()
    found = [
        f"{path.relative_to(repository)}: {line.strip()}"
        for path in files
        if path.resolve() != here
        for line in path.read_text(encoding="utf-8").splitlines()
        if REGISTRY_HOST.search(line) or "/work/" in line or "/root/" in line
    ]
    assert found == []


def test_the_command_reference_names_every_command(repository: Path) -> None:
    from lfrig.rig.cli.app import app

    text = (repository / "docs" / "cli.md").read_text(encoding="utf-8")
    names = [command.name for command in app.registered_commands] + [group.name for group in app.registered_groups]
    assert len(names) >= 18
    assert [name for name in names if f"lfrig {name}" not in text] == []
