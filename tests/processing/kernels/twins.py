"""A kernel and its NumPy twin, side by side."""

from __future__ import annotations

import pytest


def both(monkeypatch: pytest.MonkeyPatch, call):  # type: ignore[no-untyped-def]
    """(native result, twin result) of ``call()``."""
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    native = call()
    monkeypatch.setenv("LFRIG_NATIVE", "0")
    return native, call()
