"""Files -> damaged files, with a random.Random: bytes, and what is packed in them.

Packed formats are damaged inside as well: unpacked, changed, packed again with right checksums and
sizes, so that damage gets past the layer that would notice it.
"""

from __future__ import annotations

import base64
import copy
import io
import json
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress

from tests.io.mutate import NUMBERS
from tests.io.spzwriter import compressed

INTEGERS = [
    0, 1, 2, 3, 4, 7, 8, 15, 16, 31, 32, 63, 64, 100, 127, 128, 255, 256, 511, 512, 1023, 1024,
    4095, 4096, 16383, 16384, 32767, 32768, 65535, 65536, 2**18, 2**20, 2**24 - 1, 2**31 - 1, 2**31,
    2**32 - 1, 2**32, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1,
]  # fmt: skip
FLOATS = [
    b"\0\0\x80\x7f", b"\0\0\x80\xff", b"\0\0\xc0\x7f", b"\1\0\x80\x7f", b"\1\0\xa0\xff",  # inf, NaN
    b"\xff\xff\x7f\x7f", b"\xff\xff\x7f\xff", b"\1\0\0\0", b"\1\0\0\x80", b"\0\0\x80\0",
    b"\0\0\0\0", b"\0\0\0\x80", b"\0\0\x80?", b"\xff\xff\x7f\x7e", b"\0\0\x80\x5e",
    b"\0\0\0\0\0\0\xf0\x7f", b"\1\0\0\0\0\0\xf0\x7f", b"\xff" * 8,
    b"\xff\xff\xff\xff\xff\xff\xef\x7f",
]  # fmt: skip
DECIMALS = [
    b"0", b"-0", b"1", b"-1", b"nan", b"inf", b"-inf", b"1e39", b"1e-46", b"1e999", b"255", b"256",
    b"65536", b"4294967296", b"99999999999999", b"1_0", b"0x1", b"+1", b"1e", b"", b"9" * 400,
    b"1 1", b"-3.5", b"88.8", b"-104",
]  # fmt: skip
PLY_WORDS = [
    b"ply\n", b"format ascii 1.0\n", b"format binary_little_endian 1.0\n",
    b"format binary_big_endian 1.0\n", b"format ascii 1.1\n", b"comment \n", b"obj_info \n",
    b"element vertex 3\n", b"element vertex 0\n", b"element face 1\n", b"element chunk 1\n",
    b"element sh 3\n", b"end_header\n", b"property list uchar int a\n", b"\r\n", b"\r",
    b"property list uint double b\n", b"property list char char c\n", b"property double x\n",
    b"property float f_rest_0\n", b"property uchar f_rest_0\n", b"property uint packed_position\n",
    b"property float ", b"property double ", b"property uchar ", b"property int ", b"vertex",
    b"f_rest_", b"packed_color", b"element ", b"property ", b"list ", b"float64", b"int8",
]  # fmt: skip
NAMES = [
    "../secret.webp", "/etc/passwd", "..", ".", "", "a/../../secret.webp", "meta.json",
    "means_l.webp", "%2e%2e/secret.webp", "link.webp", "pipe.webp", "C:\\x", "//x", "file:///etc/passwd",
    "http://127.0.0.1/x", "x" * 300, "a\0b", "data:,", "data:;base64,", "data:#0", "data:#99",
    "data:application/octet-stream;base64,AAAA", "\x1b[2J", "sub/scales.webp", "CON",
]  # fmt: skip
MEMBERS_MAX, INFLATED_MAX = 64, 1 << 22

Mutate = Callable[[random.Random, bytes], bytes]


def numbers(rng: random.Random) -> bytes:
    """A number of some width at an extreme, in either byte order."""
    if rng.random() < 0.4:
        return rng.choice(FLOATS)
    width = rng.choice((1, 2, 4, 4, 8))
    value = rng.choice(INTEGERS) & (1 << 8 * width) - 1
    return value.to_bytes(width, rng.choice(("little", "little", "big")))


def havoc(rng: random.Random, content: bytes, words: list[bytes] = (), head: int = 128) -> bytes:
    """One to six of: bits, numbers, words, pieces copied, put in, taken out; the end cut off."""
    made = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4, 6))):
        size = len(made)
        if not size:
            break
        at = rng.randrange(size if rng.random() < 0.5 else min(head, size))
        kind = rng.randrange(11 if words else 10)
        if kind == 0:
            made[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            made[at] = rng.randrange(256)
        elif kind in (2, 3):
            number = numbers(rng)
            at -= at % len(number) * (rng.random() < 0.7)
            made[at : at + len(number)] = number
        elif kind == 4:
            made[at] = made[at] + rng.choice((-2, -1, 1, 2, 16)) & 255
        elif kind == 5:
            piece = made[(start := rng.randrange(size)) : start + rng.choice((1, 2, 4, 8, 16, 64))]
            made[at : at + len(piece)] = piece
        elif kind == 6:
            made[at:at] = made[(start := rng.randrange(size)) : start + rng.choice((1, 4, 32, 200))]
        elif kind == 7:
            del made[at : at + rng.choice((1, 1, 2, 4, 16, 64))]
        elif kind == 8:
            if rng.random() < 0.5:
                del made[rng.randrange(size) :]
            else:
                made += bytes(rng.choice((1, 4, 32, 100)))
        elif kind == 9:
            spans = [m.span() for m in re.finditer(rb"-?[0-9][0-9.e+-]*", bytes(made[:4096]))]
            if spans:
                start, stop = rng.choice(spans)
                made[start:stop] = rng.choice(DECIMALS)
        else:
            word = rng.choice(words)
            made[at : at + rng.choice((0, len(word)))] = word
    return bytes(made)


def altered(rng: random.Random, value: object) -> object:
    """``value``, JSON data, itself, with one to three values replaced, taken away or copied."""
    made = value
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = made
        for _ in range(32):
            keys = list(at) if isinstance(at, dict) else range(len(at))
            if not keys:
                break
            key = rng.choice(keys)
            if isinstance(at[key], dict | list) and at[key] and rng.random() < 0.8:
                at = at[key]
                continue
            kind = rng.randrange(8)
            if kind == 0 and isinstance(at, dict):
                del at[key]
            elif kind == 1:
                at[key] = copy.deepcopy(at[rng.choice(keys)])
            elif kind == 2 and isinstance(at, list) and len(at) < 64:
                at += copy.deepcopy(at[: rng.choice((1, 4))])
            elif kind == 3 and isinstance(at, list):
                del at[key]
            elif kind == 4 and isinstance(at[key], str):
                at[key] = rng.choice(NAMES)
            elif kind == 5 and isinstance(at[key], int | float):
                with suppress(OverflowError):  # of an integer that no float holds
                    at[key] = at[key] + rng.choice((-1, 1, 0.5, 4, 12))
            else:
                at[key] = rng.choice((*NUMBERS, rng.choice(INTEGERS), rng.choice(NAMES)))
            break
    return made


def text(rng: random.Random, content: bytes) -> bytes:
    """JSON text damaged: as data if it is some, else, or now and then, as bytes."""
    if rng.random() < 0.85:
        try:
            return json.dumps(altered(rng, json.loads(content))).encode("utf-8", "replace")
        except (ValueError, RecursionError, TypeError):
            pass
    return havoc(rng, content, [b'{"', b'":', b"[", b"]", b"}", b",", b"null", b"NaN", b"1e999"])


def ply(rng: random.Random, content: bytes) -> bytes:
    """Lines of the header moved, counts and types changed; or bytes."""
    head, end, body = content.partition(b"end_header\n")
    kind = rng.random()
    if kind < 0.35 or not end:
        return havoc(rng, content, PLY_WORDS, len(head) + 32)
    if kind < 0.6:
        return head + end + havoc(rng, body, [], len(body) or 1)
    lines = head.splitlines(keepends=True)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(len(lines)) if lines else 0
        what = rng.randrange(5)
        if what == 0:
            lines.insert(at, rng.choice(PLY_WORDS))
        elif what == 1 and lines:
            lines.insert(at, rng.choice(lines))
        elif what == 2 and lines:
            del lines[at]
        elif what == 3 and lines:
            words = lines[at].split(b" ")
            words[rng.randrange(len(words))] = rng.choice(
                (b"float", b"double", b"uchar", b"int", b"x", b"2", b"4096", *DECIMALS[:9])
            )  # fmt: skip
            lines[at] = b" ".join(words) + (b"" if words[-1].endswith(b"\n") else b"\n")
        elif lines:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
    return b"".join(lines) + end + body


def splat(rng: random.Random, content: bytes) -> bytes:
    """Few rows damaged of many, or it is none any more; or anything."""
    if rng.random() < 0.2 or len(content) < 64:
        return havoc(rng, content)
    made = bytearray(content[: len(content) // 32 * 32])
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(made) // 32) * 32
        made[at : at + 32] = havoc(rng, bytes(made[at : at + 32]))[:32].ljust(32, b"\0")
    return bytes(made) + bytes(rng.choice((0, 0, 0, 0, 1, 31)))


def ksplat(rng: random.Random, content: bytes) -> bytes:
    """Fields of the header and of sections; bytes behind them."""
    made = bytearray(content)
    kind = rng.random()
    if kind < 0.1 or len(made) < 5120:
        return havoc(rng, content, [], 4096 + 1100)
    if kind < 0.4:
        return bytes(made[:5120]) + havoc(rng, bytes(made[5120:]), [], 256)
    sections = max(1, min(int.from_bytes(made[4:8], "little"), (len(made) - 4096) // 1024))
    fields = [0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40]
    for _ in range(rng.choice((1, 1, 2, 3))):
        if rng.random() < 0.3:
            at = rng.choice((1, 4, 8, 12, 16, 20, 24, 36, 40))
        else:
            at = 4096 + 1024 * rng.randrange(sections) + rng.choice(fields)
        width = 1 if at == 1 else 2 if at == 20 or (at % 1024 in (20, 40) and at > 4096) else 4
        if rng.random() < 0.4:
            value = int.from_bytes(made[at : at + width], "little") + rng.choice(
                (-1, 1, 2, -2, 256)
            )
        else:
            value = rng.choice(INTEGERS) if rng.random() < 0.8 else rng.getrandbits(8 * width)
        made[at : at + width] = (value & (1 << 8 * width) - 1).to_bytes(width, "little")
    return bytes(made)


def _inflated(content: bytes) -> bytes:
    return zlib.decompressobj(wbits=31).decompress(content, INFLATED_MAX)


def _gzip(rng: random.Random, content: bytes) -> bytes:
    packer = zlib.compressobj(rng.choice((0, 1, 1, 9)), zlib.DEFLATED, 31)
    made = packer.compress(content) + packer.flush()
    return made + made * (rng.random() < 0.03)


def _zstd_parts(content: bytes) -> tuple[bytes, list[bytes]]:
    from tsplat.io import spz

    table, count = int.from_bytes(content[16:20], "little"), content[15]
    at = table + 16 * count
    planes = []
    maker, fault = spz._zstd()
    for i in range(count):
        packed = int.from_bytes(content[table + 16 * i : table + 16 * i + 8], "little")
        if packed > len(content):
            raise ValueError
        try:
            planes.append(maker().decompress(content[at : at + packed], INFLATED_MAX))
        except (fault, EOFError):
            raise ValueError from None
        at += packed
    return content[:table], planes


def spz(rng: random.Random, content: bytes) -> bytes:
    """The stream damaged and packed again; planes of version 4 each for itself; or bytes."""
    kind = rng.random()
    if kind > 0.3:
        try:
            if content.startswith(b"\x1f\x8b"):
                return _gzip(rng, havoc(rng, _inflated(content), [], 16))
            if content[4:5] == b"\4":
                head, planes = _zstd_parts(content)
                if rng.random() < 0.5:
                    head = havoc(rng, head, [], 32)
                    if rng.random() < 0.3:
                        record = struct.pack("<II", 0xADBE0003, 4) + numbers(rng)[:4].ljust(
                            4, b"\0"
                        )
                        head = bytearray(head[:32] + record)
                        head[14] |= 2
                        head[16:20] = len(head).to_bytes(4, "little")
                else:
                    i = rng.randrange(len(planes))
                    planes[i] = havoc(rng, planes[i], [], len(planes[i]) or 1)
                packed = [compressed(p) for p in planes]
                table = b"".join(
                    struct.pack("<QQ", len(s), len(p)) for s, p in zip(packed, planes, strict=True)
                )
                return bytes(head) + table + b"".join(packed)
        except (zlib.error, ValueError, IndexError, struct.error, MemoryError):
            pass
    return havoc(rng, content, [b"NGSP", b"\x1f\x8b\x08\0", b"(\xb5/\xfd"], 96)


FOLDER = b"folder\n"
"""Before a zip archive: its members are to be laid out as files beside meta.json."""


def members(content: bytes) -> dict[str, bytes]:
    """Files in a zip archive; none if it cannot be read."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            infos = archive.infolist()[:MEMBERS_MAX]
            if sum(i.file_size for i in infos) > INFLATED_MAX:
                return {}
            return {i.filename: archive.read(i) for i in infos}
    except Exception:  # what zipfile raises of damage is not our matter
        return {}


def archive(rng: random.Random, files: dict[str, bytes]) -> bytes:
    """A zip archive of them."""
    buffer = io.BytesIO()
    how = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(buffer, "w", how, compresslevel=1) as made:
        for name, content in files.items():
            made.writestr(zipfile.ZipInfo(name), content, how)
    return buffer.getvalue()


class Sog:
    """Damages SOG; ``images`` are other images that may take the place of one."""

    def __init__(self, images: list[bytes]) -> None:
        self._images = images

    def __call__(self, rng: random.Random, content: bytes) -> bytes:
        """The archive's bytes, its JSON, an image's bytes, or which image is where."""
        folder = content.startswith(FOLDER)
        packed = content[len(FOLDER) :] if folder else content
        kind = rng.random()
        files = members(packed) if kind > 0.12 else {}
        meta = next((n for n in files if n.endswith("meta.json")), None)
        if meta is None:
            return FOLDER * folder + havoc(rng, packed, [b"PK\1\2", b"PK\3\4", b"PK\5\6"], 4096)
        name = rng.choice([n for n in files if n != meta] or [meta])
        if kind < 0.62:
            files[meta] = text(rng, files[meta])
        elif kind < 0.8:
            files[name] = image(rng, files[name])
        elif kind < 0.92:
            files[name] = rng.choice(self._images)
        elif kind < 0.95:
            other = rng.choice(list(files))
            files[name], files[other] = files[other], files[name]
        elif kind < 0.97:
            del files[name]
        else:
            files[rng.choice(NAMES).replace("\0", "") or "a"] = files.pop(name)
        return FOLDER * (folder != (rng.random() < 0.05)) + archive(rng, files)


def image(rng: random.Random, content: bytes) -> bytes:
    """A WebP or a PNG damaged; checksums of a PNG are right."""
    if content.startswith(b"\x89PNG") and rng.random() < 0.7:
        made, at = [content[:8]], 8
        while at + 12 <= len(content):
            length = int.from_bytes(content[at : at + 4], "big")
            made.append(content[at + 4 : at + 8 + length])
            at += 12 + length
        i = rng.randrange(1, len(made)) if len(made) > 1 else 0
        if i:
            made[i] = havoc(rng, made[i], [b"zTXt", b"tRNS", b"acTL", b"IEND"], 24)
        chunks = [
            struct.pack(">I", max(len(c) - 4, 0)) + c + struct.pack(">I", zlib.crc32(c))
            for c in made[1:]
        ]
        return made[0] + b"".join(chunks)
    return havoc(rng, content, [b"RIFF", b"VP8L", b"VP8X", b"VP8 ", b"ANIM", b"ALPH"], 48)


def gltf(rng: random.Random, content: bytes) -> bytes:
    """The JSON of a GLB or glTF, or its buffer, put together again; or bytes."""
    kind = rng.random()
    if kind < 0.1:
        return havoc(rng, content, [b"glTF", b"JSON", b"BIN\0"], 64)
    if content.startswith(b"glTF") and len(content) >= 20:
        size = int.from_bytes(content[12:16], "little")
        body, binary = content[20 : 20 + size], content[28 + size :]
        if kind < 0.7:
            body = text(rng, body)
        else:
            binary = havoc(rng, binary, [], len(binary) or 1)
        body += b" " * (-len(body) % 4)
        made = struct.pack("<II", len(body), 0x4E4F534A) + body
        made += struct.pack("<II", len(binary), 0x004E4942) + binary
        return b"glTF" + struct.pack("<II", 2, 12 + len(made)) + made
    if kind < 0.8:
        return text(rng, content)
    found = re.search(rb"base64,([A-Za-z0-9+/=]*)", content)
    if found:
        try:
            inner = havoc(rng, base64.b64decode(found[1]), [], 4096)
        except ValueError:
            return havoc(rng, content)
        return content[: found.start(1)] + base64.b64encode(inner) + content[found.end(1) :]
    return havoc(rng, content)


PLAIN: dict[str, Mutate] = {
    "ply": ply, "compressed-ply": ply, "splat": splat, "ksplat": ksplat, "spz": spz, "gltf": gltf,
}  # fmt: skip


def mutator(reader: str, seeds: list[bytes]) -> Mutate:
    """What damages files of a reader; ``seeds`` are some."""
    if reader != "sog":
        return PLAIN[reader]
    from tests.io.sogwriter import webp

    rng = random.Random(0)
    images = [
        webp(list(rng.randbytes(4 * w * h)), w, h, kind)
        for kind in ("WEBP", "PNG")
        for w, h in ((1, 1), (2, 3), (3, 3), (192, 1), (512, 1), (960, 1), (64, 2), (300, 220))
    ]
    images += [i for s in seeds for n, i in members(s).items() if not n.endswith("json")][:32]
    return Sog(images)
