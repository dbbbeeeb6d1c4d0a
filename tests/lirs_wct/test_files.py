"""Atomic writing: all or nothing, at every way out."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, strategies as st

from lirs_wct import files
from lirs_wct.errors import OutputError, SourceError
from lirs_wct.files import MANIFEST, atomic_folder, atomic_write, check_writable, staged_files
from lirs_wct.sources.source import BuildOptions, find_source


def listing(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


def test_a_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "map.pgm"
    with atomic_write(target) as temporary:
        assert temporary.suffix == ".pgm"
        temporary.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    assert listing(tmp_path) == ["deep", "deep/map.pgm"]


def test_a_folder_is_replaced_by_the_new_one(tmp_path: Path) -> None:
    target = tmp_path / "world"
    for name in ("first", "second"):
        with atomic_folder(target) as temporary:
            (temporary / name).write_text(name)
    assert listing(tmp_path) == ["world", f"world/{MANIFEST}", "world/second"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("write", [atomic_write, atomic_folder, staged_files])
def test_a_write_that_is_broken_off_leaves_the_old_files(
    tmp_path: Path, error: type[BaseException], write: Callable[[Path], Any]
) -> None:
    target = tmp_path / "world"
    target.mkdir()
    (target / "old").write_text("old")

    def broken_off() -> None:
        with write(target / "old" if write is atomic_write else target) as temporary:
            (temporary if write is atomic_write else temporary / "half").write_text("half")
            raise error

    with pytest.raises(error):
        broken_off()
    assert listing(tmp_path) == ["world", "world/old"]
    assert (target / "old").read_text() == "old"


def test_errors_begin_with_the_path(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    below = tmp_path / "file" / "x.stl"
    with pytest.raises(OutputError) as below_file, atomic_write(below) as temporary:
        temporary.write_text("")
    assert str(below_file.value).startswith(f"{below}: cannot be written: ")
    with pytest.raises(OutputError, match="is a folder"), atomic_write(tmp_path / "folder"):
        pass
    with pytest.raises(OutputError, match="is a file"), atomic_folder(tmp_path / "file"):
        pass
    assert listing(tmp_path) == ["file", "folder"]


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        with pytest.raises(OutputError) as refused:
            check_writable(folder)
        assert str(refused.value).startswith(f"{folder}: cannot be written: ")
    check_writable(None)
    check_writable(tmp_path)
    check_writable(tmp_path / "new" / "folder")
    assert listing(tmp_path) == ["file"]


def test_an_error_shows_no_hidden_folder(tmp_path: Path) -> None:
    (tmp_path / "None").mkdir()
    for folder in (atomic_folder, staged_files):
        with (
            pytest.raises(OutputError) as refused,
            folder(tmp_path / "None") as temporary,
            atomic_write(temporary / "a.json"),
        ):
            pass
        assert str(refused.value).startswith(f"{tmp_path / 'None' / 'a.json'}: cannot be written: ")
        assert temporary.name not in str(refused.value)
    assert list(tmp_path.iterdir()) == [tmp_path / "None"]


def test_staged_files_appear_beside_those_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "case").mkdir()
    for name in ("mine", "page", "case/mine", "case/run"):
        (tmp_path / name).write_text("old")
    with staged_files(tmp_path) as staged:
        (staged / "case").mkdir()
        for name in ("page", "case/run", "case/new"):
            (staged / name).write_text("new")
    texts = {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    mine = {"mine": "old", "case/mine": "old"}
    assert texts == mine | {"page": "new", "case/run": "new", "case/new": "new"}


def test_what_a_killed_process_left_goes_when_its_place_is_written_next(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    swept = [
        f".world.{dead.pid}-0123abcd",
        f".map.{dead.pid}-0123abcd.pgm",
        f".map.{os.getpid()}-0123abcd.pgm",
    ]
    spared = [f".world.{os.getppid()}-0123abcd", f".other.{dead.pid}-0123abcd", ".world", ".map.pgm"]
    for name in swept + spared:
        (tmp_path / name).mkdir()
    with atomic_folder(tmp_path / "world") as folder, atomic_folder(tmp_path / "world") as other:
        assert folder.exists()  # two at once: neither is a leftover
        assert other.exists()
        with atomic_write(tmp_path / "map.pgm") as first, atomic_write(tmp_path / "map.pgm") as second:
            first.write_text("a")
            second.write_text("b")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*spared, "map.pgm", "world"])


def write_folder(target: Path, **files: str) -> None:
    with atomic_folder(target) as temporary:
        for name, text in files.items():
            (temporary / name).write_text(text)


def test_what_the_user_put_into_a_folder_stays(tmp_path: Path) -> None:
    target = tmp_path / "world"
    write_folder(target, model="1", gone="1")
    (target / "notes.txt").write_text("mine")
    (target / "urdf" / "empty").mkdir(parents=True)
    (target / "urdf" / "robot.urdf").write_text("mine")
    (target / "link").symlink_to("notes.txt")
    write_folder(target, model="2")
    assert listing(tmp_path) == [
        "world",
        "world/link",
        f"world/{MANIFEST}",
        "world/model",
        "world/notes.txt",
        "world/urdf",
        "world/urdf/empty",
        "world/urdf/robot.urdf",
    ]
    assert (target / "model").read_text() == "2"
    assert (target / "link").readlink() == Path("notes.txt")
    assert (target / "urdf/robot.urdf").read_text() == "mine"


@pytest.mark.parametrize(
    ("mine", "shown"),
    [("model", "model"), ("meshes", "meshes"), ("meshes/a/b", "meshes/a"), ("link", "link")],
)
def test_a_name_that_the_user_took_is_refused_before_anything_changes(
    mine: str, shown: str, tmp_path: Path
) -> None:
    target = tmp_path / "world"
    write_folder(target, model="1", old="1")
    if mine == "link":
        (target / mine).symlink_to("model")
    else:
        (target / mine).parent.mkdir(parents=True, exist_ok=True)
        (target / mine).write_text("mine")
    before = {path: path.read_text() for path in target.rglob("*") if path.is_file()}
    with pytest.raises(OutputError, match=rf"^{target / shown}: was not written by this program, or was"):
        write_new_names(target)
    assert {path: path.read_text() for path in target.rglob("*") if path.is_file()} == before


def write_new_names(target: Path) -> None:
    with atomic_folder(target) as new:
        write_files(new, dict.fromkeys(("model", "link", "meshes/a"), "new"))


def test_an_old_file_that_the_user_changed_stays(tmp_path: Path) -> None:
    target = tmp_path / "world"
    write_folder(target, **{"model": "1", "old": "1", "older": "1", "record.json": "1", "twin.json": "1"})
    (target / "old").write_text("mine")
    (target / "record.json").write_text("mine")
    write_folder(target, model="2")
    assert {p.name: p.read_text() for p in target.iterdir() if p.name != MANIFEST} == {
        "model": "2",
        "old": "mine",
        "record.json": "mine",
    }


def test_a_file_behind_a_link_of_the_user_stays(tmp_path: Path) -> None:
    target = tmp_path / "world"
    write_old(target)
    (target / "meshes").rename(tmp_path / "disk")
    (target / "meshes").symlink_to(tmp_path / "disk")
    write_folder(target, a="new")
    assert (tmp_path / "disk" / "b").read_text() == "old"


@pytest.mark.parametrize("named", ["../mine", "{folder}/mine"])
def test_a_manifest_names_no_file_outside_its_folder(named: str, tmp_path: Path) -> None:
    target = tmp_path / "world"
    write_old(target)
    (tmp_path / "mine").write_text("mine")
    with (target / MANIFEST).open("a") as manifest:
        manifest.write(f"{files.digest(tmp_path / 'mine')}  {named.format(folder=tmp_path)}\n")
    write_folder(target, a="new")
    assert (tmp_path / "mine").read_text() == "mine"


def write_old(target: Path) -> None:
    with atomic_folder(target) as new:
        write_files(new, OLD)


OLD = {"world.json": "old", "a": "old", "meshes/b": "old", "same": "same"}
NEW = {"world.json": "new", "a": "new", "meshes/c": "new", "same": "same"}


def write_files(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


@given(
    st.dictionaries(st.sampled_from(["notes", "meshes/mine", "b/c", "meshes/deep/x"]), st.text("xyz")),
    st.integers(0, 14),
)
def test_a_write_that_is_killed_at_any_step_loses_nothing(mine: dict[str, str], step: int) -> None:
    with TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        folder = Path(name) / "world"
        with atomic_folder(folder) as first:
            write_files(first, OLD)
        write_files(folder, mine)
        (Path(name) / "beside").write_text("mine")
        left = iter(range(step))
        for call in ("replace", "unlink", "rmdir"):
            patch.setattr(Path, call, die_after(left, getattr(Path, call)))
        try:
            with atomic_folder(folder) as second:
                write_files(second, NEW)
        except KeyboardInterrupt:
            patch.undo()
            files._WRITING.clear()  # names of a process that has died
            held = {n: (folder / n).read_text() for n in OLD.keys() | NEW.keys() if (folder / n).exists()}
            if "world.json" in held:
                assert held in (OLD, NEW)
            with atomic_folder(folder) as again:
                write_files(again, NEW)
        found = {
            path.relative_to(folder).as_posix(): path.read_text()
            for path in folder.rglob("*")
            if path.is_file() and path.name != MANIFEST
        }
        assert found == NEW | mine
        assert (Path(name) / "beside").read_text() == "mine"
        assert sorted(path.name for path in Path(name).iterdir()) == ["beside", "world"]


def die_after(left: Iterator[int], call: Callable[..., Any]) -> Callable[..., Any]:
    def mortal(*arguments: Any, **more: Any) -> Any:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return call(*arguments, **more)

    return mortal


def test_a_folder_without_its_marker_is_incomplete(tmp_path: Path) -> None:
    write_old(tmp_path / "world")
    (tmp_path / "world" / "world.json").unlink()
    write_folder(tmp_path / "runs", model="1")
    for name, reason in (
        ("world", "is incomplete, its build was broken off: build it again"),
        ("runs", "a folder that was built holds world.json, this one does not"),
    ):
        with pytest.raises(SourceError, match=f"{name}: {reason}"):
            find_source(tmp_path / name, BuildOptions())


def test_the_manifest_is_what_sha256sum_checks(tmp_path: Path) -> None:
    write_folder(tmp_path / "world", model="1", other="2")
    done = subprocess.run(
        ["sha256sum", "--check", "--strict", MANIFEST], cwd=tmp_path / "world", capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["model: OK", "other: OK"]


def test_a_link_to_a_folder_stays_one(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "world").symlink_to(tmp_path / "disk")
    write_folder(tmp_path / "world", model="1")
    assert (tmp_path / "world").is_symlink()
    assert (tmp_path / "disk" / "model").read_text() == "1"
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
