"""Which lfrig this is."""

from __future__ import annotations

import importlib.metadata


def version() -> str:
    """The installed version; ``"unknown"`` where lfrig runs from a checkout that was never installed."""
    try:
        return importlib.metadata.version("lfrig")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
