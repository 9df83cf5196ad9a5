"""With LFRIG_NO_SKIP=1, which CI sets where the real data is, a skipped test is a failed one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SKIPPING = "import pytest\ndef test_nothing():\n    pytest.skip('not today')\n"
SKIPPING_MODULE = "import pytest\npytest.skip('not here', allow_module_level=True)\n"
EXPECTED_FAILURE = "import pytest\n@pytest.mark.xfail(strict=True)\ndef test_known():\n    assert False\n"


def run_pytest(folder: Path, test: str, no_skip: str | None) -> subprocess.CompletedProcess[str]:
    shutil.copy(Path(__file__).with_name("conftest.py"), folder)
    (folder / "test_sample.py").write_text(test, encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name != "LFRIG_NO_SKIP"}
    if no_skip is not None:
        environment["LFRIG_NO_SKIP"] = no_skip
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(folder), str(folder)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, check=False)


@pytest.mark.parametrize("test", [SKIPPING, SKIPPING_MODULE])
def test_a_skip_fails_when_skips_are_forbidden(tmp_path: Path, test: str) -> None:
    done = run_pytest(tmp_path, test, "1")
    assert done.returncode != 0
    assert "LFRIG_NO_SKIP=1 forbids skips" in done.stdout


def test_a_skip_is_a_skip_otherwise(tmp_path: Path) -> None:
    assert run_pytest(tmp_path, SKIPPING, None).returncode == 0


def test_an_expected_failure_is_no_skip(tmp_path: Path) -> None:
    assert run_pytest(tmp_path, EXPECTED_FAILURE, "1").returncode == 0
