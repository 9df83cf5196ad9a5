"""A folder of sub-aperture images whose names hold a row and a column, such as ``2067_02_05.png``.

The numbers are found by themselves: among names that differ in digits only, the first two numbers that vary and
make a full grid are row and column, so that the camera positions in a gantry's names do no harm; a single varying
number that counts up to a square is row · n + col. Or ``--pattern "name_{row:02d}_{col:02d}.png"`` says it.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from itertools import combinations
from pathlib import Path

from lfrig.contracts.errors import BadInput, UsageError
from lfrig.contracts.paths import check_inside, check_pattern, pattern_regex
from lfrig.rig.ingest.candidate import Candidate, Request, full_grid
from lfrig.rig.ingest.view_files import ViewFiles, light_field_document, size_only
from lfrig.rig.session.images import IMAGE_SUFFIXES

FORMAT = "sai"
Found = tuple[dict[tuple[int, int], Path], str | None]
"""Files by (row, col), and the pattern of their names where a hole may have to be named."""
_NUMBER = re.compile(r"\d+")


def recognise(path: Path, request: Request) -> Candidate | None:
    """A folder with numbered pictures; None for a file, and for a folder without pictures when no pattern is given.

    Raises
    ------
    BadInput
        No grid can be read from the names, or it has holes.
    UsageError
        The pattern is none.
    """
    if not path.is_dir() or request.kind == "photo":
        return None
    if request.pattern is not None:
        files, name = _by_pattern(path, request.pattern)
    else:
        names = sorted(entry.name for entry in path.iterdir() if entry.suffix.lower() in IMAGE_SUFFIXES)
        if not names:
            return None
        files, name = _by_numbers(path, names)
    views, grid = full_grid(files, path, name)
    content = tuple(file for line in grid for file in line)
    document = light_field_document(views=views, camera=size_only(grid[0][0]))
    return ViewFiles(path, FORMAT, document, content, grid)


def _by_pattern(folder: Path, pattern: str) -> Found:
    try:
        check_pattern(check_inside(pattern))
    except ValueError as error:
        raise UsageError(f"--pattern: {error}", remedy='such as "view_{row:02d}_{col:02d}.png"') from None
    regex = pattern_regex(pattern)
    found = {}
    for file in sorted(folder.rglob("*") if "/" in pattern else folder.iterdir()):
        match = regex.fullmatch(file.relative_to(folder).as_posix())
        if match and file.is_file():
            found[int(match["row"]), int(match["col"])] = file
    if not found:
        raise BadInput(
            f"has no file named like {pattern!r}", path=folder, code="missing-views", remedy="correct --pattern"
        )
    return found, pattern


def _by_numbers(folder: Path, names: list[str]) -> Found:
    """Find row and column in the names that are alike but for their digits."""
    groups: dict[str, list[str]] = defaultdict(list)
    for name in names:
        groups[_NUMBER.sub("#", name)].append(name)
    members = max(groups.values(), key=len)
    numbers = [[int(run) for run in _NUMBER.findall(name)] for name in members]
    varying = [i for i, values in enumerate(zip(*numbers, strict=True)) if len(set(values)) > 1]
    pairs = {pair: [(row[pair[0]], row[pair[1]]) for row in numbers] for pair in combinations(varying, 2)}
    for places in pairs.values():
        if _is_full(places):
            return _place(folder, members, places), None
    if len(varying) == 1:
        counted = _count_up([row[varying[0]] for row in numbers])
        if counted is not None:
            return _place(folder, members, counted), None
    for pair, places in pairs.items():
        if len(set(places)) == len(places):  # a grid with holes: the caller says which
            return _place(folder, members, places), _name_like(members[0], pair)
    raise BadInput(
        f"{len(members)} pictures like {members[0]!r} make no grid of rows and columns", path=folder,
        code="no-view-grid", remedy='say how they are named: --pattern "name_{row:02d}_{col:02d}.png"',
    )  # fmt: skip


def _is_full(places: list[tuple[int, int]]) -> bool:
    """Whether the places are all of a rectangle, each once."""
    rows, cols = {place[0] for place in places}, {place[1] for place in places}
    return len(set(places)) == len(places) == len(rows) * len(cols)


def _count_up(counts: list[int]) -> list[tuple[int, int]] | None:
    """Places of numbers that count row by row through a square; None when they do not."""
    side, first = math.isqrt(len(counts)), min(counts)
    if sorted(counts) != list(range(first, first + side * side)):
        return None
    return [divmod(count - first, side) for count in counts]


def _place(folder: Path, names: list[str], places: list[tuple[int, int]]) -> dict[tuple[int, int], Path]:
    return {place: folder / name for place, name in zip(places, names, strict=True)}


def _name_like(name: str, pair: tuple[int, int]) -> str:
    """``name`` as a pattern, its numbers at the two positions replaced by row and col."""
    fields = dict(zip(pair, ("row", "col"), strict=True))
    parts, at = [], 0
    for position, match in enumerate(_NUMBER.finditer(name)):
        if position in fields:
            parts += [name[at : match.start()], f"{{{fields[position]}:0{min(len(match[0]), 9)}d}}"]
            at = match.end()
    return "".join([*parts, name[at:]])
