"""load_scene beyond PLY: which reader reads, and what foreign files are told."""

from __future__ import annotations

import gzip
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

import tsplat.io
from tests.io import gltfwriter, sogwriter, spzwriter
from tests.io.plywriter import raw_columns, write_ply
from tsplat import plugins
from tsplat.core.errors import SceneError
from tsplat.io import load_scene, progress, scene_from_arrays
from tsplat.io.base import Reader


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.bin", gzip.compress(b"something", mtime=0), "gzip-compressed file; unpack it"),
        ("a.spz", gzip.compress(b"something", mtime=0), "damaged: named .spz, but it begins"),
        ("a.sog", b"PK\x03\x04 cut", "damaged: named .sog, but it is no zip archive with a meta"),
        ("a.glb", b"no", "unknown format: named .glb, but it does not begin with 'glTF'"),
        ("lod-meta.json", b'{"lodLevels": 7}', "name the folder of one of them"),
        ("a.zip", b"PK\x03\x04" + bytes(30), "zip archive"),
        ("a.splat", bytes(64), "unknown format: named .splat, but its first rows of 32 bytes"),
        ("a.ksplat", bytes(99), "unknown format: named .ksplat, but its first 4096 bytes are no"),
        ("a.ply", b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("a.ply", b"\n<!DOCTYPE html>", "web page"),
        ("a.txt", b"hello", "unknown format"),
    ],
)
def test_foreign_files_are_named(tmp_path, name, content, expected):
    """Formats that are not read are told apart by their bytes, each with what to do."""
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert expected in str(caught.value)
    assert "formats read: compressed-ply, gltf, ksplat, ply, sog, splat, spz" in str(caught.value)
    assert str(caught.value).isprintable()


def _reader(name, recognises, read) -> Reader:
    return Reader(name=name, summary="", recognises=recognises, load=lambda: read)


def test_names_do_not_matter(tmp_path):
    """Files of each format are read whatever they are called."""
    contents = [
        spzwriter.packed(2, 2, 0, spzwriter.random_planes(2, 2, 0)),
        sogwriter.bundle(*sogwriter.random_scene(2, 0)[:2]),
        gltfwriter.one(gltfwriter.random_arrays(2, 0)).glb(),
        gltfwriter.one(gltfwriter.random_arrays(2, 0)).gltf(),
        write_ply(tmp_path / "a", raw_columns(2, 0)).read_bytes(),
    ]
    for content in contents:
        for name in ("a.ply", "a.spz", "a.sog", "a.glb", "a"):
            (tmp_path / name).write_bytes(content)
            scene = load_scene(tmp_path / name)
            assert (len(scene), bool(scene.source)) == (2, True)


@pytest.fixture
def with_reader(monkeypatch):
    """Installs one more reader."""

    def install(reader: Reader) -> None:
        registry = plugins.find_plugins()
        registry.readers[reader.name] = reader
        monkeypatch.setattr(plugins, "plugins", lambda: registry)

    return install


def test_a_guess_is_asked_last(tmp_path, with_reader):
    """A plugin's reader that knows its format comes before built-in ones that guess."""
    from tests.io.splatwriter import drawn, write_splat

    write_splat(tmp_path / "a.bin", drawn(200))
    assert load_scene(tmp_path / "a.bin").source == ".splat"

    def read(path, options):
        return scene_from_arrays([[1, 2, 3]], [[1, 0, 0, 0]], [[1, 1, 1]], [1], [[0, 0, 0]])

    with_reader(_reader("mine", lambda start: True, read))
    assert load_scene(tmp_path / "a.bin").source == "mine"


def test_a_plugins_reader_reads_what_it_recognises(tmp_path, with_reader):
    """A third-party row is asked with the file's first bytes and reads the file."""
    seen = []

    def recognises(start: bytes) -> bool:
        seen.append(start)
        return start.startswith(b"XYZ")

    def read(path, options):
        numbers = [float(n) for n in path.read_bytes()[3:].split()]
        return scene_from_arrays([numbers], [[1, 0, 0, 0]], [[1, 1, 1]], [1], [[0, 0, 0]])

    with_reader(_reader("xyz", recognises, read))
    path = tmp_path / "a.xyz"
    path.write_bytes(b"XYZ 1 2 3" + b" " * 9000)
    assert load_scene(path).means.tolist() == [[1, 2, 3]]
    assert [len(s) for s in seen] == [4096]


def test_a_reader_that_fails_to_answer_is_reported(tmp_path, with_reader):
    """An exception in ``recognises`` costs that reader its turn and is named."""
    with_reader(_reader("bad", lambda start: 1 / 0, None))
    assert len(load_scene(write_ply(tmp_path / "a.ply", raw_columns(1, 0)))) == 1
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(SceneError, match="reader 'bad' failed: division by zero"):
        load_scene(tmp_path / "a.txt")


def test_a_reader_without_memory_says_what_to_do(tmp_path, with_reader):
    """MemoryError becomes a line that names the setting that helps."""

    def read(path, options):
        raise MemoryError

    with_reader(_reader("big", lambda start: start == b"big", read))
    (tmp_path / "a").write_text("big")
    with pytest.raises(SceneError, match=r"not enough memory .*\(--max-splats\)"):
        load_scene(tmp_path / "a")


def test_importing_costs_nothing_heavy():
    """tsplat.io and the rows of its readers import no plyfile, rich, Pillow, zip or zstd."""
    code = (
        "import sys, tsplat.io; from tsplat.io import ply, spz, sog, gltf\n"
        "for m in (ply, spz, sog, gltf): m.tsplat_readers()\n"
        "heavy = ('plyfile', 'rich', 'PIL', 'zipfile', 'backports', 'pluggy._tracing')\n"
        "print([m for m in heavy if m in sys.modules])"
    )
    root = Path(tsplat.io.__file__).parents[2]
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root
    )
    assert json.loads(run.stdout.replace("'", '"')) in ([], ["pluggy._tracing"])


class FakeTerminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_shown_late_and_on_a_terminal_only(monkeypatch):
    """Nothing in a pipe, nothing before the delay; a bar with the label after it."""
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with progress.progress_bar("a.ply", delay=0) as show:
        show(1, 2)
    assert pipe.getvalue() == ""
    terminal = FakeTerminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress.progress_bar("a.ply", delay=60) as show:
        show(1, 2)
    assert terminal.getvalue() == ""
    monkeypatch.setenv("TERM", "xterm")
    with progress.progress_bar("[red]a\x1b[2J.ply", delay=0) as show:
        show(1, 2)
        show(2, 2)
    assert "[red]a" in terminal.getvalue()
    assert "a\x1b[2J.ply" not in terminal.getvalue()


def test_progress_ends_with_an_exception(monkeypatch):
    """The bar is taken down when loading fails, and the exception passes."""
    monkeypatch.setattr(sys, "stderr", FakeTerminal())

    def fail() -> None:
        with progress.progress_bar("a", delay=0) as show:
            show(0, 1)
            raise SceneError("x")

    with pytest.raises(SceneError, match="x"):
        fail()
