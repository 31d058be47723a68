"""Pictures on disk: what is read back is what the frame says, and faults are found early."""

from __future__ import annotations

import io
import os
import sys

import numpy as np
import pytest
from PIL import Image

from tsplat.core.camera import look_at
from tsplat.core.errors import OutputError
from tsplat.core.types import Frame
from tsplat.io import images, save_image
from tsplat.io.images import check_output, needs_depth, to_rgba, write_output

CAMERA = look_at([0, 0, -5], [0, 0, 0], [0, -1, 0], 50.0, 9, 7)


def frame(depth: bool = True, dtype=np.float32) -> Frame:
    """A picture with every alpha from 0 to 1, and colours above 1."""
    rng = np.random.default_rng(0)
    transmittance = rng.uniform(0, 1, (7, 9)).astype(dtype)
    transmittance[0] = 1
    transmittance[1] = 0
    colour = rng.uniform(0, 1.2, (7, 9, 3)).astype(dtype)
    rgb = colour * (1 - transmittance[..., None])
    return Frame(rgb, transmittance, rng.uniform(1, 2, (7, 9)).astype(dtype) if depth else None)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("suffix", [".png", ".webp", ".PNG"])
def test_opaque_pictures_are_exact(tmp_path, suffix, dtype):
    """PNG and WebP hold floor(clip(rgb + T background) 255 + 0.5), bit for bit."""
    picture = frame(dtype=dtype)
    path = tmp_path / f"a{suffix}"
    save_image(picture, path, (0.25, 0.5, 1.0))
    with Image.open(path) as image:
        assert image.mode == "RGB"
        pixels = np.asarray(image)
    wanted = picture.rgb + picture.transmittance[..., None] * np.array([0.25, 0.5, 1.0], dtype)
    np.testing.assert_array_equal(pixels, np.floor(np.clip(wanted, 0, 1) * dtype(255) + dtype(0.5)))


@pytest.mark.parametrize("suffix", [".png", ".webp"])
def test_transparent_pictures_are_straight(tmp_path, suffix):
    """Without a background alpha is kept, colour is divided by it; nothing drawn is all zeros."""
    picture = frame()
    path = tmp_path / f"a{suffix}"
    save_image(picture, path, None)
    with Image.open(path) as image:
        pixels = np.asarray(image)
    np.testing.assert_array_equal(pixels, to_rgba(picture))
    assert not pixels[0].any()
    assert (pixels[1, :, 3] == 255).all()
    over_black = pixels[..., :3] * (pixels[..., 3:] / 255)
    inside = (picture.rgb / np.maximum(1 - picture.transmittance, 1e-9)[..., None] <= 1).all(2)
    assert np.abs(over_black - picture.rgb * 255)[inside].max() <= 1.0


def test_jpeg(tmp_path):
    """A smooth picture comes back within a few levels; transparency is refused."""
    ramp = np.linspace(0, 1, 64, dtype=np.float32)
    smooth = Frame(np.tile(ramp[None, :, None], (64, 1, 3)), np.zeros((64, 64), np.float32))
    for suffix in (".jpg", ".jpeg"):
        save_image(smooth, tmp_path / f"a{suffix}")
        with Image.open(tmp_path / f"a{suffix}") as image:
            assert np.abs(np.asarray(image) - smooth.to_uint8().astype(int)).max() <= 4
    with pytest.raises(OutputError, match="JPEG has no transparency; choose a background"):
        save_image(smooth, tmp_path / "a.jpg", None)


def test_npy_is_premultiplied_float32(tmp_path):
    """[H, W, 4]: rgb as in the frame, alpha 1 - transmittance, no background, nothing clipped."""
    picture = frame(dtype=np.float64)
    save_image(picture, tmp_path / "a.npy", (1, 1, 1))
    stored = np.load(tmp_path / "a.npy")
    assert stored.dtype == np.float32
    assert stored.shape == (7, 9, 4)
    np.testing.assert_array_equal(stored[..., :3], picture.rgb.astype(np.float32))
    np.testing.assert_array_equal(stored[..., 3], (1 - picture.transmittance).astype(np.float32))


def test_npz_holds_frame_and_camera(tmp_path):
    """Every array of the frame and everything a camera is made of comes back, bit for bit."""
    picture = frame()
    write_output(str(tmp_path / "a.npz"), picture, CAMERA, (0, 0, 0))
    with np.load(tmp_path / "a.npz") as stored:
        for name in ("rgb", "transmittance", "depth"):
            np.testing.assert_array_equal(stored[name], getattr(picture, name))
        for name in ("viewmat", "K", "width", "height", "near", "far"):
            np.testing.assert_array_equal(stored[name], getattr(CAMERA, name))
    assert needs_depth("a.npz")
    assert not needs_depth("a.npy")
    with pytest.raises(OutputError, match=r"a.npz: .npz holds depth .* without depth"):
        write_output(str(tmp_path / "a.npz"), frame(depth=False), CAMERA, None)
    with pytest.raises(OutputError, match="without a camera"):
        save_image(picture, tmp_path / "a.npz")


class Stdout(io.TextIOWrapper):
    terminal = False

    def isatty(self) -> bool:
        return self.terminal


def test_standard_output(monkeypatch):
    """``-`` writes a PNG into a pipe and refuses a terminal."""
    stdout = Stdout(io.BytesIO())
    monkeypatch.setattr(sys, "stdout", stdout)
    write_output("-", frame(), CAMERA, (0, 0, 0))
    with Image.open(io.BytesIO(stdout.buffer.getvalue())) as image:
        np.testing.assert_array_equal(np.asarray(image), frame().to_uint8())
    monkeypatch.setattr(Stdout, "terminal", True)
    with pytest.raises(OutputError, match="standard output is a terminal; redirect it"):
        check_output("-")


def test_faults_are_found_before_rendering(tmp_path):
    """Suffix, directory, and what is there already are checked without a frame."""
    check_output(str(tmp_path / "a.png"))
    with pytest.raises(OutputError, match=r"unknown suffix '.gif'; known: .png, .jpg, .*, or -"):
        check_output(str(tmp_path / "a.gif"))
    with pytest.raises(OutputError, match="unknown suffix ''"):
        check_output("/dev/null")
    with pytest.raises(OutputError, match=r"no directory .*none; create it first"):
        check_output(str(tmp_path / "none" / "a.png"))
    (tmp_path / "b.png").mkdir()
    with pytest.raises(OutputError, match="exists and is not a regular file"):
        check_output(str(tmp_path / "b.png"))
    with pytest.raises(OutputError) as caught:
        check_output("\x1b[2J.gif")
    assert str(caught.value).isprintable()


def test_a_directory_that_may_not_be_written(tmp_path, monkeypatch):
    """No permission is found before rendering too."""
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match="no permission to write in"):
        check_output(str(tmp_path / "a.png"))


def test_what_is_there_stays_until_the_new_file_is_whole(tmp_path, monkeypatch):
    """A disk that fills up leaves the old file and no other, and the line says so."""
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def full(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(OutputError, match=r"a\.png: cannot be written: No space left on device"):
        save_image(frame(), path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    assert path.read_bytes() == b"old"


def test_mode_and_links(tmp_path):
    """A new file has the mode the umask asks for; a link stays a link."""
    (tmp_path / "place").mkdir()
    link = tmp_path / "link.png"
    link.symlink_to(tmp_path / "place" / "real.png")
    before = os.umask(0o027)
    try:
        save_image(frame(), link)
    finally:
        os.umask(before)
    assert link.is_symlink()
    assert (tmp_path / "place" / "real.png").stat().st_mode & 0o777 == 0o640


def test_what_pillow_refuses_is_an_output_error(tmp_path):
    """A picture too wide for WebP is refused with Pillow's reason behind the path."""
    wide = Frame(np.zeros((1, 20_000, 3), np.float32), np.ones((1, 20_000), np.float32))
    with pytest.raises(OutputError, match=r"a\.webp: Pillow cannot write it: "):
        save_image(wide, tmp_path / "a.webp")
    assert images.encode(".png", wide, None, None).startswith(b"\x89PNG")
