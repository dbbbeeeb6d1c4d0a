"""Files of a browser: names never become paths, sizes are capped, maps see uploads only."""

import gzip
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from lirs_validation.gui.session.uploads import LONGEST, PageLimits, Uploads
from lirs_wct.errors import ConfigError, SourceError


@pytest.fixture
def uploads() -> Iterator[Uploads]:
    found = Uploads(PageLimits(upload=10_000))
    yield found
    found.close()
    assert not found.folder.exists()


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("../../etc/passwd.png", "passwd.png"),
        ("C:\\Users\\me\\hill.png", "hill.png"),
        ("/etc/hill.png", "hill.png"),
        (".png", "file.png"),
        ("..png", "file.png"),
        ("my terrain (2).PNG", "my_terrain_2.PNG"),
        ("путь.png", "file.png"),
        ("a\0b\n.png", "a_b.png"),
        ("x" * 500 + ".png", "x" * LONGEST + ".png"),
    ],
)
def test_names_become_harmless(uploads: Uploads, given: str, kept: str) -> None:
    path = uploads.add(given, b"1")
    assert path == uploads.folder / kept
    assert [p.name for p in uploads.folder.iterdir()] == [kept]


@pytest.mark.parametrize("name", ["notes.txt", "program.py", "noend", "", "..", "/"])
def test_only_what_is_read_is_kept(uploads: Uploads, name: str) -> None:
    with pytest.raises(SourceError, match="not a file that is read"):
        uploads.add(name, b"1")
    assert not list(uploads.folder.iterdir())


def test_a_refused_file_leaves_no_trace(uploads: Uploads) -> None:
    path = uploads.add("hill.png", b"good")
    uploads.add("hill.png", b"worse")
    uploads.undo()
    assert path.read_bytes() == b"good"
    uploads.undo()
    assert path.read_bytes() == b"good"
    uploads.add("other.png", bytes(9_000))
    uploads.undo()
    assert [p.name for p in uploads.folder.iterdir()] == ["hill.png"]
    uploads.add("large.png", bytes(9_000))


def test_all_files_of_a_page_together_are_capped(uploads: Uploads) -> None:
    uploads.add("a.png", bytes(6_000))
    with pytest.raises(SourceError, match=r"b\.png: .* are too many"):
        uploads.add("b.png", bytes(6_000))
    uploads.add("a.png", bytes(9_000))  # in place of the first
    assert [p.name for p in uploads.folder.iterdir()] == ["a.png"]


def test_a_log_that_unpacks_without_end_is_refused(uploads: Uploads) -> None:
    with pytest.raises(SourceError, match=r"bomb\.clf\.gz: unpacks to more"):
        uploads.add("bomb.clf.gz", gzip.compress(bytes(10_000_000)))


def test_a_compressed_bag_is_kept_unless_it_unpacks_without_end(uploads: Uploads) -> None:
    from lirs_wct.formats.rosbag import compression

    whole = compression.zstd.compress(bytes(range(256)) * 40)
    for content in (whole, whole[:-3], b"no zstd at all"):  # what is damaged, its reader says
        assert uploads.add("run_0.mcap.zstd", content).name == "run_0.mcap.zstd"
    with pytest.raises(SourceError, match=r"bomb\.mcap\.zstd: unpacks to more"):
        uploads.add("bomb.mcap.zstd", compression.zstd.compress(bytes(10_000_000)))


@pytest.mark.parametrize("image", ["/etc/passwd.pgm", "../../secret.pgm", "floor.pgm", "a/b/c.pgm"])
def test_a_map_names_uploaded_pictures_only(uploads: Uploads, image: str) -> None:
    path = uploads.add("map.yaml", yaml.safe_dump({"image": image, "resolution": 0.05}).encode())
    assert yaml.safe_load(path.read_text()) == {"image": Path(image).name, "resolution": "0.05"}
    windows = "# für Gänge\nimage:\troom.pgm\nmode: Trinary\nlayer: {a: 1}\n".encode("cp1252")
    path = uploads.add("map.yaml", windows)
    assert yaml.safe_load(path.read_text()) == {"image": "room.pgm", "mode": "Trinary"}


@pytest.mark.parametrize("content", [b"\xff\xfe", b"- 1\n- 2", b"a: [", b"", b"resolution: 1"])
def test_a_map_that_is_none_is_refused(uploads: Uploads, content: bytes) -> None:
    with pytest.raises(SourceError, match=r"map\.yaml: is no YAML of a map"):
        uploads.add("map.yaml", content)


def test_limits_are_above_zero() -> None:
    with pytest.raises(ConfigError, match="upload"):
        PageLimits(upload=0)
