"""Errors that name what was expected, what came, and what to do. Each is its builtin kind too."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import DTypeLike, NDArray


class TsplatError(Exception):
    """Base of every error tsplat raises on purpose. Its text is fit to show to a user."""


class SceneError(TsplatError, ValueError):
    """A scene's arrays or file are not what they must be."""


class CameraError(TsplatError, ValueError):
    """A camera that no picture can be made with, or a camera file that cannot be read."""


class ParamsError(TsplatError, ValueError):
    """A setting outside its range."""


class PluginError(TsplatError, LookupError):
    """A backend, presenter or reader that is not there, or cannot do what is asked."""


class KernelError(TsplatError, RuntimeError):
    """A kernel refused its input; backends check first, so this is a defect of the caller."""


class TerminalError(TsplatError, OSError):
    """No terminal to show a picture on, or one that cannot."""


class OutputError(TsplatError, OSError):
    """A file that cannot be written."""


class ContractError(TsplatError, AssertionError):
    """A backend's result is not the contract's."""


def printable(text: object, limit: int = 200) -> str:
    """Text of unknown origin, safe to show: no control characters, at most ``limit`` long."""
    shown = str(text)
    if not shown.isprintable():
        shown = "".join(c if c.isprintable() else "�" for c in shown)
    return shown if len(shown) <= limit else shown[: limit - 1] + "…"


def check_array(
    name: str, array: object, dtype: DTypeLike, shape: tuple[int | str, ...], hint: str = ""
) -> NDArray[np.generic]:
    """``array`` itself if it is a C-contiguous array of ``dtype`` and ``shape``.

    A string in ``shape`` is a free dimension and only names it in the message.

    Raises:
        SceneError: it is anything else; the text says what was expected and what came.
    """
    import numpy as np

    wanted = np.dtype(dtype)
    if (
        isinstance(array, np.ndarray)
        and array.dtype == wanted
        and array.flags.c_contiguous
        and len(array.shape) == len(shape)
        and all(isinstance(s, str) or s == n for s, n in zip(shape, array.shape, strict=True))
    ):
        return array
    sizes = ", ".join(map(str, shape))
    expected = f"{name}: expected C-contiguous {wanted.name} [{sizes}]"
    tail = f" {hint}" if hint else ""
    if not isinstance(array, np.ndarray):
        raise SceneError(f"{expected}, got {type(array).__name__}.{tail}")
    order = "" if array.flags.c_contiguous else ", not contiguous"
    raise SceneError(f"{expected}, got {array.dtype.name} {list(array.shape)}{order}.{tail}")
