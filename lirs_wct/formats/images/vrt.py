"""The files that GDAL follows from a raster: sources of a VRT, overviews and masks in sidecars."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from lirs_wct.errors import SourceError
from lirs_wct.formats.references import referenced_file

SIDECARS = (".aux.xml", ".ovr", ".msk")
_NAMING = ("file", "dataset", "path", "dem", "url")
"""Parts of the names of elements, attributes and options whose values are files."""
_FOLLOWED = ("overviews", "geolocation")
"""Domains of metadata whose values GDAL opens."""
_HEAD = 1 << 16


def followed_files(path: Path) -> set[Path]:
    """Return the files that GDAL may read with a raster, itself included.

    Raises:
        SourceError: a file names one that is not in its folder, or is a damaged VRT.
    """
    found, unseen = {path}, [path]
    while unseen:
        at = unseen.pop()
        sidecars = (at.name + suffix for suffix in SIDECARS)
        for name in (*_references(at), *(name for name in sidecars if at.with_name(name).exists())):
            each = referenced_file(at, name)
            if each not in found and each.is_file():
                found.add(each)
                unseen.append(each)
    return found


def _references(path: Path) -> Iterator[str]:
    """Yield the names of files in a VRT or a sidecar's XML; none of another file.

    The content counts, not the suffix: GDAL takes a source for a VRT that begins like one.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not (vrt := b"<vrtdataset" in head.lower()) and not path.name.lower().endswith(".aux.xml"):
        return
    text = path.read_bytes()
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise SourceError(f"{path}: has a document type, which no VRT needs")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise SourceError(f"{path}: is damaged XML: {error}") from error
    for element in root.iter():
        yield from _followed_metadata(element)
        for name, value in _named_values(element) if vrt else ():
            if any(word in name.lower() for word in _NAMING) and value.strip():
                yield value.strip()
                # GDAL reads such a name from the folder of the process.
                if (element.get("relativeToVRT") or "0").strip() != "1":
                    yield str(Path.cwd() / value.strip())


def _named_values(element: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Yield the names and values of an element: GDAL takes an attribute for an element, too."""
    tag = element.tag.rpartition("}")[2]
    if tag.lower() != "mdi":
        option = element.get("name") or element.get("key") or ""
        yield f"{tag} {option}", element.text or ""
        yield from element.attrib.items()


def _followed_metadata(element: ElementTree.Element) -> Iterator[str]:
    if (element.get("domain") or "").lower() in _FOLLOWED:
        yield from (
            entry.text.strip().removeprefix(":::BASE:::")
            for entry in element
            if "file" in (entry.get("key") or "").lower() or "dataset" in (entry.get("key") or "").lower()
            if entry.text
        )
