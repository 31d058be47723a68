"""libsixel and libchafa called in this process, as tsplat's presenters are: no program to start.

The libraries are those that img2sixel and chafa are made of; each function takes [H, W, 3] bytes.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_float, c_int, c_size_t, c_void_p

import numpy as np

from tsplat.core.types import U8

COLORS = 256
SIXEL_RGB = 3  # SIXEL_PIXELFORMAT_RGB888
NO_DIFFUSION = 1  # SIXEL_DIFFUSE_NONE
CHAFA_RGB = 8  # CHAFA_PIXEL_RGB8
CHAFA_MODES = {"symbols": 0, "sixel": 1, "kitty": 2, "iterm2": 3}  # CHAFA_PIXEL_MODE_
CHAFA_COLORS = {1 << 24: 0, 256: 1, 16: 3}  # CHAFA_CANVAS_MODE_


def _library(name: str) -> ctypes.CDLL | None:
    found = ctypes.util.find_library(name)
    return ctypes.CDLL(found) if found else None


def libsixel(diffusion: bool = True) -> Callable[[U8], bytes] | None:
    """Its encoder with a palette of the picture's own; None if it is not installed."""
    lib = _library("sixel")
    if lib is None:
        return None
    writer = ctypes.CFUNCTYPE(c_int, c_void_p, c_int, c_void_p)
    parts: list[bytes] = []

    @writer
    def write(data: int, size: int, _: object) -> int:
        parts.append(ctypes.string_at(data, size))
        return size

    def encode(image: U8) -> bytes:
        parts.clear()
        height, width = image.shape[:2]
        pixels = image.tobytes()  # libsixel diffuses in place: a copy of our own
        output, dither = c_void_p(), c_void_p()
        for status in (
            lib.sixel_output_new(byref(output), write, None, None),
            lib.sixel_dither_new(byref(dither), COLORS, None),
            lib.sixel_dither_initialize(dither, pixels, width, height, SIXEL_RGB, 0, 0, 0),
        ):
            if status & 0x1000:
                raise OSError(f"libsixel: {status:#x}")
        if not diffusion:
            lib.sixel_dither_set_diffusion_type(dither, NO_DIFFUSION)
        if lib.sixel_encode(pixels, width, height, 3, dither, output) & 0x1000:
            raise OSError("libsixel: sixel_encode")
        lib.sixel_dither_unref(dither)
        lib.sixel_output_unref(output)
        return b"".join(parts)

    return encode


class _String(ctypes.Structure):
    """GString of GLib."""

    _fields_ = [("text", c_void_p), ("length", c_size_t), ("room", c_size_t)]


def libchafa(
    mode: str,
    columns: int,
    rows: int,
    cell: tuple[int, int],
    symbols: str = "",
    colors: int = 1 << 24,
) -> Callable[[U8], bytes] | None:
    """Its canvas of that many cells of ``cell`` px; None if it is not installed."""
    lib, glib = _library("chafa"), _library("glib-2.0")
    if lib is None or glib is None:
        return None
    for name in (
        "chafa_canvas_config_new", "chafa_symbol_map_new", "chafa_canvas_new",
        "chafa_term_db_get_default", "chafa_term_db_get_fallback_info",
    ):  # fmt: skip
        getattr(lib, name).restype = c_void_p
    lib.chafa_canvas_print.restype = POINTER(_String)
    config = c_void_p(lib.chafa_canvas_config_new())
    lib.chafa_canvas_config_set_geometry(config, columns, rows)
    lib.chafa_canvas_config_set_cell_geometry(config, *cell)
    lib.chafa_canvas_config_set_pixel_mode(config, CHAFA_MODES[mode])
    lib.chafa_canvas_config_set_canvas_mode(config, CHAFA_COLORS[colors])
    lib.chafa_canvas_config_set_work_factor(config, c_float(0.5))  # as the program does
    if symbols:
        chars = c_void_p(lib.chafa_symbol_map_new())
        lib.chafa_symbol_map_apply_selectors(chars, c_char_p(symbols.encode()), None)
        lib.chafa_canvas_config_set_symbol_map(config, chars)
    info = c_void_p(lib.chafa_term_db_get_fallback_info(c_void_p(lib.chafa_term_db_get_default())))

    def encode(image: U8) -> bytes:
        height, width = image.shape[:2]
        canvas = c_void_p(lib.chafa_canvas_new(config))
        pixels = np.ascontiguousarray(image)
        lib.chafa_canvas_draw_all_pixels(
            canvas, CHAFA_RGB, c_void_p(pixels.ctypes.data), width, height, 3 * width
        )
        text = lib.chafa_canvas_print(canvas, info)
        data = ctypes.string_at(text.contents.text, text.contents.length)
        glib.g_string_free(text, 1)
        lib.chafa_canvas_unref(canvas)
        return data

    return encode
