"""Atomic writing: all or nothing, at every way out."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from lirs_wct.errors import OutputError
from lirs_wct.files import atomic_folder, atomic_write, check_writable, remove_orphans, staged_files
from lirs_wct.foreign_files import MANIFEST


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


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_broken_off_file_leaves_the_old_one(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "map.pgm"
    target.write_text("old")

    def broken_off() -> None:
        with atomic_write(target) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        broken_off()
    assert target.read_text() == "old"
    assert listing(tmp_path) == ["map.pgm"]


def test_a_folder_is_replaced_as_a_whole(tmp_path: Path) -> None:
    target = tmp_path / "world"
    for name in ("first", "second"):
        with atomic_folder(target) as temporary:
            (temporary / name).write_text(name)
    assert listing(tmp_path) == ["world", f"world/{MANIFEST}", "world/second"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_broken_off_folder_leaves_the_old_one(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "world"
    target.mkdir()
    (target / "old").write_text("old")

    def broken_off() -> None:
        with atomic_folder(target) as temporary:
            (temporary / "half").write_text("half")
            raise error

    with pytest.raises(error):
        broken_off()
    assert listing(tmp_path) == ["world", "world/old"]


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


def test_staged_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "case").mkdir()
    for name in ("mine", "page", "case/mine", "case/run"):
        (tmp_path / name).write_text("old")

    def write(error: BaseException | None = None) -> dict[str, str]:
        with staged_files(tmp_path) as staged:
            (staged / "case").mkdir()
            for name in ("page", "case/run", "case/new"):
                (staged / name).write_text("new")
            if error is not None:
                raise error
        return {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}

    for error in (KeyboardInterrupt(), ValueError()):
        with pytest.raises(type(error)):
            write(error)
        assert sorted(p.name for p in tmp_path.rglob("*")) == ["case", "mine", "mine", "page", "run"]
        assert (tmp_path / "page").read_text() == (tmp_path / "case" / "run").read_text() == "old"
    mine = {"mine": "old", "case/mine": "old"}
    assert write() == mine | {"page": "new", "case/run": "new", "case/new": "new"}
    assert not list(tmp_path.glob(".*"))


def test_a_block_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"), atomic_write(tmp_path / "x.txt"):
        pass


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


def test_orphans_of_dead_processes_are_removed(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = [f"trace-{dead.pid}-abc.trace", f"trace-{os.getpid()}-abc.trace", "trace-x-abc", f"{dead.pid}-a"]
    for name in names:
        (tmp_path / name).write_text("")
    remove_orphans(tmp_path, "trace-")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names[1:])


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


def test_a_file_of_ours_that_was_changed_is_kept_beside_the_new_one(tmp_path: Path) -> None:
    target = tmp_path / "world"
    write_folder(target, model="1", old="1")
    for number in (2, 3):
        (target / "model").write_text(f"edited {number}")
        (target / "old").write_text("edited")
        with pytest.warns(UserWarning, match=r"world: kept what was not written by .*: model as model~"):
            write_folder(target, model=str(number))
    read = {path.name: path.read_text() for path in target.iterdir() if path.name != MANIFEST}
    assert read == {"model": "3", "model~": "edited 2", "model~2": "edited 3", "old": "edited"}


def test_a_folder_without_manifest_belongs_to_the_user_unless_an_older_version_wrote_it(
    tmp_path: Path,
) -> None:
    mine, former = tmp_path / "mine", tmp_path / "former"
    for folder in (mine, former):
        folder.mkdir()
        (folder / "model").write_text("before")
        (folder / "notes").write_text("before")
    (former / "world.json").write_text("{}")
    with pytest.warns(UserWarning, match=r"mine: kept .*: model as model~$"):
        write_folder(mine, model="new")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_folder(former, model="new")
    assert (mine / "model~").read_text() == (mine / "notes").read_text() == "before"
    assert [p for p in listing(former) if p != MANIFEST] == ["model", "notes", "world.json"]


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


def test_a_user_s_file_that_cannot_be_kept_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "world"
    write_folder(target, model="1")
    (target / "meshes").mkdir()
    (target / "meshes" / "mine.stl").write_text("mine")
    with pytest.raises(OutputError, match=r"world: cannot be written: "):
        write_folder(target, meshes="a file where the user has a folder")
    assert listing(tmp_path) == [
        "world",
        f"world/{MANIFEST}",
        "world/meshes",
        "world/meshes/mine.stl",
        "world/model",
    ]
