"""COLLADA documents are read whole, or a line names the part left out."""

from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes.reader import read_upright
from lirs_wct.geometry.mesh import TriangleMesh
from tests.kit import refused

BOX = "0 2 3 1 4 5 7 6 0 1 5 4 2 6 7 3 0 4 6 2 1 3 7 5"
PLACES = " ".join(f"{x} {y} {z}" for z in (0, 1) for y in (0, 3) for x in (0, 2))
QUADS = f'<polylist material="M" count="6">{{}}<vcount>4 4 4 4 4 4</vcount><p>{BOX}</p></polylist>'
VERTEX = '<input semantic="VERTEX" source="#v" offset="0"/>'


def source(name: str, numbers: str, axes: str) -> str:
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in axes)
    n = len(numbers.split())
    return (
        f'<source id="{name}"><float_array id="{name}-a" count="{n}">{numbers}</float_array>'
        f'<technique_common><accessor source="#{name}-a" count="{n // len(axes)}" stride="{len(axes)}">'
        f"{params}</accessor>"
        "</technique_common></source>"
    )


def geometry(faces: str, places: str = PLACES, more: str = "", name: str = "g") -> str:
    return (
        f'<geometry id="{name}"><mesh>{source("p", places, "XYZ")}{more}'
        f'<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{faces}</mesh></geometry>'
    )


def document(path: Path, nodes: str, libraries: str = "", shapes: str | None = None) -> Path:
    """Write a document, z up in meters."""
    shapes = geometry(QUADS.format(VERTEX)) if shapes is None else shapes
    path.write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset><up_axis>Z_UP</up_axis></asset><library_geometries>{shapes}</library_geometries>{libraries}"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )
    return path


def moved(x: float, inside: str = '<instance_geometry url="#g"/>', name: str = "") -> str:
    return f'<node id="{name or x}"><translate>{x} 0 0</translate>{inside}</node>'


def size(mesh: TriangleMesh) -> list[float]:
    sides: list[float] = np.ptp(mesh.bounds, axis=0).round(5).tolist()
    return sides


DOOR = "0 0 0 1.5 0 0 1.5 0 2 2.5 0 2 2.5 0 0 4 0 0 4 0 3 0 0 3"
WINDOW = "0 0 0 4 0 0 4 0 3 0 0 3 1 0 1 1 0 2 2 0 2 2 0 1"
SQUARE = "0 0 0 2 0 0 2 0 2 0 0 2"


@pytest.mark.parametrize(
    ("places", "faces", "expected"),
    [
        (DOOR, "<polylist count='1'>{}<vcount>8</vcount><p>0 1 2 3 4 5 6 7</p></polylist>", 10),
        (DOOR, "<polygons count='1'>{}<p>0 1 2 3 4 5 6 7</p></polygons>", 10),
        (WINDOW, "<polygons count='1'>{}<ph><p>0 1 2 3</p><h>4 5 6 7</h></ph></polygons>", 11),
        (WINDOW, "<polygons count='1'>{}<ph><p>0 1 2 3</p><h>7 6 5 4</h></ph></polygons>", 11),
        (WINDOW, "<polygons count='2'>{}<p>4 5 6 7</p><ph><p>0 1 2 3</p><h>4 5 6 7</h></ph></polygons>", 12),
        (SQUARE, "<tristrips count='1'>{}<p>0 1 3 2</p></tristrips>", 4),
        (SQUARE, "<trifans count='1'>{}<p>0 1 2 3</p></trifans>", 4),
        (
            SQUARE,
            "<polylist count='0'>{}<vcount/><p/></polylist><polygons count='0'>{0}</polygons>"
            "<trifans count='1'>{0}<p>0 1 2 3</p></trifans>".replace("{}", "{0}"),
            4,
        ),
        (SQUARE, "<polylist count='3'>{}<vcount>2 4 1</vcount><p>0 1 0 1 2 3 2</p></polylist>", 4),
    ],
)
def test_the_area_of_polygons(tmp_path: Path, places: str, faces: str, expected: float) -> None:
    mesh = read_upright(document(tmp_path / "a.dae", moved(0), shapes=geometry(faces.format(VERTEX), places)))
    assert mesh.face_areas.sum() == pytest.approx(expected)


SKIN = (
    '<library_controllers><controller id="c"><skin source="#g"><bind_shape_matrix>'
    "1 0 0 5 0 1 0 0 0 0 2 0 0 0 0 1</bind_shape_matrix></skin></controller></library_controllers>"
)
NESTED = (
    '<library_nodes><node id="pair"><node><instance_geometry url="#g"/></node>'
    f'<node id="deep">{moved(5)}</node></node></library_nodes>'
)
MIRROR = "<rotate>0 0 2 90</rotate><scale>1 -1 1</scale>"
SWAP = "<matrix>0 0 1 0 1 0 0 0 0 1 0 0 0 0 0 1</matrix>"
LOOK = "<lookat>9 0 0 9 0 -5 0 1 0</lookat>"
PLAIN = '<instance_geometry url="#g"/>'
SKINNED = '<instance_controller url="#c"/>'
ELSEWHERE = '<instance_geometry url="b.dae#g"/>'
BOUND = (
    '<instance_geometry url="#g"><bind_material><technique_common>'
    '<instance_material symbol="M" target="#none"/></technique_common></bind_material></instance_geometry>'
)


@pytest.mark.parametrize(
    ("nodes", "libraries", "expected", "faces"),
    [
        (moved(0) + moved(10), "", [12, 3, 1], 24),
        (moved(0) + moved(10, '<instance_node url="#pair"/>'), NESTED, [17, 3, 1], 36),
        (moved(0) + moved(10, '<instance_node url="#deep"/>'), NESTED, [17, 3, 1], 24),
        (moved(10, '<instance_node url="#x"/>') + moved(3, name="x"), "", [12, 3, 1], 24),
        (f"<node>{MIRROR}{PLAIN}</node>", "", [3, 2, 1], 12),
        (f"<node>{SWAP}{PLAIN}</node>", "", [1, 2, 3], 12),
        (f"{moved(0)}<node>{LOOK}{PLAIN}</node>", "", [11, 3, 1], 24),
    ],
)
def test_instances(tmp_path: Path, nodes: str, libraries: str, expected: list[float], faces: int) -> None:
    mesh = read_upright(document(tmp_path / "a.dae", nodes, libraries))
    assert (size(mesh), len(mesh.faces)) == (expected, faces)
    assert mesh.is_watertight
    assert mesh.volume > 0


def test_a_missing_material_harms_nothing(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    mesh = read_upright(document(tmp_path / "a.dae", moved(0) + moved(10, BOUND)))
    assert size(mesh) == [12, 3, 1]
    assert not recwarn


@pytest.mark.parametrize(
    ("nodes", "libraries", "expected", "line"),
    [
        (
            moved(0) + moved(5, SKINNED),
            SKIN,
            [12, 3, 2],
            "skin `c` is read as its plain shape, without joints",
        ),
        (moved(0) + moved(9, ELSEWHERE), "", [2, 3, 1], "1 of 2 instances left out: `b.dae#g` is in another"),
    ],
)
def test_a_line_names_the_part(
    tmp_path: Path, nodes: str, libraries: str, expected: list[float], line: str
) -> None:
    with pytest.warns(UserWarning, match=line) as told:
        mesh = read_upright(document(tmp_path / "a.dae", nodes, libraries))
    assert len(told) == 1
    assert str(told[0].message).startswith(f"{tmp_path / 'a.dae'}: ")
    assert size(mesh) == expected


@pytest.mark.parametrize(
    ("nodes", "libraries", "reason"),
    [
        (
            moved(0) + '<node><instance_node url="#lost"/></node>',
            "",
            "names the node `lost`, which is not in the file",
        ),
        (moved(0, '<instance_geometry url="#h"/>'), "", "names the geometry `h`, which is not in the file"),
        (
            moved(0, '<instance_controller url="#h"/>'),
            "",
            "names the controller `h`, which is not in the file",
        ),
        (moved(0, '<instance_node url="#x"/>', name="x"), "", "is nested too deeply"),
        (f"<node><skew>45 1 0 0 0 1 0</skew>{moved(0)}</node>", "", "has a node with <skew>"),
    ],
)
def test_one_line_says_the_fault(tmp_path: Path, nodes: str, libraries: str, reason: str) -> None:
    with refused(f"{tmp_path / 'a.dae'}: ", reason):
        read_upright(document(tmp_path / "a.dae", nodes, libraries))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused(tmp_path: Path, encoding: str) -> None:
    text = document(tmp_path / "a.dae", moved(0)).read_text().replace("utf-8", encoding)
    bomb = '<!DOCTYPE x [<!ENTITY a "1"><!ENTITY b "&a;&a;&a;">]>'
    (tmp_path / "a.dae").write_text(text.replace("?>", f"?>{bomb}", 1), encoding=encoding)
    with pytest.raises(SourceError, match="has a DOCTYPE, which is not read; remove it"):
        read_upright(tmp_path / "a.dae")


def test_the_scene_that_is_named_counts(tmp_path: Path) -> None:
    path = document(tmp_path / "a.dae", moved(0))
    other = f'<visual_scene id="other">{moved(40)}{moved(90)}</visual_scene><visual_scene id="s">'
    path.write_text(path.read_text().replace('<visual_scene id="s">', other))
    assert size(read_upright(path)) == [2, 3, 1]
