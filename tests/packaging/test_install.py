"""The claims of the packaging, tried: wheel, editable, no compiler, native core switched off."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ORIGIN = "import lfrig.rig as m; print(m.__path__[0])"
Doctor = Callable[..., dict[str, str]]


def test_pip_install(environment, checkout: Path, doctor: Doctor) -> None:
    environment.install(checkout)
    assert environment.python(ORIGIN).startswith(str(environment.folder))
    assert doctor(environment)["native core"] == "ok"
    assert doctor(environment)["native renderer"] == "ok"
    installed = next((environment.folder / "lib").glob("python*/site-packages"))
    names = {path.name for path in installed.iterdir() if not path.name.startswith(("pip", "setuptools", "_dist"))}
    assert {name for name in names if re.fullmatch(r"(rig|sim|bench|drivers|processing|contracts)", name)} == set()
    assert list((installed / "lfrig").rglob("*.cpp")) == []
    assert re.fullmatch(r"lfrig \d+\.\d+\.\d+", environment.run("lfrig", "--version").stdout.strip())


def test_editable_install_sees_new_files(environment, checkout: Path, doctor: Doctor) -> None:
    environment.install("-e", checkout)
    assert doctor(environment)["native core"] == "ok"
    (checkout / "rig" / "brand_new.py").write_text("VALUE = 7\n", encoding="utf-8")
    (checkout / "rig" / "brand_new_room").mkdir()
    (checkout / "rig" / "brand_new_room" / "__init__.py").write_text("VALUE = 8\n", encoding="utf-8")
    code = "import lfrig.rig.brand_new as a, lfrig.rig.brand_new_room as b; print(a.VALUE, b.VALUE)"
    assert environment.python(code) == "7 8"


@pytest.mark.parametrize("editable", [[], ["-e"]], ids=["wheel", "editable"])
def test_install_without_a_compiler(
    environment, checkout: Path, doctor: Doctor, missing_compiler: dict[str, str], editable: list[str], tmp_path: Path
) -> None:
    environment.install(*editable, checkout, **missing_compiler)
    assert doctor(environment)["native core"] == "missing"
    done = environment.run("lfrig", "demo", "--size", "tiny", "--out", tmp_path / "demo")
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "demo").rglob("report.html"))


def test_a_compiler_that_comes_later_is_used(
    environment, checkout: Path, doctor: Doctor, missing_compiler: dict[str, str]
) -> None:
    environment.install(checkout, **missing_compiler)
    environment.install("--force-reinstall", checkout)
    assert doctor(environment)["native core"] == "ok"


def test_the_native_core_can_be_switched_off(environment, checkout: Path, doctor: Doctor) -> None:
    environment.install(checkout)
    assert doctor(environment, LFRIG_NATIVE="0")["native core"] == "missing"
    code = "from lfrig.contracts.native import load_native; print(load_native('lfrig.processing.kernels._native'))"
    assert environment.python(code, LFRIG_NATIVE="0") == "None"
