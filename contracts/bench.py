"""The one format of every benchmark: rows of numbers, and checks against bounds with their reasons."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from lfrig.contracts.schema import Document, Finite, Model


class Check(Model):
    """One bound: ``value`` must be ``direction`` ``bound``."""

    name: str
    value: Finite
    bound: Finite
    direction: Literal["<=", ">="]
    ok: bool
    why: str

    @classmethod
    def of(cls, name: str, value: float, direction: Literal["<=", ">="], bound: float, why: str) -> Check:
        """Build a check and decide it."""
        ok = value <= bound if direction == "<=" else value >= bound
        return cls(name=name, value=value, bound=bound, direction=direction, ok=ok, why=why)


class BenchDocument(Document):
    """OUT/<name>.json."""

    NAME: ClassVar[str] = "lfrig.bench"

    name: str
    machine: dict[str, Any] = Field(default_factory=dict)
    commit: str | None = None
    rows: list[dict[str, Any]] = Field(default_factory=list)
    checks: list[Check] = Field(default_factory=list)
