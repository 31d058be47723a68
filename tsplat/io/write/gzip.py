"""gzip by several threads: one stream, whose pieces are deflated at once.

As pigz does it (Mark Adler): each piece begins with the 32 KiB before it as its dictionary and ends
at a byte (Z_SYNC_FLUSH), so that one after the other they are one deflate stream. RFC 1951, 1952.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import BinaryIO, Self

from tsplat.core.workspace import default_threads

PIECE = 1 << 20
"""Bytes; the dictionary and the flush between two cost a part in 10,000 of the size."""

WINDOW = 1 << 15
HEAD = b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\xff"
"""Magic, deflate, no name, no time, no level, no system: the same bytes on every machine."""

THREADS = 8


class Gzip:
    """Writes one gzip stream to ``out``; closed without fault, it is whole."""

    def __init__(self, out: BinaryIO, level: int, piece: int = PIECE) -> None:
        self._out = out
        self._level = level
        self._piece = piece
        self._threads = min(default_threads(), THREADS)
        self._pool = ThreadPoolExecutor(self._threads, "tsplat-gzip")
        self._waiting: deque[Future[bytes]] = deque()
        self._room = bytearray()
        self._before = b""
        self._crc = 0
        self._size = 0
        out.write(HEAD)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *exception: object) -> None:
        try:
            if kind is None:
                self._send(bytes(self._room), last=True)
                self._drain(0)
                self._out.write(struct.pack("<II", self._crc, self._size & 0xFFFFFFFF))
        finally:
            self._pool.shutdown(cancel_futures=True)

    def write(self, data: bytes) -> None:
        """``data`` follows."""
        self._crc = zlib.crc32(data, self._crc)
        self._size += len(data)
        self._room += data
        start = 0
        while len(self._room) - start >= self._piece:
            self._send(bytes(self._room[start : start + self._piece]), last=False)
            start += self._piece
        del self._room[:start]

    def _send(self, piece: bytes, *, last: bool) -> None:
        self._waiting.append(self._pool.submit(_deflated, piece, self._before, self._level, last))
        self._before = (self._before + piece)[-WINDOW:]
        self._drain(2 * self._threads)

    def _drain(self, most: int) -> None:
        """Writes what is done until at most ``most`` pieces are waited for."""
        while len(self._waiting) > most:
            self._out.write(self._waiting.popleft().result())


def _deflated(piece: bytes, before: bytes, level: int, last: bool) -> bytes:
    stream = zlib.compressobj(level, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, before)
    return stream.compress(piece) + stream.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)
