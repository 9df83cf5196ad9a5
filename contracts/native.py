"""Where the native core is switched on and off.

``LFRIG_NATIVE=0`` switches it off at run time; an install without a compiler has none. Either way the NumPy
twins run. The environment is read at each call, so tests can switch within a process.
"""

from __future__ import annotations

import functools
import importlib
import os
from types import ModuleType


def native_wanted() -> bool:
    """False when ``LFRIG_NATIVE`` is set to ``0``, ``off``, ``no`` or ``false``."""
    return os.environ.get("LFRIG_NATIVE", "1").lower() not in {"0", "off", "no", "false"}


@functools.cache
def _import(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def load_native(name: str) -> ModuleType | None:
    """The extension module ``name``, or None when it is not built or switched off."""
    return _import(name) if native_wanted() else None
