"""Which lfrig this is."""

from __future__ import annotations


def version() -> str:
    """The installed version; ``"unknown"`` where lfrig runs from a checkout that was never installed."""
    import importlib.metadata  # a tenth of what `lfrig --help` may cost

    try:
        return importlib.metadata.version("lfrig")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
