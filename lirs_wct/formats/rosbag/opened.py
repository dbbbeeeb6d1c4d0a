"""A bag that is open for reading, whatever it is made of: split, compressed, without index, or cut off.

Its files are opened one by one: what says which there are is written last, and a recorder may die before.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.compression import inflated_file, inflated_message
from lirs_wct.formats.rosbag.library import METADATA
from lirs_wct.formats.rosbag.salvage.files import fault_of, salvaged
from lirs_wct.formats.suffixes import BAGS, ZSTD, is_bag_file


class Bag:
    """An open bag.

    Attributes:
        path: of the bag, as the user gave it.
        kinds: type of each topic.
        faults: what is damaged or missing; more may be found while messages are read.
        undecoded: how many messages could not be decoded, by topic.
    """

    def __init__(self, path: Path, reader: AnyReader, faults: list[str]) -> None:
        self.path, self.faults = path, faults
        self.kinds: dict[str, str] = {name: info.msgtype or "" for name, info in reader.topics.items()}
        self.undecoded: Counter[str] = Counter()
        self._reader = reader

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, Any]]:
        """Yield topics and messages as they were recorded, up to where the bag is damaged."""
        connections = [c for c in self._reader.connections if c.topic in topics]
        messages = self._reader.messages(connections) if connections else iter(())
        while True:
            # The parsers of damaged binary data raise whatever the bytes lead to.
            try:
                connection, _, data = next(messages)
            except StopIteration:
                return
            except Exception as error:
                self.faults.append(_reason(error))
                return
            try:
                message = self._reader.deserialize(inflated_message(data), connection.msgtype)
            except Exception:
                self.undecoded[connection.topic] += 1
                continue
            yield connection.topic, message


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag: a folder or file of ROS 2, or a ROS 1 bag.

    Raises:
        SourceError: it cannot be read, not even in part.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    faults = _missing(path)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="lirs-wct-")))
        try:
            files = [_readable(file, folder / str(k), faults) for k, file in enumerate(_files(path))]
            reader = stack.enter_context(AnyReader(files, default_typestore=store))
        except Exception as error:
            said = "; ".join([*faults, _reason(error)])
            raise SourceError(f"{path}: not a bag that can be read: {said}") from error
        yield Bag(path, reader, faults)


def _files(path: Path) -> list[Path]:
    """Return the files of a bag; of a folder with files of two kinds those of the first."""
    if not path.is_dir():
        return [path]
    # A file beside what it was decompressed into is there twice.
    found = {p.name.removesuffix(ZSTD): p for p in sorted(path.iterdir(), reverse=True) if is_bag_file(p)}
    kinds = ([found[name] for name in sorted(found) if name.endswith(suffix)] for suffix in BAGS)
    return next(files for files in kinds if files)


def _readable(file: Path, folder: Path, faults: list[str]) -> Path:
    """Return a file that the library reads: the file itself, or what could be made of it, in a folder."""
    folder.mkdir()
    if file.name.endswith(ZSTD):
        whole, file = file, folder / file.name.removesuffix(ZSTD)
        fault = inflated_file(whole, file)
        faults += [f"{whole.name}: {fault}"] if fault else []
    broken = fault_of(file)
    if broken is None:
        return file
    faults += [f"{file.name}: {broken}"] if broken else []
    return salvaged(file, folder / "salvaged")


def _missing(path: Path) -> list[str]:
    """Return what a bag's metadata names and its folder does not hold."""
    try:
        held = yaml.safe_load((path / METADATA).read_text(encoding="utf-8"))
        names = [Path(str(p)).name for p in held["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        return []
    return [f"{name} is missing" for name in names if not (path / name).exists()]


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
