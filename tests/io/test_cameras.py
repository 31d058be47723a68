"""Camera files: tsplat's own and INRIA's."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.io.realdata import DATA, needs_data
from tsplat.core.camera import Camera, look_at
from tsplat.core.errors import CameraError
from tsplat.io import load_cameras
from tsplat.io.cameras import (
    camera_from_json,
    camera_to_json,
    cameras_beside,
    load_camera,
    load_rotations,
    parse_camera_spec,
)

CAMERA = look_at([1, 2, -5], [0.25, 0, 0.5], [0, -1, 0.1], 47.0, 64, 48, 0.5, 99.0)
OWN = camera_to_json(CAMERA)
INRIA = {
    "id": 0, "img_name": "a", "width": 40, "height": 20, "position": [1, 2, 3],
    "rotation": [[0, 0, 1], [1, 0, 0], [0, 1, 0]], "fx": 30.0, "fy": 31,
}  # fmt: skip


def same(a: Camera, b: Camera) -> bool:
    sizes = ("width", "height", "near", "far")
    return (
        np.array_equal(a.viewmat, b.viewmat)
        and np.array_equal(a.K, b.K)
        and all(getattr(a, s) == getattr(b, s) for s in sizes)
    )


@given(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), st.floats(1, 179))
def test_own_format_keeps_every_bit(eye, fov):
    """Written and read again, a camera is the same to the last bit."""
    camera = look_at(np.add(eye, [0, 0, 3e6]), eye, [0, -1, 0], fov, 31, 17)
    assert same(camera_from_json(json.loads(json.dumps(camera_to_json(camera)))), camera)


def test_one_object_or_a_list(tmp_path):
    """A file may hold one camera or a list of them; near and far may be left out."""
    path = tmp_path / "c.json"
    path.write_text(json.dumps(OWN))
    assert [same(c, CAMERA) for c in load_cameras(path)] == [True]
    short = {k: v for k, v in OWN.items() if k not in ("near", "far")}
    path.write_text("\ufeff" + json.dumps([OWN, short]))
    assert [c.near for c in load_cameras(path)] == [0.5, 0.01]


def test_inria_position_is_the_centre_and_rotation_camera_to_world():
    """The camera's axes in the world are the columns of rotation; the centre is position."""
    camera = camera_from_json(INRIA)
    np.testing.assert_allclose(camera.centre, [1, 2, 3], atol=1e-12)
    axis_in_world = np.array(INRIA["rotation"])[:, 2]
    np.testing.assert_allclose(camera.rotation @ axis_in_world, [0, 0, 1])
    ahead = camera.viewmat @ [*(np.array([1, 2, 3]) + 5 * axis_in_world), 1]
    np.testing.assert_allclose(ahead, [0, 0, 5, 1], atol=1e-12)
    assert camera.K.tolist() == [[30, 0, 20], [0, 31, 10], [0, 0, 1]]


def transforms(**words):
    """A transforms.json of one frame, whose camera stands at 1, 2, 3 and looks along +x, z up."""
    placed = [[0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]
    frame = {"file_path": "a.png", "transform_matrix": placed}
    return {"w": 40, "h": 20, "fl_x": 30, "fl_y": 31, "frames": [frame]} | words


def test_transforms_json(tmp_path):
    """Nerfstudio's: OpenGL's cameras, which look along -z with y up; the principal point counts."""
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(transforms(cx=19, cy=11)))
    (camera,) = load_cameras(path)
    np.testing.assert_allclose(camera.centre, [1, 2, 3])
    np.testing.assert_allclose(camera.rotation @ [1, 0, 0], [0, 0, 1])  # ahead
    np.testing.assert_allclose(camera.rotation @ [0, 0, 1], [0, -1, 0])  # up
    assert camera.K.tolist() == [[30, 0, 19], [0, 31, 11], [0, 0, 1]]
    assert (camera.width, camera.height) == (40, 20)


def test_transforms_json_with_an_angle(tmp_path):
    """Blender's: the horizontal field of view; a frame's own numbers count more."""
    path = tmp_path / "transforms.json"
    data = transforms(camera_angle_x=np.pi / 2)
    del data["fl_x"], data["fl_y"]
    data["frames"].append({**data["frames"][0], "fl_x": 7, "w": 10})
    path.write_text(json.dumps(data))
    wide, own = load_cameras(path)
    np.testing.assert_allclose(wide.K, [[20, 0, 20], [0, 20, 10], [0, 0, 1]])
    assert own.K.tolist() == [[7, 0, 5], [0, 7, 10], [0, 0, 1]]


def test_transforms_json_in_the_world_that_was_trained_in(tmp_path):
    """What nerfstudio did to cameras before it trained is done here, too: turned, then scaled."""
    (tmp_path / "transforms.json").write_text(json.dumps(transforms()))
    turn = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7]]
    words = json.dumps({"transform": turn, "scale": 0.5})
    (tmp_path / "dataparser_transforms.json").write_text(words)
    (camera,) = load_cameras(tmp_path / "transforms.json")
    np.testing.assert_allclose(camera.centre, [(5 - 2) / 2, (6 + 1) / 2, (7 + 3) / 2])
    np.testing.assert_allclose(camera.rotation @ [0, 1, 0], [0, 0, 1])  # +x has become +y


def refused(load, path, data, text):
    """``load`` refuses a file of ``data`` with this."""
    path.write_text(json.dumps(data))
    with pytest.raises(CameraError, match=text):
        load(path)


BAD_TRANSFORMS = {
    "frames: expected a list of at least one": transforms(frames=[]),
    "frame 0: expected an object, got int": transforms(frames=[3]),
    "frame 0: lacks transform_matrix": transforms(frames=[{}]),
    "frame 0: lacks w": {k: v for k, v in transforms().items() if k != "w"},
    "frame 0: lacks fl_x; expected that or": {k: v for k, v in transforms().items() if k != "fl_x"},
    "frame 0: h: expected a whole number": transforms(h="20"),
    "transform_matrix: expected 4 x 4 numbers": transforms(frames=[{"transform_matrix": [1]}]),
    "orthonormal": transforms(frames=[{"transform_matrix": (2 * np.eye(4)).tolist()}]),
}


@pytest.mark.parametrize("text", BAD_TRANSFORMS)
def test_bad_transforms(tmp_path, text):
    """The frame and what is wrong with it are named."""
    path = tmp_path / "transforms.json"
    refused(load_cameras, path, BAD_TRANSFORMS[text], text)
    (tmp_path / "dataparser_transforms.json").write_text("{}")
    refused(load_cameras, path, transforms(), "lacks transform or scale")


def test_rotations_alone_are_the_cameras(tmp_path):
    """Of every kind of file, and of frames in a world of their own."""
    names = {
        "own.json": [OWN, OWN], "one.json": OWN, "inria.json": [INRIA, INRIA],
        "mixed.json": [OWN, INRIA], "transforms.json": transforms(),
    }  # fmt: skip
    turn = [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7]]
    words = json.dumps({"transform": turn, "scale": 0.5})
    (tmp_path / "dataparser_transforms.json").write_text(words)
    for name, data in names.items():
        (tmp_path / name).write_text(json.dumps(data))
        wanted = np.stack([camera.rotation for camera in load_cameras(tmp_path / name)])
        np.testing.assert_array_equal(load_rotations(tmp_path / name), wanted, name)


BAD_ROTATIONS = {
    "expected rotation in every entry, 3 x 3": [INRIA, {**INRIA, "rotation": [[1], [2, 3]]}],
    "rotation: expected 3 x 3 numbers": [{**INRIA, "rotation": [[1, 2], [3, 4]]}],
    "expected rotations, but rows are off orthonormal by 3;": [
        INRIA,
        {**INRIA, "rotation": (2 * np.eye(3)).tolist()},
    ],
    "an empty list, expected": [],
    "frames: expected a list of at least one camera": {"frames": 7},
    "expected transform_matrix in every entry, 4 x 4": transforms(frames=[{}]),
    "rotation: expected 3 x 3 numbers in every": [{**INRIA, "rotation": [["1"] * 3] * 3}],
    "off orthonormal by": transforms(frames=[{"transform_matrix": [[1e308] * 4] * 4}]),
    "expected an object, got int": [7],
}


@pytest.mark.parametrize("text", BAD_ROTATIONS)
def test_bad_rotations(tmp_path, text):
    """One line, and no other exception."""
    refused(load_rotations, tmp_path / "cameras.json", BAD_ROTATIONS[text], text)


def test_cameras_lie_beside_or_above(tmp_path):
    """INRIA's two folders above the scene, or beside; the nearest counts, cameras.json first."""
    scene = tmp_path / "point_cloud" / "iteration_7" / "point_cloud.ply"
    scene.parent.mkdir(parents=True)
    assert cameras_beside(scene) is None
    for file in (
        tmp_path / "cameras.json", scene.parent / "transforms.json", scene.parent / "cameras.json",
    ):  # fmt: skip
        file.write_text("[]")
        assert cameras_beside(scene) == file


@needs_data
def test_a_real_cameras_json():
    """The 97 cameras of a published scene load; centres are the positions in the file."""
    path = DATA / "snowmiku" / "cameras.json"
    cameras = load_cameras(path)
    entries = json.loads(path.read_text())
    assert len(cameras) == len(entries) == 97
    for camera, entry in zip(cameras, entries, strict=True):
        np.testing.assert_allclose(camera.centre, entry["position"], atol=1e-9)
        assert camera.K[0, 0] == entry["fx"]


@pytest.mark.parametrize(
    ("spec", "expected"),
    [("a.json#0", ("a.json", 0)), ("a#b.json#12", ("a#b.json", 12)), ("a.json", ("a.json", 0))],
)
def test_camera_spec(spec, expected):
    """FILE#INDEX is split at the last #; a FILE alone is its first camera."""
    assert parse_camera_spec(spec) == expected


@pytest.mark.parametrize("spec", ["#1", "a#", "a#-1", "a#x", "a#1.0", "", "a#²", "a#" + "9" * 99])
def test_bad_camera_spec(spec):
    """Anything but a whole number is refused with an example."""
    with pytest.raises(CameraError, match=r"expected FILE#INDEX .* such as cameras.json#0"):
        parse_camera_spec(spec)


def test_index_out_of_range(tmp_path):
    """An index past the end is told how many cameras there are."""
    path = tmp_path / "c.json"
    path.write_text(json.dumps([OWN, INRIA]))
    assert load_camera(f"{path}#1").width == 40
    with pytest.raises(CameraError, match="no camera 2; it has 2, #0 to #1"):
        load_camera(f"{path}#2")


BAD = {
    "": "not a JSON file",
    "[": "not a JSON file",
    "[" * 100_000: "not a JSON file",
    "[]": "an empty list",
    "[3]": "camera 0: expected an object, got int",
    "null": "camera 0: expected an object, got NoneType",
    json.dumps([OWN, {}]): "camera 1: lacks width, height, viewmat, K; expected .* or INRIA's",
    json.dumps(INRIA | {"fx": "30"}): "fx: expected a number, got '30'",
    json.dumps({k: v for k, v in INRIA.items() if k != "fx"}): "lacks fx",
    json.dumps(INRIA | {"rotation": [1, 2, 3]}): "rotation: expected 3 x 3 numbers",
    json.dumps(INRIA | {"rotation": [[2, 0, 0], [0, 2, 0], [0, 0, 2]]}): "orthonormal",
    json.dumps(INRIA | {"position": [1, 2]}): "position: expected 3 numbers",
    json.dumps(INRIA | {"position": [1, 2, True]}): "position: expected 3 numbers",
    json.dumps(INRIA | {"position": [1, 2, 10**400]}): "within the range of float64",
    json.dumps(INRIA | {"width": 1.5}): "width: expected a whole number, got 1.5",
    json.dumps(INRIA | {"width": True}): "width: expected a whole number",
    json.dumps(INRIA | {"width": "\x1b[2J"}): "width: expected a whole number",
    json.dumps(INRIA | {"width": 0}): "expected a size from 1x1",
    json.dumps(INRIA | {"width": 10**9, "height": 10**9}): "expected a size from 1x1",
    json.dumps(INRIA | {"fx": float("nan")}): "has NaN, which is not JSON",
    json.dumps(OWN | {"far": float("inf")}): "has Infinity, which is not JSON",
    json.dumps(OWN | {"near": -1}): "expected 0 < near < far",
    json.dumps(OWN | {"fx": 1e999}): "has Infinity",
    '{"width": 1e999}': "lacks height",
    json.dumps(INRIA).replace("40", "1e999"): "width: expected a whole number, got inf",
}


@pytest.mark.parametrize("text", BAD, ids=lambda t: t[:40])
def test_bad_camera_files(tmp_path, text):
    """One printable line: the file, the camera's index, what was expected, what came."""
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(CameraError, match=BAD[text]) as caught:
        load_cameras(path)
    assert str(caught.value).isprintable()


def test_camera_files_that_are_none(tmp_path, monkeypatch):
    """Missing, a directory, not UTF-8 and too large are told apart."""
    with pytest.raises(CameraError, match="no such file"):
        load_cameras(tmp_path / "none.json")
    with pytest.raises(CameraError, match="is a directory"):
        load_cameras(tmp_path)
    path = tmp_path / "c.json"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CameraError, match="not a JSON file"):
        load_cameras(path)
    monkeypatch.setattr("tsplat.io.cameras.SIZE_MAX", 2)
    with pytest.raises(CameraError, match="more than 2 bytes, too large"):
        load_cameras(path)
