"""Copies of the checkout, and environments to install them in, without touching a registry."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

NOT_SOURCE = shutil.ignore_patterns(
    ".git", ".venv", "build", "dist", "demo", "out", "tests", "__pycache__", ".*_cache", ".hypothesis", "*.so"
)


@dataclass(frozen=True)
class Environment:
    """A virtual environment that sees the libraries of this one, but not its lfrig."""

    folder: Path

    def run(self, *command: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment, from a folder that is no checkout."""
        away = self.folder.parent / "away"
        away.mkdir(exist_ok=True)
        inherited = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "LFRIG_NATIVE"}}
        return subprocess.run(
            [str(self.folder / "bin" / str(command[0])), *map(str, command[1:])],
            capture_output=True, text=True, cwd=away, env={**inherited, **variables}, check=False,
        )  # fmt: skip

    def install(self, *what: str | Path, **variables: str) -> None:
        """Pip install, with the build tools of this environment."""
        done = self.run("python", "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", *what, **variables)
        assert done.returncode == 0, done.stdout + done.stderr

    def python(self, code: str, **variables: str) -> str:
        """What a Python program prints."""
        done = self.run("python", "-c", code, **variables)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


@pytest.fixture
def environment(tmp_path: Path) -> Environment:
    """A fresh environment."""
    folder = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    site = next((folder / "lib").glob("python*/site-packages"))
    # A plain path line: the .pth files of that folder, such as an editable lfrig's, are not read from here.
    (site / "libraries.pth").write_text(sysconfig.get_paths()["purelib"] + "\n", encoding="utf-8")
    return Environment(folder)


@pytest.fixture
def checkout(tmp_path: Path, repository: Path) -> Path:
    """The sources as a clone has them: nothing built."""
    copy = tmp_path / "checkout"
    shutil.copytree(repository, copy, ignore=NOT_SOURCE, symlinks=True)
    return copy


@pytest.fixture
def missing_compiler() -> dict[str, str]:
    """Variables under which CMake finds no working compiler."""
    return {"CC": "/bin/false", "CXX": "/bin/false"}


@pytest.fixture
def doctor() -> Callable[[Environment], dict[str, str]]:
    """States by name, as ``lfrig doctor --json`` tells them."""
    import json

    def ask(environment: Environment, **variables: str) -> dict[str, str]:
        done = environment.run("lfrig", "doctor", "--json", **variables)
        assert done.returncode == 0, done.stdout + done.stderr
        return {finding["name"]: finding["state"] for finding in json.loads(done.stdout)["findings"]}

    return ask
