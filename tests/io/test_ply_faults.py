"""Files that are no scene, or a broken one: each gets one line that says what it is.

Not established here: which words plyfile uses of a broken header; only that they are one
printable line behind the file's name.
"""

from __future__ import annotations

import os
import re
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.io.plywriter import EXTRINSIC, FACE, LITTLE, TEXT, raw_columns, write_ply
from tsplat.core.errors import SceneError
from tsplat.io import load_scene, plyrows

HEAD = b"ply\nformat binary_little_endian 1.0\n"


def refusal(path, **options) -> str:
    """The one line that load_scene refuses ``path`` with."""
    with pytest.raises(SceneError) as caught:
        load_scene(path, **options)
    text = str(caught.value)
    assert text.isprintable(), text
    assert text.startswith(str(path)[:60])
    return text


def header(*lines: str, count: object = 1) -> bytes:
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    head = [f"element vertex {count}", *(f"property float {n}" for n in names), *lines]
    return HEAD + "\n".join([*head, "end_header\n"]).encode()


ROW = struct.pack("<14f", *([0.5] * 14))

CASES = {
    "empty": (b"", "the file is empty"),
    "not ply": (b"PLY\nformat", "named .ply, but it does not begin with 'ply'; formats"),
    "nearly ply": (b"plywood\n", "unknown format"),
    "only ply": (b"ply\n", "without an end_header line anywhere; the file is damaged"),
    "no end": (HEAD + b"comment x\n" * 99, "without an end_header line anywhere"),
    "endless": (HEAD + b"comment x\n" * 200_000, "without an end_header line in its first 131072"),
    "binary header": (b"ply\n" + bytes(range(256)) * 9 + b"\nend_header\n", "cannot be read: line"),
    "no format": (b"ply\nelement vertex 1\nend_header\n", "cannot be read: line 2"),
    "no vertex": (HEAD + b"element face 0\nend_header\n", "without an element vertex.*: face"),
    "negative": (header(count=-1), "an element count of '-1'"),
    "count of words": (header(count="many"), "an element count of 'many'"),
    "count with line": (header(count="1_0"), "an element count of '1_0'"),
    "count of 5000 digits": (header(count="9" * 5000), "an element count of '999+…'"),
    "huge": (header(count=10**15 - 1), r"truncated: .* promises 56000000000000315 bytes.* has 3"),
    "no rows": (header(count=0), r"holds no Gaussians \(element vertex 0\)"),
    "one byte short": (header(count=2) + ROW + ROW[:-1], "truncated: .* download it again"),
    "no row at all": (header(), "truncated"),
    "f_rest 1": (header("property float f_rest_0") + ROW * 2, "has 1 f_rest properties; exp"),
    "f_rest gap": (
        header(*(f"property float f_rest_{i}" for i in range(1, 10))) + ROW * 2,
        "has 9 f_rest properties but no f_rest_0",
    ),
    "f_rest word": (header("property float f_rest_x") + ROW * 2, "has a property 'f_rest_x'"),
    "f_rest minus": (header("property float f_rest_-1") + ROW * 2, "has a property 'f_rest_-1'"),
    "twice": (header("property float x") + ROW * 2, "two properties with same name"),
    "two vertices": (header("element vertex 1") + ROW * 2, "two elements with same name"),
    "list": (
        header("property list uchar int more") + ROW * 2,
        "property more of element vertex is a list, expected a number",
    ),
    "unknown type": (header("property float16 h") + ROW * 2, "field type 'float16'"),
    "rows of nothing": (header("element face 7") + ROW, "element face has 7 rows of no properties"),
    "elements": (header(*["element e 0"] * 999) + ROW, "1000 elements, expected at most 256"),
    "escape": (header("property list int int \x1b]0;x\x07") + ROW * 2, r"property \?]0;x\? of el"),
    "escape in count": (header(count="\x1b[2J"), r"an element count of '\?\[2J'"),
    "not UTF-8": (HEAD + b"element \xff\xfe 1\nend_header\n", r"element \?\? has 1 rows"),
    "carriage return": (header(count="\r\x1b[2K1"), "cannot be read|element count"),
    "many lists first": (
        HEAD + b"element face 2000000\nproperty list uchar int i\n" + header()[len(HEAD) :]
        + bytes(2_000_100),
        "2000000 rows of lists before the vertices, expected at most 65536",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refused_with_one_line(tmp_path, case):
    """What was found and what to do, on one printable line behind the file's name."""
    content, expected = CASES[case]
    path = tmp_path / "case.ply"
    path.write_bytes(content)
    assert re.search(expected, refusal(path)), refusal(path)


def test_point_cloud_and_mesh_are_named(tmp_path):
    """Vertices without opacity, scales and rotations are a point cloud, with faces a mesh."""
    columns = {name: np.zeros(3) for name in ("x", "y", "z", "red")}
    assert "this is a point cloud of 3 vertices" in refusal(
        write_ply(tmp_path / "cloud.ply", columns, types={"red": "uchar"})
    )
    assert "this is a mesh (element face 2) of 3 vertices" in refusal(
        write_ply(tmp_path / "mesh.ply", columns, after=[FACE], fmt=TEXT)
    )


@pytest.mark.parametrize("name", ["x", "f_dc_1", "opacity", "scale_1", "rot_3"])
def test_a_missing_property_is_named(tmp_path, name):
    """Exactly the property that is not there is named."""
    columns = raw_columns(2, 0)
    del columns[name]
    assert f"element vertex lacks {name};" in refusal(write_ply(tmp_path / "a.ply", columns))


def test_degree_four_is_refused_by_name(tmp_path):
    """72 f_rest properties are degree 4, which would lose colour if cut to degree 3 in silence."""
    columns = raw_columns(1, 0) | {f"f_rest_{i}": np.zeros(1) for i in range(72)}
    assert "has 72 f_rest properties, which is degree 4; expected 0, 9, 24 or 45" in refusal(
        write_ply(tmp_path / "a.ply", columns)
    )


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        (lambda t: t.replace(b" ", b" word ", 20), "row 0"),
        (lambda t: t.rsplit(b"\n", 2)[0] + b"\n", "early end-of-file|truncated"),
        (lambda t: t.replace(b"\n", b" 1\n", 99), "row 0: expected end-of-line"),
        (lambda t: t[:-40] + b"\xff" * 40, "cannot be read"),
    ],
)
def test_text_with_faults(tmp_path, damage, found):
    """Words, missing rows, too many numbers and bytes that are no text are all refused."""
    path = write_ply(tmp_path / "a.ply", raw_columns(3, 0), fmt=TEXT)
    head, body = path.read_bytes().split(b"end_header\n")
    path.write_bytes(head + b"end_header\n" + damage(body))
    assert re.search(found, refusal(path))


def test_text_beyond_float32_is_dropped(tmp_path):
    """1e99 in a float column is infinite: a row that cannot be drawn, not a warning."""
    columns = raw_columns(2, 0)
    columns["f_dc_0"][0] = 12345.0
    path = write_ply(tmp_path / "a.ply", columns, fmt=TEXT)
    path.write_bytes(path.read_bytes().replace(b"12345", b"1e99"))
    assert dict(load_scene(path).dropped) == {"colour not finite": 1}


def test_nothing_left_to_draw(tmp_path):
    """A file of which every row is dropped is refused with the reasons."""
    columns = raw_columns(2, 0)
    columns["y"][:] = np.nan
    assert "none of its Gaussians can be drawn (mean not finite: 2)" in refusal(
        write_ply(tmp_path / "a.ply", columns)
    )


def test_logits_read_as_raw_opacity(tmp_path):
    """raw_opacity on a file of logits is refused by what it shows, not drawn nearly empty."""
    columns = raw_columns(20, 0)
    columns["opacity"] = np.linspace(-9, 9, 20)
    path = write_ply(tmp_path / "a.ply", columns)
    assert "outside 0..1, so they are logits" in refusal(path, raw_opacity=True)


def test_nothing_is_mapped_before_the_size_is_checked(tmp_path, monkeypatch):
    """A header that promises too much is refused before plyfile may read a row."""
    path = tmp_path / "a.ply"
    path.write_bytes(header(count=10**9))
    monkeypatch.setattr(plyrows, "open_rows", lambda *_: pytest.fail("rows were read"))
    assert "truncated" in refusal(path)


@pytest.mark.parametrize("left", [0.1, 0.5, 0.999])
def test_a_file_cut_short_while_it_is_read(tmp_path, monkeypatch, left):
    """It is refused in one line, as a file that never was whole is; the process lives on."""
    path = write_ply(tmp_path / "a.ply", raw_columns(500, 0))
    whole = path.stat().st_size
    open_rows = plyrows.open_rows

    def cut(*arguments):
        rows = open_rows(*arguments)
        os.truncate(path, int(whole * left))
        return rows

    monkeypatch.setattr(plyrows, "open_rows", cut)
    line = refusal(path)
    assert re.search(f"ended at byte {int(whole * left)} while it was read, expected", line)
    assert "copy it again" in line


def test_every_cut_of_a_file_is_refused(tmp_path):
    """A file cut anywhere gives an error, never a scene and never another exception."""
    whole = write_ply(tmp_path / "a.ply", raw_columns(2, 0), after=[EXTRINSIC]).read_bytes()
    path = tmp_path / "cut.ply"
    for size in range(0, len(whole), 7):
        path.write_bytes(whole[:size])
        refusal(path)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    fmt=st.sampled_from([LITTLE, TEXT]),
    changes=st.lists(st.tuples(st.integers(0, 900), st.integers(0, 255)), min_size=1, max_size=4),
)
def test_changed_bytes_give_a_scene_or_a_line(tmp_path, fmt, changes):
    """Whatever bytes change, the result is a Scene of finite numbers or a one-line SceneError."""
    path = write_ply(tmp_path / "a.ply", raw_columns(2, 1), fmt=fmt, before=[FACE])
    content = bytearray(path.read_bytes())
    for place, value in changes:
        content[place % len(content)] = value
    path.write_bytes(content)
    line = ""
    try:
        scene = load_scene(path)
    except SceneError as error:
        line = str(error)
    else:
        assert np.isfinite(scene.means).all()
        assert np.isfinite(scene.sh).all()
    assert line.isprintable()


def test_not_files(tmp_path):
    """A missing file, a directory (with a hint at what is in it) and a pipe are told apart."""
    assert "no such file" in refusal(tmp_path / "none.ply")
    inner = tmp_path / "point_cloud" / "iteration_7"
    inner.mkdir(parents=True)
    (inner / "point_cloud.ply").touch()
    assert "is a directory; name a file in it, such as" in refusal(tmp_path)
    assert "iteration_7" in refusal(tmp_path)
    os.mkfifo(tmp_path / "pipe.ply")
    assert "not a regular file" in refusal(tmp_path / "pipe.ply")


def test_control_characters_in_the_name_are_not_shown(tmp_path):
    """A file name cannot send escape sequences to the terminal through an error."""
    refused = tmp_path / "a\x1b[2J\n.ply"
    with pytest.raises(SceneError) as caught:
        load_scene(refused)
    assert str(caught.value).isprintable()
