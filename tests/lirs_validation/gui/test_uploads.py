"""Files of a browser: names never become paths, maps see uploads only."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from lirs_validation.gui.construction import MAX_STEM_CHARACTERS, Uploads
from lirs_wct import build_world
from lirs_wct.errors import SourceError, WctError


@pytest.fixture
def uploads() -> Iterator[Uploads]:
    found = Uploads()
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
        ("x" * 500 + ".png", "x" * MAX_STEM_CHARACTERS + ".png"),
    ],
)
def test_names_become_harmless(uploads: Uploads, given: str, kept: str) -> None:
    path = uploads.add(given, b"1")
    assert path == uploads.folder / kept
    assert [p.name for p in uploads.folder.iterdir()] == [kept]


@pytest.mark.parametrize("name", ["notes.txt", "program.py", "noend", "", "..", "/"])
def test_a_name_never_leaves_the_folder(uploads: Uploads, name: str) -> None:
    path = uploads.add(name, b"1")
    assert list(uploads.folder.iterdir()) == [path]
    with pytest.raises(WctError, match=f"^{path}: "):
        build_world(path)


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
