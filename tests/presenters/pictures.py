"""Frames to present: photo-like, odd-sized, and their 8-bit pixels."""

import numpy as np

from tsplat.core.types import Frame


def photo(width=640, height=360, seed=1, noise=3.0):
    """Gradients, shapes, stripes as fine as text and sensor noise, as [H, W, 3] uint8."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    u, v = x / max(width, 1), y / max(height, 1)
    rgb = np.stack([255 * u, 255 * v, 255 - 255 * u * v], -1)
    rgb *= 0.75 + 0.25 * np.cos(9 * u + 4 * v * v)[..., None]
    rgb[(u > 0.1) & (u < 0.3) & (v > 0.2) & (v < 0.45)] = 230, 60, 30
    ball = (x - 0.7 * width) ** 2 + (y - 0.5 * height) ** 2
    radius = (0.22 * height) ** 2
    shade = np.clip(1 - ball / max(radius, 1e-9), 0, 1)[..., None]
    rgb = np.where((ball < radius)[..., None], np.array([30, 200, 80]) * (0.4 + 0.6 * shade), rgb)
    text = (v > 0.75) & (v < 0.9) & (u > 0.15) & (u < 0.6)
    strokes = ((x.astype(int) * 7 + y.astype(int) * 3) % 11 < 3) & (y.astype(int) % 12 < 8)
    rgb[text & strokes] = 245, 245, 235
    rgb += np.random.default_rng(seed).normal(0, noise, (height, width, 1))
    return rgb.clip(0, 255).astype(np.uint8)


def frame_of(pixels):
    """The frame whose ``to_uint8`` is ``pixels``."""
    rgb = np.ascontiguousarray(pixels, np.float32) / np.float32(255)
    return Frame(rgb, np.zeros(rgb.shape[:2], np.float32))


def psnr(a, b):
    """Peak signal to noise ratio of 8-bit pictures, dB; inf when equal."""
    error = np.mean((np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2)
    return float("inf") if error == 0 else 10 * np.log10(255**2 / error)
