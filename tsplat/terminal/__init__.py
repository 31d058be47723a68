"""The only part of tsplat that talks to the tty.

:func:`probe` asks a terminal what it can do, :func:`choose_presenter` picks how to show pictures
on it, and :class:`Screen` is a session on it. Importing this imports no NumPy.
"""

from tsplat.terminal.answers import parse_answers
from tsplat.terminal.choice import choose_presenter
from tsplat.terminal.device import probe
from tsplat.terminal.events import Decoder, Event
from tsplat.terminal.link import Flight, Link
from tsplat.terminal.screen import Screen, Terminated

__all__ = [
    "Decoder",
    "Event",
    "Flight",
    "Link",
    "Screen",
    "Terminated",
    "choose_presenter",
    "parse_answers",
    "probe",
]
