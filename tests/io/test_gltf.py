"""glTF with KHR_gaussian_splatting: containers, number types, nodes; faults; damage."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.io.gltfwriter import EXT, Builder, glb, one, random_arrays
from tests.io.loading import covariances, in_file_order, refusal, scene_or_line
from tests.io.mutate import altered, damaged
from tsplat.core.reference import rotations, sh_basis
from tsplat.io import curve, load_scene
from tsplat.io.turn import axes

quick = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
WORLD = np.diag([-1.0, -1.0, 1.0])  # left, up, forward are against x, against y, along z


def loaded(path, content, **options):
    path.write_bytes(content)
    return load_scene(path, sh_float32=True, **options)


def seen(scene, directions):
    """[D, N, 3] colours from ``directions``, before 0.5 is added."""
    basis = sh_basis(directions, scene.sh_degree)
    return np.einsum("dk,nkc->dnc", basis, scene.sh.astype(np.float64))


def agree(scene, arrays, matrix, shift=(0, 0, 0), scale=1.0):
    """The scene is ``arrays`` after an orthogonal ``matrix``, ``scale`` and ``shift``."""
    scene = in_file_order(scene)
    np.testing.assert_allclose(
        scene.means + scene.origin, scale * arrays["means"] @ matrix.T + np.asarray(shift),
        rtol=1e-5, atol=1e-5,
    )  # fmt: skip
    half = rotations(arrays["quats"]) * arrays["scales"][:, None].astype(np.float64)
    wanted = scale**2 * matrix @ (half @ half.transpose(0, 2, 1)) @ matrix.T
    np.testing.assert_allclose(covariances(scene), wanted, atol=2e-6 * scale**2)
    np.testing.assert_allclose(scene.opacities, arrays["opacities"], atol=1e-7)
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(7, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = np.einsum("dk,nkc->dnc", sh_basis(directions @ matrix, scene.sh_degree), arrays["sh"])
    np.testing.assert_allclose(seen(scene, directions), before, atol=1e-5)


@quick
@given(n=st.integers(1, 30), degree=st.integers(0, 3), seed=st.integers(0, 999), data=st.data())
def test_values_are_the_files_in_other_axes(tmp_path, n, degree, seed, data):
    """Any stride and offset, GLB, JSON with a buffer within or beside: x and y change sign."""
    arrays = random_arrays(n, degree, seed)
    layout = {
        "stride": 4 * data.draw(st.integers(0, 3)),
        "offset": 4 * data.draw(st.integers(0, 2)),
    }
    builder = one(arrays, **layout)
    kind = data.draw(st.sampled_from(["glb", "within", "beside"]))
    content = (
        builder.glb() if kind == "glb" else builder.gltf("b%20in" if kind == "beside" else None)
    )
    (tmp_path / "b in").write_bytes(builder.binary)
    scene = loaded(tmp_path / "a", content)
    assert (len(scene), scene.sh_degree, scene.source) == (n, degree, f"glTF, SH {degree}")
    agree(scene, arrays, WORLD)
    assert scene.antialias is None


@pytest.mark.parametrize(
    ("attribute", "kind", "column", "step"),
    [
        ("ROTATION", "i1", "quats", 1 / 127), ("ROTATION", "i2", "quats", 1 / 32767),
        ("SCALE", "u1", "scales", 1 / 255), ("SCALE", "u2", "scales", 1 / 65535),
        ("OPACITY", "u1", "opacities", 1 / 255), ("OPACITY", "u2", "opacities", 1 / 65535),
    ],
)  # fmt: skip
def test_normalised_integers(tmp_path, attribute, kind, column, step):
    """Each type that the extension allows, to half its step (of a rotation: before normalising)."""
    arrays = random_arrays(40, 0)
    arrays["scales"] = np.minimum(arrays["scales"], 1)
    scene = loaded(tmp_path / "a", one(arrays, kinds={attribute: (kind, True)}).glb())
    made = getattr(scene, column)
    if column == "quats":
        arrays["quats"] *= [1, -1, -1, 1]  # how x and y of the axes change it
        assert (
            np.abs(np.abs((made * arrays["quats"]).sum(1)) - 1).max() < 4 * (step / 2) ** 2 + 1e-6
        )
        assert np.abs(made - arrays["quats"]).max() < 2 * step  # rounding, then the length
    else:
        assert np.abs(made - arrays[column]).max() <= step / 2 + 1e-7


def test_nodes_move_turn_and_scale(tmp_path):
    """Matrices and translation, rotation, scale of parents and children, a mirror, two meshes."""
    builder = Builder()
    first, second, third = (random_arrays(8, d, seed=d) for d in (3, 1, 2))
    angle = 0.7
    quat = [0, np.sin(angle / 2), 0, np.cos(angle / 2)]
    inner = builder.node(
        builder.primitive(first), root=False, rotation=quat, translation=[1, 2, 3],
        scale=[2, 2, 2],
    )  # fmt: skip
    builder.node(children=[inner], translation=[10, 0, 0], rotation=[0, 0, 1, 0])
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    mirror[:3, 3] = 4, 5, 6
    builder.node(builder.primitive(second), matrix=mirror.T.ravel().tolist())
    builder.node(builder.primitive(third))
    scene = loaded(tmp_path / "a", builder.glb())
    assert (len(scene), scene.sh_degree) == (24, 3)
    c, s = np.cos(angle), np.sin(angle)
    about_y, about_z = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.diag([-1.0, -1.0, 1.0])
    agree(
        scene.take(np.arange(8)), first, WORLD @ about_z @ about_y,
        WORLD @ (about_z @ [1, 2, 3] + [10, 0, 0]), 2,
    )  # fmt: skip
    padded = {**second, "sh": np.pad(second["sh"], ((0, 0), (0, 12), (0, 0)))}
    agree(scene.take(np.arange(8, 16)), padded, WORLD @ mirror[:3, :3], WORLD @ [4, 5, 6])
    padded = {**third, "sh": np.pad(third["sh"], ((0, 0), (0, 7), (0, 0)))}
    agree(scene.take(np.arange(16, 24)), padded, WORLD)


def test_one_mesh_in_two_nodes_is_there_twice(tmp_path):
    """Instances are drawn each where its node is; without scenes, every root is drawn."""
    builder = one(random_arrays(3, 0))
    builder.root["nodes"].append({"mesh": 0, "translation": [0, 0, 100]})
    del builder.root["scenes"], builder.root["scene"]
    scene = loaded(tmp_path / "a", builder.glb())
    assert len(scene) == 6
    np.testing.assert_allclose(scene.means[3:] - scene.means[:3], [[0, 0, 100]] * 3, atol=1e-5)


def test_quaternions_of_any_length_in_a_turned_node(tmp_path):
    """As large and as small as float32 goes: they are turned before anything is rounded."""
    arrays = random_arrays(4, 0)
    unit = arrays["quats"].astype(np.float64)
    arrays["quats"] = np.array([[3e38, 0, 0, 0], [1e-45, 0, 0, 0], [2.5e38] * 4, unit[3]], "f4")
    (tmp_path / "a.glb").write_bytes(turned_by(arrays, [0.6, 0, 0, 0.8]))
    found = load_scene(tmp_path / "a.glb")
    arrays["quats"] = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [0.5] * 4, unit[3]], "f4")
    (tmp_path / "b.glb").write_bytes(turned_by(arrays, [0.6, 0, 0, 0.8]))
    np.testing.assert_allclose(found.quats, load_scene(tmp_path / "b.glb").quats, atol=1e-7)


def turned_by(arrays, rotation):
    """A file of one node."""
    builder = Builder()
    builder.node(builder.primitive(arrays), rotation=rotation)
    return builder.glb()


def test_a_scaled_node_far_away_keeps_its_detail(tmp_path):
    """Positions near 1e6 that are scaled and moved back are worked out in float64."""
    arrays = random_arrays(50, 0)
    arrays["means"] = (arrays["means"] + np.float32(1e6)).astype(np.float32)
    arrays["scales"][:] = 1e-4
    builder = Builder()
    builder.node(builder.primitive(arrays), scale=[0.1] * 3, translation=[-1e5] * 3)
    (tmp_path / "a.glb").write_bytes(builder.glb())
    scene = load_scene(tmp_path / "a.glb")
    wanted = (arrays["means"].astype(np.float64) * 0.1 - 1e5) * [-1, -1, 1]
    np.testing.assert_allclose(scene.means + scene.origin, wanted, atol=1e-6)


def test_a_scene_far_away_keeps_its_detail(tmp_path):
    """A node a million units away becomes the origin, not a loss of digits."""
    arrays = random_arrays(50, 0)
    builder = Builder()
    builder.node(builder.primitive(arrays), translation=[4e6, -5e6, 1e6])
    scene = loaded(tmp_path / "a", builder.glb())
    assert np.abs(scene.origin).max() > 1e6
    moved = scene.means + scene.origin - WORLD @ [4e6, -5e6, 1e6]
    np.testing.assert_allclose(moved, arrays["means"] @ WORLD, atol=2e-6)


def test_scales_of_the_draft_are_logarithms(tmp_path):
    """A negative size is none: then all are what the draft of 2025 says they are."""
    arrays = random_arrays(20, 0)
    logs = {**arrays, "scales": np.log(arrays["scales"])}
    scene = loaded(tmp_path / "a", one(logs).glb())
    np.testing.assert_allclose(scene.scales, arrays["scales"], rtol=1e-5)
    assert "scales are logarithms" in scene.source


def test_linear_colours_are_named(tmp_path):
    """A colour space that is drawn as if it were sRGB is told."""
    scene = loaded(tmp_path / "a", one(random_arrays(2, 0), space="lin_rec709_display").glb())
    assert scene.source == "glTF, SH 0, colours lin_rec709_display (drawn as they are)"


def test_many_rows_and_samples_over_several_primitives(tmp_path):
    """Rows along the curve and samples are those of all primitives, in the file's order."""
    n = curve.ROWS_MIN // 2
    builder = Builder()
    parts = [random_arrays(n, 0, seed) for seed in (1, 2, 3)]
    for arrays in parts:
        builder.node(builder.primitive(arrays))
    scene = loaded(tmp_path / "a", builder.glb())
    assert scene.numbers is not None
    wanted = np.concatenate([a["means"] for a in parts]) @ WORLD.astype(np.float32)
    assert (in_file_order(scene).means == wanted).all()
    some = loaded(tmp_path / "a", builder.glb(), max_splats=99)
    whole = {mean.tobytes(): i for i, mean in enumerate(wanted)}
    rows = [whole[mean.tobytes()] for mean in some.means]
    assert rows == sorted(rows)
    assert len(rows) == 99


def test_meshes_beside_splats_are_passed_over(tmp_path):
    """Triangles and cameras in the same file do not matter; alone they are named."""
    builder = one(random_arrays(2, 0))
    builder.node({"attributes": {"POSITION": 0}})
    builder.node(camera=0)
    assert len(loaded(tmp_path / "a", builder.glb())) == 2
    builder = Builder()
    builder.node({"attributes": {"POSITION": 0}})
    (tmp_path / "b").write_bytes(builder.glb())
    assert f"a glTF scene of 1 meshes, without {EXT}" in refusal(tmp_path / "b")


def test_raw_opacity_has_no_meaning(tmp_path):
    """The extension has one kind of opacities."""
    (tmp_path / "a").write_bytes(one(random_arrays(2, 0)).glb())
    assert "are always 0..1" in refusal(tmp_path / "a", raw_opacity=True)


def changed(*path, value=None):
    """A GLB with one value of its JSON replaced, or taken away if it is None."""
    builder = one(random_arrays(3, 1))
    builder.root["buffers"] = [{"byteLength": len(builder.binary)}]
    at = builder.root
    for key in path[:-1]:
        at = at[key]
    if value is None:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return glb(json.dumps(builder.root).encode(), builder.binary)


PRIMITIVE = ("meshes", 0, "primitives", 0)
GOOD = one(random_arrays(3, 1)).glb()
CASES = {
    "short": (b"glTF" + bytes(9), "GLB header: expected 20 bytes, got 13"),
    "version 1": (b"glTF\1" + bytes(40), r"GLB version 1 \(byte 4\), expected 2"),
    "cut": (GOOD[:-1], r"truncated: its header promises \d+ bytes, the file has \d+; copy"),
    "no json": (GOOD[:16] + b"BIN\0" + GOOD[20:], "whose first chunk .* is no JSON"),
    "long chunk": (GOOD[:12] + b"\xff\xff\xff\x7f" + GOOD[16:], "no JSON of 2147483647 bytes"),
    "no asset": (changed("asset"), "asset is missing"),
    "version 3": (changed("asset", "version", value="3.0"), "asset.version: expected glTF version"),
    "no scene": (changed("scene", value=4), "scene: expected less than 1, as many as scenes has"),
    "no node": (changed("scenes", 0, "nodes", value=[7]), r"nodes\[0\]: expected less than 1"),
    "own child": (changed("nodes", 0, "children", value=[0]), "has two parents, or is its own"),
    "no mesh": (changed("nodes", 0, "mesh", value=-1), "nodes.0..mesh: expected a whole number"),
    "stretched": (changed("nodes", 0, "scale", value=[1, 2, 1]), "stretches its splats by 1, 2, 1"),
    "flat": (changed("nodes", 0, "scale", value=[0, 0, 0]), "stretches its splats by 0, 0, 0"),
    "huge": (changed("nodes", 0, "scale", value=[1e300] * 3), "stretches its splats"),
    "sheared": (
        changed("nodes", 0, "matrix", value=[1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
        "expected one size for all",
    ),
    "short matrix": (changed("nodes", 0, "matrix", value=[1]), "matrix: expected a list of 16 num"),
    "no turn": (changed("nodes", 0, "rotation", value=[0, 0, 0, 0]), "a quaternion of length 1"),
    "mode": (changed(*PRIMITIVE, "mode", value=4), r"mode: expected 0 \(points\)"),
    "no opacity": (changed(*PRIMITIVE, "attributes", f"{EXT}:OPACITY"), "OPACITY is missing"),
    "no colour": (
        changed(*PRIMITIVE, "attributes", f"{EXT}:SH_DEGREE_0_COEF_0"), "DEGREE_0_COEF_0 is missing"
    ),
    "half a degree": (
        changed(*PRIMITIVE, "attributes", f"{EXT}:SH_DEGREE_1_COEF_1"), "DEGREE_1_COEF_1 is missing"
    ),
    "no accessor": (changed(*PRIMITIVE, "attributes", "POSITION", value=99), "expected less than"),
    "wrong type": (changed("accessors", 0, "type", value="VEC2"), "expected VEC3, got 'VEC2'"),
    "component": (changed("accessors", 0, "componentType", value=5130), "expected 5120 to 5126"),
    "count 0": (changed("accessors", 0, "count", value=0), "count: expected a whole number, 1 or"),
    "count": (changed("accessors", 0, "count", value=4), r"needs 48 bytes of .* which has 36"),
    "many": (changed("accessors", 0, "count", value=2**50), r"needs \d+ bytes of .* has 36"),
    "fewer": (changed("accessors", 0, "count", value=2), "its attributes have 2 to 3 rows"),
    "offset": (changed("accessors", 0, "byteOffset", value=4), "needs 40 bytes of"),
    "stride": (changed("bufferViews", 0, "byteStride", value=4), "byteStride is 4, expected 12 to"),
    "view": (changed("bufferViews", 0, "byteLength", value=10**9), "ends at byte 1000000000 of a"),
    "buffer": (changed("buffers", 0, "byteLength", value=10**9), "promises 1000000000 bytes"),
    "no buffer": (changed("bufferViews", 0, "buffer", value=1), "buffer: expected less than 1"),
    "sparse": (changed("accessors", 0, "sparse", value={}), "sparse accessors are not read"),
    "zeros": (changed("accessors", 0, "bufferView"), "sparse accessors are not read"),
    "network": (changed("buffers", 0, "uri", value="https://x/y"), "nothing is fetched from a net"),
    "up": (changed("buffers", 0, "uri", value="../a"), "the name of a file beside this one"),
    "encoded": (changed("buffers", 0, "uri", value="%2e%2e/a"), "the name of a file beside this"),
    "not there": (changed("buffers", 0, "uri", value="b.bin"), "names b.bin, which is not in the"),
    "no base64": (changed("buffers", 0, "uri", value="data:a;base64,x"), "data that is no base64"),
    "data": (changed("buffers", 0, "uri", value="data:a,x"), "expected data in base64"),
    "not json": (b'{"asset": {"version": "2.0"},', "JSON that cannot be read"),
    "deep": (b'{"asset": ' + b"[" * 200_000, "nested too deeply|cannot be read"),
    "large": (b'{"asset": "' + b"x" * (1 << 21) + b'"}', "bytes of JSON, expected at most 2097152"),
    "compressed": (
        changed(*PRIMITIVE, value={
            "attributes": {"POSITION": 0}, "mode": 0,
            "extensions": {EXT: {"extensions": {f"{EXT}_compression_spz_2": {"bufferView": 0}}}},
        }),
        "packed by KHR_gaussian_splatting_compression_spz_2, which is not read",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_refused_with_one_line(tmp_path, case):
    """Which value of the JSON or which byte, what was expected and what came, on one line."""
    content, expected = CASES[case]
    (tmp_path / "a.glb").write_bytes(content)
    line = refusal(tmp_path / "a.glb")
    assert re.search(expected, line), line


def test_a_file_that_names_its_rows_over_and_over(tmp_path):
    """Rows that many primitives share count each time: a small file makes no scene of millions."""
    builder = one(random_arrays(5000, 0))
    builder.root["meshes"][0]["primitives"] *= 400
    (tmp_path / "a").write_bytes(builder.glb())
    line = refusal(tmp_path / "a")
    assert re.search(r"primitives\[\d+\] and those before it promises \d+ Gaussians, a file", line)


def test_one_file_of_many_buffers_is_read_once(tmp_path):
    """However often a buffer's file is named, it takes its memory once."""
    import tracemalloc

    builder = one(random_arrays(2, 0))
    (tmp_path / "b").write_bytes(builder.binary + bytes(1 << 22))
    root = {**builder.root, "buffers": [{"byteLength": len(builder.binary), "uri": "b"}] * 50}
    for i, view in enumerate(root["bufferViews"]):
        view["buffer"] = 10 * i
    (tmp_path / "a").write_bytes(json.dumps(root).encode())
    tracemalloc.start()
    assert len(load_scene(tmp_path / "a")) == 2
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 << 22


def test_rows_that_cannot_be_drawn_are_counted(tmp_path):
    """Opacities beyond 1, and what is not finite, are left out by reason."""
    arrays = random_arrays(5, 1)
    arrays["opacities"][1], arrays["means"][2, 0] = 1.5, np.nan
    arrays["quats"][3], arrays["sh"][4, 2, 1] = 0, np.inf
    scene = loaded(tmp_path / "a", one(arrays).glb())
    assert dict(scene.dropped) == {
        "mean not finite": 1, "quaternion of length zero": 1, "opacity outside 0..1": 1,
        "colour not finite": 1,
    }  # fmt: skip


@settings(quick, max_examples=200)
@given(data=st.data())
def test_damage_gives_a_scene_or_a_line(tmp_path, data):
    """Bits, numbers and pieces of the file changed, or values of its JSON."""
    builder = Builder()
    inner = builder.node(builder.primitive(random_arrays(4, 1)), root=False, rotation=[0, 0, 1, 0])
    builder.node(builder.primitive(random_arrays(3, 2)), children=[inner], scale=[2, 2, 2])
    builder.root["buffers"] = [{"byteLength": len(builder.binary)}]
    kind = data.draw(st.sampled_from(["glb", "json", "text"]))
    if kind == "glb":
        content = data.draw(damaged(builder.glb()))
    elif kind == "json":
        content = builder.glb(data.draw(altered(builder.root)))
    else:
        content = data.draw(damaged(builder.gltf()))
    (tmp_path / "a").write_bytes(content)
    scene_or_line(tmp_path / "a")


def test_the_world_is_left_up_forward():
    """glTF's axes as its specification, 3.4, has them: y up, z forward, x to the left."""
    assert (axes("LUF") == WORLD).all()
