"""Built worlds on disk: by content, whole or not at all, and never in the way."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import lirs_wct
from lirs_envs.episodes import world_cache
from lirs_envs.episodes.world_cache import FOLDER_VARIABLE, cached_world, content_key
from lirs_wct.errors import SourceError
from lirs_wct.world import World


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "cache"
    monkeypatch.setenv(FOLDER_VARIABLE, str(place))
    world_cache._in_memory.cache_clear()
    return place


def picture(path: Path, seed: int) -> str:
    cv2.imwrite(str(path), np.random.default_rng(seed).integers(0, 255, (33, 33), np.uint8))
    return str(path)


def test_a_second_process_loads_what_the_first_built(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = picture(tmp_path / "hill.png", 1)
    first = cached_world(source)
    assert [p.name for p in folder.iterdir()] == [content_key(source)]
    world_cache._in_memory.cache_clear()
    monkeypatch.setattr(lirs_wct, "build_world", lambda _: pytest.fail("it was built again"))
    again = cached_world(source)
    assert again.name == first.name
    assert again.surface.z.tobytes() == first.surface.z.tobytes()
    assert again.spawn_poses == first.spawn_poses


def test_a_map_s_picture_is_its_content(folder: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "m.png"), np.full((60, 60), 254, np.uint8))
    yaml = tmp_path / "m.yaml"
    yaml.write_text(
        "image: m.png\nresolution: 0.1\norigin: [0, 0, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    key = content_key(str(yaml))
    cv2.imwrite(str(tmp_path / "m.png"), np.full((60, 60), 0, np.uint8))
    assert content_key(str(yaml)) != key
    (tmp_path / "m.png").unlink()
    with pytest.raises(SourceError, match=r"m\.png is not there"):
        cached_world(str(yaml))


def test_a_damaged_or_closed_cache_is_no_reason_to_stop(folder: Path, tmp_path: Path) -> None:
    source = picture(tmp_path / "hill.png", 1)
    built = cached_world(source)
    kept = folder / str(content_key(source))
    for file in kept.iterdir():
        file.write_bytes(b"damaged")
    world_cache._in_memory.cache_clear()
    assert cached_world(source).surface.z.tobytes() == built.surface.z.tobytes()
    assert World.load(kept).name == built.name
    world_cache._in_memory.cache_clear()
    folder.rename(tmp_path / "elsewhere")
    folder.write_text("a file where the folder should be")
    assert cached_world(source).name == built.name
