"""The user's files in a folder that is written again: concurrent programs, kills, refused writes."""

import errno
import hashlib
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from lirs_wct import files, foreign_files
from lirs_wct.errors import OutputError
from lirs_wct.files import atomic_folder
from lirs_wct.foreign_files import MANIFEST, read_manifest

FORK = multiprocessing.get_context("fork")
STEPS = {"os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.mkdir"}
"""Audit events of the system calls that change a folder, without `renameat2`."""


def write_world(path: Path, version: str) -> None:
    with atomic_folder(path) as temporary:
        (temporary / "meshes").mkdir()
        for name in ("model", "world.json", "meshes/wall.stl"):
            (temporary / name).write_text(version)


def listing(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def version_of(path: Path) -> str:
    """Return the version of a complete world; fail if files are missing or of another version."""
    manifest = read_manifest(path)
    assert manifest is not None
    assert set(manifest) == {"model", "world.json", "meshes/wall.stl"}
    version = (path / "model").read_text()
    assert set(manifest.values()) == {hashlib.sha256(version.encode()).hexdigest()}
    assert {(path / name).read_text() for name in manifest} == {version}
    return version


@pytest.fixture(params=["exchange", "renames"])
def exchange(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Test with `renameat2`, and as on a file system without it."""
    if request.param == "renames":
        monkeypatch.setattr(foreign_files, "_renameat2", lambda *_: False)
    return str(request.param)


def save_directly(path: Path, text: str) -> None:
    path.write_text(text)


def save_by_rename(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_text(text)
    temporary.replace(path)


def keep_rebuilding(path: Path, ended: threading.Event, rebuilt: Any) -> None:
    while not ended.is_set():
        write_world(path, str(rebuilt.value + 1))
        rebuilt.value += 1


def save_while_rebuilding(path: Path, save: Callable[[Path, str], None], names: list[str]) -> int:
    """Save files while the world is rebuilt; return the number of rebuilds."""
    write_world(path, "0")
    (path / "mine").mkdir()
    ended, rebuilt = FORK.Event(), FORK.Value("i")
    builder = FORK.Process(target=keep_rebuilding, args=(path, ended, rebuilt))
    builder.start()
    deadline = time.monotonic() + 30.0
    while rebuilt.value < 2 and time.monotonic() < deadline:
        for name in names:
            save(path / name, name)
            time.sleep(0.001)
    ended.set()
    builder.join()
    assert builder.exitcode == 0
    return int(version_of(path))


@pytest.mark.parametrize("save", [save_directly, save_by_rename])
@pytest.mark.parametrize("parent", ["", "mine/"])
def test_no_file_saved_during_rebuilds_is_lost(
    tmp_path: Path, save: Callable[[Path, str], None], parent: str
) -> None:
    path = tmp_path / "w"
    names = [f"{parent}{number}.txt" for number in range(150)]
    if (save, parent) != (save_directly, ""):
        save = retried(save)
    assert save_while_rebuilding(path, save, names) > 1
    assert [name for name in names if (path / name).read_text() != name] == []
    assert [entry.name for entry in tmp_path.iterdir()] == ["w"]


def retried(save: Callable[[Path, str], None]) -> Callable[[Path, str], None]:
    """Repeat a save that reports an error: nothing is lost then.

    A temporary file may be moved between two calls, and the link that stands for a folder during the
    exchange may be read just before the folder takes its place (ELOOP).
    """

    def save_until_done(path: Path, text: str) -> None:
        while True:
            try:
                return save(path, text)
            except OSError as error:
                if error.errno not in (errno.ENOENT, errno.ELOOP):
                    raise

    return save_until_done


def test_a_program_inside_a_subfolder_keeps_writing_there(tmp_path: Path) -> None:
    path = tmp_path / "w"
    write_world(path, "1")
    (path / "mine").mkdir()
    handle = os.open(path / "mine", os.O_RDONLY)
    with (path / "mine" / "log").open("w") as log:
        write_world(path, "2")
        log.write("late")
        os.close(os.open("later", os.O_CREAT | os.O_WRONLY, dir_fd=handle))
    os.close(handle)
    assert not (path / "mine").is_symlink()
    assert (path / "mine" / "log").read_text() == "late"
    assert (path / "mine" / "later").exists()


def test_files_of_the_moments_around_the_exchange_are_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchange: str
) -> None:
    path = tmp_path / "w"
    write_world(path, "1")
    (path / "notes").write_text("before")

    def save_late(old: Path, *arguments: object, **named: object) -> None:
        (old / "late").mkdir()
        (old / "late" / "deep").write_text("mine")
        (old / "meshes" / "late").write_text("mine")
        save_by_rename(old / "notes", "after")
        move(old, *arguments, **named)

    move: Callable[..., None] = foreign_files.move_foreign
    monkeypatch.setattr(files, "move_foreign", save_late)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_world(path, "2")
    assert version_of(path) == "2"
    assert (path / "late" / "deep").read_text() == (path / "meshes" / "late").read_text() == "mine"
    versions = {"notes": "after", "notes~": "before"}
    if exchange == "renames":
        versions = {"notes": "before", "notes~": "after"}
    assert {name: (path / name).read_text() for name in versions} == versions


def write_often(path: Path, version: str) -> None:
    warnings.simplefilter("error")
    for number in range(5):
        write_world(path, f"{version}{number}")


def test_processes_that_write_one_folder_keep_the_user_s_file(tmp_path: Path) -> None:
    path = tmp_path / "w"
    for _ in range(2):
        write_world(path, "0")
        (path / "notes.txt").write_text("mine")
        writers = [FORK.Process(target=write_often, args=(path, f"{i}")) for i in range(4)]
        for writer in writers:
            writer.start()
        for writer in writers:
            writer.join()
        assert [writer.exitcode for writer in writers] == [0] * 4
        assert version_of(path)[1] == "4"
        ours = [MANIFEST, "meshes", "meshes/wall.stl", "model", "notes.txt", "world.json"]
        assert listing(tmp_path) == ["w", *(f"w/{name}" for name in ours)]


def end_at(step: int, end: Callable[[], None]) -> None:
    """End this process, or raise, before or after a numbered step that changes a folder."""
    count = 0

    def counted(event: str, _: object = None) -> None:
        nonlocal count
        if event in STEPS:
            count += 1
            if count == step:
                end()

    def renameat2(*arguments: object) -> bool:
        counted("os.rename")
        done: bool = original(*arguments)
        counted("os.rename")
        return done

    original: Callable[..., bool] = foreign_files._renameat2
    foreign_files._renameat2 = renameat2
    sys.addaudithook(counted)


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def interrupt() -> None:
    raise KeyboardInterrupt


def write_and_end(path: Path, step: int, end: Callable[[], None]) -> None:
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115, PTH123
    end_at(step, end)
    write_world(path, "2")


def ended_worlds(path: Path, end: Callable[[], None], every: int) -> Iterator[Path]:
    """Yield a world with the user's files after its rebuild ended at each step; stop after the last step."""
    for step in range(1, 200, every):
        place = path / str(step) / "w"
        write_world(place, "1")
        (place / "mine").mkdir()
        for name in ("notes", "mine/data", "meshes/mine.stl"):
            (place / name).write_text("mine")
        (place / "model").write_text("edited")
        writer = FORK.Process(target=write_and_end, args=(place, step, end))
        writer.start()
        writer.join()
        if writer.exitcode == 0:
            return
        yield place
    raise AssertionError("the write did not end")


@pytest.mark.parametrize(
    ("end", "every"),
    [(kill, 4), *(pytest.param(end, 1, marks=pytest.mark.slow) for end in (kill, interrupt))],
)
def test_a_write_that_ends_at_any_step_leaves_a_complete_world(
    tmp_path: Path, exchange: str, end: Callable[[], None], every: int
) -> None:
    mine = ("notes", "mine/data", "meshes/mine.stl")
    steps, versions, missing = 0, set(), 0
    for path in ended_worlds(tmp_path, end, every):
        steps += 1
        if path.exists():
            version = (path / "world.json").read_text()
            versions.add(version)
            assert (path / "meshes" / "wall.stl").read_text() == version
            assert (path / "model").read_text() == ("2" if version == "2" else "edited")
            if exchange == "exchange":
                assert [name for name in mine if (path / name).read_text() != "mine"] == []
        else:
            missing += 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            write_world(path, "3")
        assert version_of(path) == "3"
        assert {(path / name).read_text() for name in mine} == {"mine"}
        assert not any(entry.is_symlink() for entry in path.rglob("*"))
        assert (path / "model~").read_text() == "edited"
        assert [entry.name for entry in path.parent.iterdir()] == ["w"]
        assert not list(path.rglob("*~2"))
    assert steps > 15 / every
    assert versions == {"1", "2"}
    assert missing == 0 or (exchange == "renames" and missing < 4)


def test_a_user_s_file_with_the_name_of_a_new_folder_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "w"
    path.mkdir()
    (path / "meshes").write_text("mine")
    with pytest.warns(UserWarning, match="meshes as meshes~"):
        write_world(path, "1")
    assert version_of(path) == "1"
    assert (path / "meshes~").read_text() == "mine"


def test_a_full_disk_leaves_the_folder_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "w"
    write_world(path, "1")
    (path / "notes").write_text("mine")
    before = listing(tmp_path)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "link", full)
    with pytest.raises(OutputError, match=r"w: cannot be written: No space left on device$"):
        write_world(path, "2")
    assert version_of(path) == "1"
    assert listing(tmp_path) == before


def test_a_folder_that_cannot_be_moved_leaves_all_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "w"
    write_world(path, "1")
    (path / "mine").mkdir()
    before = listing(tmp_path)
    monkeypatch.setattr(os, "access", lambda folder, _: folder != path / "mine")
    with pytest.raises(OutputError, match=r"w: cannot be written: Permission denied \(.*mine\)$"):
        write_world(path, "2")
    assert version_of(path) == "1"
    assert listing(tmp_path) == before


def test_a_damaged_manifest_removes_no_edited_file(tmp_path: Path) -> None:
    path = tmp_path / "w"
    write_world(path, "1")
    (path / "model").write_text("edited")
    (path / MANIFEST).write_bytes(b"\xff")
    with pytest.warns(UserWarning, match="model as model~"):
        write_world(path, "2")
    assert (path / "model~").read_text() == "edited"
