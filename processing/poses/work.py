"""What the pose stage has found out, kept from one solve to the next: a new target or source then costs only itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np

from lfrig.processing.model import F64, LightField
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.tracks import Pair
from lfrig.processing.poses.warp_lk import Sighted

T = TypeVar("T")

ROUNDS_KEPT = 2
"""What this many solves have not asked for is forgotten."""


@dataclass
class _Kept:
    made_from: tuple[object, ...]
    value: object
    round: int


class PoseWork:
    """A memory for `solve_poses` and the checks around it. Nothing is recognised but the very objects that something
    was made from (arrays and captures are never changed in place), so it cannot mix up captures; what is no longer
    asked for is forgotten after two solves. Not safe for several threads at once.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[Any, ...], _Kept] = {}
        self._round = 0

    def begin(self) -> None:
        """A solve begins."""
        self._round += 1
        self._kept = {k: v for k, v in self._kept.items() if self._round - v.round <= ROUNDS_KEPT}

    def once(self, what: str, made_from: Sequence[object], make: Callable[[], T]) -> T:
        """What ``make`` gives, made only when it is not known for these very objects."""
        found = self.recall(what, made_from)
        if found is None:
            found = make()
            self.keep(what, made_from, found)
        return cast(T, found)

    def recall(self, what: str, made_from: Sequence[object]) -> object | None:
        """What was kept for these very objects, else None."""
        kept = self._kept.get(_key(what, made_from))
        if kept is None:
            return None
        kept.round = self._round
        return kept.value

    def keep(self, what: str, made_from: Sequence[object], value: object) -> None:
        """Remember a value for these objects."""
        self._kept[_key(what, made_from)] = _Kept(tuple(made_from), value, self._round)

    def followed(self, sources: Sequence[LightField]) -> dict[Pair, Sighted]:
        """Where the corners of one source were found in another, by their indices here."""
        found = {}
        for j, a in enumerate(sources):
            for i, b in enumerate(sources):
                known = self.recall("followed", (a.views, b.views)) if i != j else None
                if isinstance(known, Sighted):
                    found[j, i] = known
        return found

    def keep_solution(
        self, sources: Sequence[LightField], structure: Structure, by_pair: Mapping[Pair, Sighted]
    ) -> None:
        """Remember the sources' parameters in a solution, and where their corners were found in each other."""
        count = len(sources)
        for (j, i), sighted in by_pair.items():
            if max(i, j) < count:
                self.keep("followed", (sources[j].views, sources[i].views), sighted)
        arrangement, x = structure.arrangement, structure.parameters
        for v, source in enumerate(sources):
            mount = arrangement.views[v].mount
            kept = (x[6 * mount : 6 * mount + 6].copy(), x[arrangement.of_view(v)].copy())
            self.keep("solved", (source,), kept)

    def start(self, arrangement: Arrangement, sources: Sequence[LightField]) -> tuple[F64, list[int]]:
        """Parameters to start from: those of an earlier solution for the sources that took part in it, the priors for
        the others; and which those sources are.
        """
        x, placed = np.zeros(arrangement.size), []
        for v, source in enumerate(sources):
            kept = cast("tuple[F64, F64] | None", self.recall("solved", (source,)))
            if kept is not None:
                mount = arrangement.views[v].mount
                x[6 * mount : 6 * mount + 6], x[arrangement.of_view(v)] = kept
                placed.append(v)
        return x, placed


def _key(what: str, made_from: Sequence[object]) -> tuple[Any, ...]:
    return (what, *(id(part) for part in made_from))
