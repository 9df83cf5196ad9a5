"""Work that a scene does not need: switches, one per kind, and a tally of what they saved.

Every stage that can leave work out takes a `Skips` and writes what it did into a `Tally`. With a switch off the stage
does that work everywhere, with the same kernels; that is the yardstick of ``lfrig bench skip``. A switch never changes
*what* is estimated, only what is left out because it cannot matter (or, for ``planes``, ``views`` and ``certain``,
hardly ever does: the benchmark reports by how much).
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace


@dataclass(frozen=True)
class Skips:
    """One switch per kind of work that can be left out."""

    planes: bool = True
    """Disparity planes that a coarse sweep has ruled out, tile by tile."""
    views: bool = True
    """Views beyond the cross through the centre, where the cross alone is unambiguous."""
    depth_range: bool = True
    """Planes outside the range that anchors and rig allow."""
    bricks: bool = True
    """Bricks of the fused volume that no source gives any mass."""
    sources: bool = True
    """Sources where they do not see a region, or where their weight is negligible."""
    certain: bool = True
    """Regularisation, refinement and synthesis where the surface is already certain or flat."""
    adjustment: bool = True
    """Rounds of the bundle adjustment after it has converged."""
    unchanged: bool = True
    """Stages whose inputs are those of an earlier run (`lfrig.processing.session`)."""
    plate: bool = True
    """Pixels outside the turntable's mask, where a mask is given."""

    @classmethod
    def nothing(cls) -> Skips:
        """All switches off: all the work is done."""
        return cls(**{f.name: False for f in fields(cls)})

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The switches, in the order of the pipeline."""
        return tuple(f.name for f in fields(cls))

    def without(self, name: str) -> Skips:
        """The same with one switch off."""
        return replace(self, **{name: False})


SKIP_ALL = Skips()


@dataclass
class Count:
    """Work of one kind: ``done`` and ``skipped`` in ``unit``; ``cpu_s`` spent on what was done [CPU s]."""

    done: float = 0.0
    skipped: float = 0.0
    unit: str = ""
    cpu_s: float = 0.0

    @property
    def saved_ms(self) -> float:
        """What the skipped work would have cost at the price of the work that was done [CPU ms]."""
        return 1e3 * self.cpu_s * self.skipped / self.done if self.done else 0.0


@dataclass
class Tally:
    """Counts by the name of the switch (a field of `Skips`)."""

    counts: dict[str, Count] = field(default_factory=dict)

    def add(self, name: str, done: float, skipped: float, unit: str, cpu_s: float = 0.0) -> None:
        """Add work of one kind."""
        count = self.counts.setdefault(name, Count())
        count.done += float(done)
        count.skipped += float(skipped)
        count.unit = unit
        count.cpu_s += cpu_s

    @contextlib.contextmanager
    def timed(self, name: str, unit: str) -> Iterator[Count]:
        """Time a block whose work is of one kind; the block fills in ``done`` and ``skipped``."""
        count = Count(unit=unit)
        start = time.process_time()
        yield count
        self.add(name, count.done, count.skipped, unit, time.process_time() - start)
