"""A tsplat presenter for any terminal at all: brightness as characters."""

import numpy as np

from tsplat import Frame, Presenter, Terminal, hookimpl

RAMP = np.frombuffer(b" .:-=+*#%@", np.uint8)  # dark to bright
LUMA = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709


def size(terminal: Terminal) -> tuple[int, int]:
    """One pixel a cell; the last row is the viewer's."""
    return terminal.columns, max(1, terminal.rows - 1)


def pixel(terminal: Terminal) -> tuple[float, float]:
    """A pixel is a whole cell, which is not square."""
    return terminal.cell_width, terminal.cell_height


def encode(frame: Frame, terminal: Terminal, previous: Frame | None) -> bytes:
    """Row by row; CR LF goes to the next line in raw mode too."""
    level = frame.to_uint8() @ LUMA
    cells = RAMP[(level * len(RAMP) / 256).astype(int)]
    return b"\r\n".join(row.tobytes() for row in cells)


ASCII = Presenter(
    name="ascii",
    summary="characters, no colour",
    encode=encode,
    size=size,
    unsupported=lambda terminal: None,  # or why this terminal cannot show it
    pixel=pixel,
)


@hookimpl
def tsplat_presenters() -> list[Presenter]:
    return [ASCII]
