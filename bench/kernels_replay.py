"""Calls of the kernels as the pipeline makes them, kept on disk to be made again.

The pipeline runs once on a case; of every kernel the call with the most data is kept. Inputs are then as sparse, as
smooth and as many as in real work, and whatever a kernel's arguments are called, nobody has to build them by hand.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import os
import pickle
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Function = Callable[..., Any]
UNRECORDED = ("threads", "monitor")
"""Arguments that are not the kernel's data."""
PACKAGE = "lfrig.processing"


@dataclass(frozen=True)
class Call:
    """Arguments of a kernel's public function, without `UNRECORDED`."""

    args: tuple[Any, ...]
    kwargs: dict[str, Any]

    def arrays(self) -> list[Array]:
        """All arrays in the arguments."""
        return arrays_in((self.args, self.kwargs))

    def save(self, path: Path) -> None:
        """Write it as a pickle."""
        with path.open("wb") as stream:
            pickle.dump(self, stream, protocol=5)

    @staticmethod
    def load(path: Path) -> Call:
        """Read a pickle that `save` wrote: of this program only, a pickle can do anything."""
        with path.open("rb") as stream:
            call = pickle.load(stream)
        assert isinstance(call, Call)
        return call


@dataclass(frozen=True)
class Spot:
    """Where a kernel is: its public function, and which of its calls are meant."""

    name: str
    module: str
    function: str
    meant: Callable[[Call], bool] = lambda call: True
    in_place: tuple[int, ...] = ()
    """Positions of arguments that the kernel changes."""

    @property
    def threaded(self) -> bool:
        """Whether it takes a number of threads."""
        return "threads" in inspect.signature(self.resolve()).parameters

    def resolve(self) -> Function:
        """The function."""
        found: Function = getattr(importlib.import_module(self.module), self.function)
        return found


def arrays_in(value: object) -> list[Array]:
    """Arrays anywhere in tuples, lists, dictionaries and dataclasses, in order."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, dict):
        return [array for item in value.values() for array in arrays_in(item)]
    if isinstance(value, (tuple, list)):
        return [array for item in value for array in arrays_in(item)]
    if is_dataclass(value) and not isinstance(value, type):
        return [array for field in fields(value) for array in arrays_in(getattr(value, field.name))]
    return []


@contextlib.contextmanager
def recording(spots: Sequence[Spot], folder: Path) -> Iterator[None]:
    """While the block runs, keep the largest call of every kernel as ``folder/<name>.pkl``."""
    largest: dict[str, int] = {}
    by_function: dict[Function, list[Spot]] = {}
    for spot in spots:
        by_function.setdefault(spot.resolve(), []).append(spot)

    def listening(function: Function, mine: list[Spot]) -> Function:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            made = Call(args, {name: value for name, value in kwargs.items() if name not in UNRECORDED})
            size = sum(array.nbytes for array in made.arrays())
            for spot in mine:
                if size > largest.get(spot.name, -1) and spot.meant(made):
                    largest[spot.name] = size
                    made.save(folder / f"{spot.name}.pkl")
            return function(*args, **kwargs)

        return call

    with contextlib.ExitStack() as stack:
        for function, mine in by_function.items():
            stack.enter_context(_replaced(function, listening(function, mine)))
        yield


@contextlib.contextmanager
def _replaced(function: Function, stand_in: Function) -> Iterator[None]:
    """Modules import kernels by name: the name is replaced wherever it is bound."""
    _rebind(function, stand_in)
    try:
        yield
    finally:
        _rebind(stand_in, function)  # also where a module was first imported meanwhile


def _rebind(old: Function, new: Function) -> None:
    for module in _modules():
        for name in [name for name, value in vars(module).items() if value is old]:
            setattr(module, name, new)


def _modules() -> list[ModuleType]:
    return [module for name, module in list(sys.modules.items()) if name.startswith(PACKAGE) and module is not None]


@contextlib.contextmanager
def native_switched(on: bool) -> Iterator[None]:
    """The native core or its twins, while the block runs."""
    before = os.environ.get("LFRIG_NATIVE")
    os.environ["LFRIG_NATIVE"] = "1" if on else "0"
    try:
        yield
    finally:
        if before is None:
            del os.environ["LFRIG_NATIVE"]
        else:
            os.environ["LFRIG_NATIVE"] = before


class Replay:
    """A recorded call that is made again, each time on the inputs as they were."""

    def __init__(self, spot: Spot, call: Call) -> None:
        self.spot, self.call = spot, call
        self._function = spot.resolve()
        self._changed = {i: np.array(call.args[i]) for i in spot.in_place if call.args[i] is not None}

    def reset(self) -> None:
        """Put back what the last call changed."""
        for i, original in self._changed.items():
            np.copyto(self.call.args[i], original)

    def run(self, threads: int = 1) -> Any:
        """Call the kernel; returns what it returned."""
        threads_too = {"threads": threads} if self.spot.threaded else {}
        return self._function(*self.call.args, **self.call.kwargs, **threads_too)

    def outputs(self, returned: object) -> list[Array]:
        """Arrays that the last call returned or changed."""
        changed = [self.call.args[i] for i in self._changed]
        return [*changed, *(array for array in arrays_in(returned) if not any(array is c for c in changed))]


def largest_difference(
    ours: Sequence[Array], other: Sequence[Array], *, ties: float = 0.0, relative: bool = False
) -> float:
    """Largest absolute difference of corresponding arrays; infinite where one is not finite and the other is.

    Of each array the ``ties`` share of values that differ most is left out; with ``relative``, differences are shares
    of the largest value of ``other``'s array.
    """
    worst = 0.0
    for a, b in zip(ours, other, strict=True):
        x, y = a.astype(np.float64), b.astype(np.float64)
        finite = np.isfinite(x) & np.isfinite(y)
        if not np.array_equal(np.where(finite, 0, x), np.where(finite, 0, y), equal_nan=True):
            return float("inf")
        apart = np.abs(x[finite] - y[finite])
        left_out = int(ties * apart.size)
        if apart.size:
            found = float(np.partition(apart, apart.size - 1 - left_out)[apart.size - 1 - left_out])
            scale = float(np.abs(y[finite]).max()) if relative else 1.0
            worst = max(worst, found / (scale or 1.0))
    return worst
