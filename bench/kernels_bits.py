"""The same bits on another machine: recorded calls and their outputs' hashes, written here and checked there.

    python -m lfrig.bench.kernels_bits write FOLDER      on one machine
    python -m lfrig.bench.kernels_bits check FOLDER      on another, or under an emulator

``check`` makes every call again on 1, 2 and 3 threads. Kernels that use functions whose rounding the C library chooses
are compared and told, but do not fail the check; neither needs the simulator or OpenCV.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path

from lfrig.bench.kernels_registry import KERNELS, Kernel
from lfrig.bench.kernels_replay import Array, Call, Replay
from lfrig.processing.kernels.stream import vector_level

DIGESTS = "digests.json"
THREADS = (1, 2, 3)


def digest(arrays: list[Array]) -> str:
    """Hash of the arrays' bytes, types and shapes."""
    total = hashlib.sha256()
    for array in arrays:
        total.update(f"{array.dtype.str}{array.shape}".encode())
        total.update(array.tobytes())
    return total.hexdigest()


def outputs_digest(kernel: Kernel, call: Call, threads: int) -> str:
    """Hash of what the kernel promises of a call."""
    replay = Replay(kernel.spot, call)
    found = digest(kernel.compared(call, replay.outputs(replay.run(threads))))
    replay.reset()
    return found


def write_folder(folder: Path, size: tuple[int, int]) -> dict[str, str]:
    """Record calls in ``folder`` and write the hashes beside them."""
    from lfrig.bench.kernels_data import record_calls

    folder.mkdir(parents=True, exist_ok=True)
    record_calls(KERNELS, size, folder)
    found = {
        kernel.name: outputs_digest(kernel, Call.load(folder / f"{kernel.name}.pkl"), 1)
        for kernel in KERNELS
        if (folder / f"{kernel.name}.pkl").is_file()
    }
    (folder / DIGESTS).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


def check_folder(folder: Path) -> dict[str, bool]:
    """Whether each kernel gives the recorded bits here, on any number of threads."""
    known = json.loads((folder / DIGESTS).read_text(encoding="utf-8"))
    same = {}
    for kernel in KERNELS:
        if kernel.name in known:
            call = Call.load(folder / f"{kernel.name}.pkl")
            counts = THREADS if kernel.spot.threaded else THREADS[:1]
            same[kernel.name] = {outputs_digest(kernel, call, count) for count in counts} == {known[kernel.name]}
    return same


def main() -> None:
    """Read the command line, write or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("write", "check"))
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    if given.action == "write":
        from lfrig.bench.cases import SMALL

        print(f"{len(write_folder(given.folder, SMALL))} calls recorded, vector level {vector_level()}")
        return
    found = check_folder(given.folder)
    exact = {kernel.name for kernel in KERNELS if kernel.exact}
    for name, same in found.items():
        verdict = (
            "the same bits" if same else "DIFFERS" if name in exact else "differs, as the C library's functions do"
        )
        print(f"{name:15s} {verdict}")
    differing = sorted(name for name, same in found.items() if not same and name in exact)
    print(f"vector level {vector_level()}: {sum(found.values())} of {len(found)} kernels give the same bits")
    if not found or differing:
        sys.exit(f"kernels that must give the same bits and do not: {', '.join(differing) or 'none was compared'}")


if __name__ == "__main__":
    main()
