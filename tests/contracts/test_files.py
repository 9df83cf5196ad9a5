"""Atomic files and folders under injected failures: what exists is whole, and what was there stays."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lfrig.contracts import files
from lfrig.contracts.errors import BadInput, DiskError, ExitCode
from lfrig.contracts.files import (
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    disk_errors,
    refuse_existing,
    refuse_replacing,
    sha256_file,
    sha256_files,
)

Patch = pytest.MonkeyPatch


def failing(code: int, after: int = 0) -> Callable[..., Any]:
    """A stand-in that raises an `OSError` on its call number ``after``."""
    calls = iter(range(10**6))

    def call(*args: Any, **kwargs: Any) -> None:
        if next(calls) >= after:
            raise OSError(code, os.strerror(code))

    return call


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize(
    ("code", "slug"),
    [(errno.ENOSPC, "disk-full"), (errno.EDQUOT, "disk-full"), (errno.EROFS, "read-only"), (errno.EIO, "disk")],
)
@pytest.mark.parametrize("where", ["fsync", "open"])
def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: Patch, code: int, slug: str, where: str
) -> None:
    path = tmp_path / "f.json"
    atomic_write_text(path, "old")
    if where == "fsync":
        monkeypatch.setattr(files.os, "fsync", failing(code))
    else:
        monkeypatch.setattr(Path, "open", failing(code))
    with pytest.raises(DiskError) as caught:
        atomic_write_text(path, "new")
    monkeypatch.undo()
    assert caught.value.code == slug
    assert caught.value.exit_code == ExitCode.DISK
    assert str(path) in caught.value.message
    assert caught.value.remedy
    assert path.read_text() == "old"
    assert names(tmp_path) == ["f.json"]


def test_a_write_cut_off_half_way_leaves_the_old_file(tmp_path: Path, monkeypatch: Patch) -> None:
    path = tmp_path / "f"
    atomic_write_bytes(path, b"old")

    def interrupt(_descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        atomic_write_bytes(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["f"]


def test_writing_makes_the_folders_on_the_way(tmp_path: Path) -> None:
    atomic_write_bytes(tmp_path / "a" / "b" / "c", b"x")
    assert (tmp_path / "a" / "b" / "c").read_bytes() == b"x"


def test_a_file_in_the_way_is_a_disk_error(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file")
    with pytest.raises(DiskError):
        atomic_write_bytes(tmp_path / "a" / "b", b"x")


def test_threads_do_not_share_temporary_names(tmp_path: Path) -> None:
    def write(n: int) -> None:
        for _ in range(20):
            atomic_write_bytes(tmp_path / "f", bytes([n]) * 5000)

    threads = [threading.Thread(target=write, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    data = (tmp_path / "f").read_bytes()
    assert len(data) == 5000
    assert len(set(data)) == 1
    assert names(tmp_path) == ["f"]


def test_a_file_system_without_folder_fsync_is_fine(tmp_path: Path, monkeypatch: Patch) -> None:
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):  # noqa: PTH112 - a descriptor, not a path
            raise OSError(errno.EINVAL, "no")
        real(descriptor)

    monkeypatch.setattr(files.os, "fsync", fsync)
    atomic_write_bytes(tmp_path / "f", b"x")
    with atomic_folder(tmp_path / "d") as folder:
        (folder / "x").write_text("x")
    assert names(tmp_path) == ["d", "f"]


def fill(folder: Path, text: str) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "file").write_text(text)


def read(path: Path) -> str:
    return (path / "sub" / "file").read_text()


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    path = tmp_path / "result"
    with atomic_folder(path) as folder:
        fill(folder, "new")
        assert not path.exists()
    assert read(path) == "new"
    assert names(tmp_path) == ["result"]


def test_an_existing_folder_is_refused_before_any_work(tmp_path: Path) -> None:
    path = tmp_path / "result"
    path.mkdir()
    with pytest.raises(BadInput) as caught, atomic_folder(path):
        pytest.fail("the block must not run")
    assert caught.value.code == "exists"
    assert "--overwrite" in caught.value.remedy


def test_a_folder_that_appears_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "result"
    with pytest.raises(BadInput), atomic_folder(path) as folder:
        fill(folder, "late")
        path.mkdir()
        (path / "theirs").write_text("x")
    assert names(path) == ["theirs"]
    assert names(tmp_path) == ["result"]


@pytest.mark.parametrize("kind", ["folder", "link", "dangling link"])
def test_overwriting_replaces_whatever_is_there(tmp_path: Path, kind: str) -> None:
    path, other = tmp_path / "result", tmp_path / "other"
    if kind == "folder":
        path.mkdir()
        fill(path, "old")
    else:
        if kind == "link":
            other.mkdir()
            fill(other, "linked")
        path.symlink_to(other)
    with atomic_folder(path, overwrite=True) as folder:
        fill(folder, "new")
    assert read(path) == "new"
    assert not path.is_symlink()
    assert names(tmp_path) == (["other", "result"] if kind == "link" else ["result"])
    if kind == "link":
        assert read(other) == "linked"


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError(errno.ENOSPC, "full"), SystemExit])
@pytest.mark.parametrize("existing", [True, False])
def test_a_block_that_fails_changes_nothing(tmp_path: Path, error: Any, existing: bool) -> None:
    path = tmp_path / "result"
    if existing:
        path.mkdir()
        fill(path, "old")
    expected = DiskError if isinstance(error, OSError) else error
    with pytest.raises(expected), atomic_folder(path, overwrite=True) as folder:
        fill(folder, "half")
        raise error
    assert names(tmp_path) == (["result"] if existing else [])
    if existing:
        assert read(path) == "old"


@pytest.mark.parametrize("existing", [True, False])
@pytest.mark.parametrize("step", range(6))
def test_whatever_call_fails_in_the_end_the_old_folder_stays(
    tmp_path: Path, monkeypatch: Patch, existing: bool, step: int
) -> None:
    """Each fsync in turn fails; there are four (folder, sub-folder, file, parent), later steps succeed."""
    path = tmp_path / "result"
    if existing:
        path.mkdir()
        fill(path, "old")
    monkeypatch.setattr(files.os, "fsync", failing(errno.EIO, after=step))
    try:
        with atomic_folder(path, overwrite=True) as folder:
            fill(folder, "new")
        outcome = "new"
    except DiskError:
        outcome = "old"
    monkeypatch.undo()
    assert outcome == ("new" if step >= 4 else "old")
    assert names(tmp_path) == (["result"] if existing or outcome == "new" else [])
    if names(tmp_path):
        assert read(path) == outcome


@pytest.mark.parametrize("failing_rename", [0, 1])
def test_a_failed_rename_leaves_the_old_folder(tmp_path: Path, monkeypatch: Patch, failing_rename: int) -> None:
    path = tmp_path / "result"
    path.mkdir()
    fill(path, "old")
    real, calls = Path.rename, iter(range(10))

    def rename(self: Path, target: Path) -> Path:
        if next(calls) == failing_rename:
            raise OSError(errno.EACCES, "no")
        return real(self, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(DiskError), atomic_folder(path, overwrite=True) as folder:
        fill(folder, "new")
    assert read(path) == "old"
    assert names(tmp_path) == ["result"]


def test_a_process_killed_between_the_renames_loses_nothing(tmp_path: Path) -> None:
    """What SIGKILL leaves is made by hand: the old folder under its hidden name, of a process that is no more."""
    path = tmp_path / "result"
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    hidden = tmp_path / f".result.{child}-0.old"
    hidden.mkdir()
    fill(hidden, "old")
    with pytest.raises(BadInput), atomic_folder(path):
        pytest.fail("the block must not run")
    assert read(path) == "old"
    assert names(tmp_path) == ["result"]


def test_a_swap_in_progress_elsewhere_is_left_alone(tmp_path: Path) -> None:
    hidden = tmp_path / f".result.{os.getpid()}-0.old"
    hidden.mkdir()
    with atomic_folder(tmp_path / "result") as folder:
        fill(folder, "new")
    assert hidden.is_dir()


def test_a_read_only_parent_is_a_disk_error(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setattr(Path, "mkdir", failing(errno.EROFS))
    with pytest.raises(DiskError) as caught, atomic_folder(tmp_path / "result"):
        pytest.fail("the block must not run")
    assert caught.value.code == "read-only"


def test_a_failure_takes_the_parents_along_that_were_made_for_it(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "there" / "results" / "run" / "one") as folder:
        fill(folder, "half")
        (tmp_path / "there" / "results" / "other").mkdir()
        raise KeyboardInterrupt
    assert names(tmp_path / "there") == ["results"]
    assert names(tmp_path / "there" / "results") == ["other"]


def test_the_error_names_the_file_it_is_about(tmp_path: Path) -> None:
    missing = tmp_path / "source.png"
    with pytest.raises(DiskError) as caught, atomic_folder(tmp_path / "result") as folder:
        shutil.copyfile(missing, folder / "copy.png")
    assert str(missing) in caught.value.message
    with pytest.raises(DiskError) as caught, atomic_folder(tmp_path / "result") as folder:
        (folder / "none" / "file").write_text("x")
    assert caught.value.message.startswith(f"{tmp_path / 'result'}: ")


def test_other_errors_pass_through(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="mine"), disk_errors(tmp_path):
        raise ValueError("mine")


def test_a_dangling_link_counts_as_existing(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(BadInput):
        refuse_existing(tmp_path / "link", overwrite=False)


def test_hashes(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "b").write_bytes(b"")
    assert sha256_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256_files([tmp_path / "a", tmp_path / "b"]) != sha256_files([tmp_path / "b", tmp_path / "a"])
    with pytest.raises(BadInput, match="none"):
        sha256_file(tmp_path / "none")


@pytest.mark.parametrize("place", ["", "captures", "captures/000", "calibration", "captures/000/views"])
def test_a_session_s_originals_are_never_replaced(tmp_path: Path, place: str) -> None:
    session = tmp_path / "session"
    (session / "captures" / "000" / "views").mkdir(parents=True)
    (session / "calibration").mkdir()
    (session / "session.json").write_text("{}")
    with pytest.raises(BadInput, match="never replaces"), atomic_folder(session / place, overwrite=True):
        pytest.fail("the block must not run")
    assert (session / "captures" / "000" / "views").is_dir()


def test_results_and_caches_of_a_session_are_replaced(tmp_path: Path) -> None:
    (tmp_path / "session.json").write_text("{}")
    for place in ("results/run", "cache/decode/0"):
        (tmp_path / place).mkdir(parents=True)
        with atomic_folder(tmp_path / place, overwrite=True) as folder:
            fill(folder, "new")
        assert read(tmp_path / place) == "new"


def test_a_folder_never_replaces_a_file(tmp_path: Path) -> None:
    (tmp_path / "shot.lfr").write_text("raw")
    with pytest.raises(BadInput, match="is a file"), atomic_folder(tmp_path / "shot.lfr", overwrite=True):
        pytest.fail("the block must not run")
    assert (tmp_path / "shot.lfr").read_text() == "raw"


def test_a_path_without_a_name_is_refused(monkeypatch: Patch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="no name"), atomic_folder(Path(), overwrite=True):
        pytest.fail("the block must not run")


def test_what_is_read_is_not_replaced(tmp_path: Path) -> None:
    source = tmp_path / "shots" / "a.lfr"
    for out in (source, tmp_path / "shots", tmp_path):
        with pytest.raises(BadInput, match="would replace"):
            refuse_replacing(out, source)
    refuse_replacing(tmp_path / "shots" / "b", source)
