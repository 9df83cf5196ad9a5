"""The claims of the packaging, tried: wheel, editable, no compiler, native core switched off."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

WHERE = "import lfrig.rig as m; print(m.__path__[0])"
NATIVE = "from lfrig.contracts.native import load_native; print(load_native('lfrig.processing.kernels._native'))"
ROOMS = {"rig", "sim", "bench", "drivers", "processing", "contracts"}
Doctor = Callable[..., dict[str, str]]


def test_pip_install(environment, checkout: Path, doctor: Doctor) -> None:
    environment.install(checkout)
    assert environment.python(WHERE).startswith(str(environment.folder))
    states = doctor(environment)
    assert states["native core"] == states["native renderer"] == "ok"
    installed = next((environment.folder / "lib").glob("python*/site-packages"))
    assert {path.name for path in installed.iterdir()} & ROOMS == set()
    assert list((installed / "lfrig").rglob("*.cpp")) == []
    assert re.fullmatch(r"lfrig \d+\.\d+\.\d+", environment.run("lfrig", "--version").stdout.strip())
    # Switched off at run time:
    assert doctor(environment, LFRIG_NATIVE="0")["native core"] == "missing"
    assert environment.python(NATIVE, LFRIG_NATIVE="0") == "None"


def test_install_without_a_compiler(
    environment, checkout: Path, doctor: Doctor, missing_compiler: dict[str, str], tmp_path: Path
) -> None:
    environment.install(checkout, **missing_compiler)
    assert doctor(environment)["native core"] == "missing"
    done = environment.run("lfrig", "demo", "--size", "tiny", "--out", tmp_path / "demo")
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "demo").rglob("report.html"))


def test_editable_install(environment, checkout: Path, doctor: Doctor, missing_compiler: dict[str, str]) -> None:
    """First without a compiler, then with one; new files and folders are there at once."""
    environment.install("-e", checkout, **missing_compiler)
    assert doctor(environment)["native core"] == "missing"
    environment.install("-e", checkout)
    assert doctor(environment)["native core"] == "ok"
    (checkout / "rig" / "brand_new.py").write_text("VALUE = 7\n", encoding="utf-8")
    (checkout / "rig" / "brand_new_room").mkdir()
    (checkout / "rig" / "brand_new_room" / "__init__.py").write_text("VALUE = 8\n", encoding="utf-8")
    code = "import lfrig.rig.brand_new as a, lfrig.rig.brand_new_room as b; print(a.VALUE, b.VALUE)"
    assert environment.python(code) == "7 8"
