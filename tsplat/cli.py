"""The command line: arguments in, one command called, errors as one line.

Nothing heavy is imported before a command needs it, so ``tsplat --help`` answers at once.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import importlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from tsplat._version import __version__
from tsplat.core.errors import TsplatError, printable

COMMANDS = ("view", "cat", "render", "convert", "info", "plugins", "check", "bench")
SHELLS = ("bash", "zsh", "tcsh")
VECTORS = ("--eye", "--target", "--up", "--background", "--crop")

DESCRIPTION = """\
3D Gaussian Splatting scenes in a terminal, on a CPU.

  tsplat scene.ply                       look at a scene (the same as tsplat view scene.ply)
  tsplat                                 look at the built-in demo scene
  tsplat cat scene.ply                   a picture among the text of this terminal
  tsplat render scene.ply -o out.png     make a picture, no terminal needed
  tsplat convert scene.ply scene.spz     write a scene in another format
  tsplat info scene.ply                  what is in a file
  tsplat plugins                         backends, presenters, readers and writers
  tsplat check scene.ply                 prove every backend right on a scene
  tsplat bench scene.ply                 what each shortcut costs and saves on a scene
"""
VIEW_EXAMPLES = """\
examples:
  tsplat view scene.ply
  tsplat view scene.ply --backend numba --presenter halfblock
  tsplat view scene.ply --max-splats 200000 --threads 4
  tsplat view scene.ply --quality fast
  tsplat view scene.ply --fps 15 --max-rate 2M
  tsplat view scene.ply --verify
  tsplat view scene.ply --play path.json

keys: W A S D R F move, arrows or drag turn, + - or wheel zoom, C or 2 clicks go there,
      Space flies, O turns by itself, U upside up, Z first view, Tab settings, P keeps a picture,
      V records a path, ? all keys, Q quit
"""
CAT_EXAMPLES = """\
examples:
  tsplat cat scene.ply
  tsplat cat *.ply --rows 10
  tsplat cat scene.ply --camera cameras.json#3 --presenter sixel
  tsplat cat scene.ply | less -R
  tsplat cat scene.ply --columns 100 > picture.txt

A terminal is asked what it can do, as by tsplat view. A pipe or file gets half blocks in 24 bits,
80x24 cells at most unless COLUMNS and LINES or the options say otherwise.
"""
RENDER_EXAMPLES = """\
examples:
  tsplat render scene.ply -o out.png --size 1280x720
  tsplat render scene.ply -o out.png --eye 0,-1,-5 --target 0,0,0 --up 0,-1,0 --fov 60
  tsplat render scene.ply -o out.npz --camera cameras.json#3 --background none
  tsplat render scene.ply -o - --ideal | convert - exact.jpg
  tsplat render scene.ply -o out.png --repeat 10 --json
  tsplat render scene.ply -o out.png --quality fast
  tsplat render scene.ply -o out.png --max-error 1
  tsplat render scene.ply -o turn.gif --path orbit --size 640x360
  tsplat render scene.ply -o film.mp4 --path path.json --frames 240 --fps 30
  tsplat render scene.ply -o frames-%04d.png --path path.json    again: goes on where it stopped
  tsplat render scene.ply -o turn.cast --path orbit --size 100x30

A path is a list of cameras, ours or INRIA's, each with a "time" in seconds or none; the camera
passes through all of them smoothly. "orbit" turns the view that the camera options give once round
the scene.
"""
CONVERT_EXAMPLES = """\
examples:
  tsplat convert scene.ply scene.spz
  tsplat convert scene.ply scene.compressed.ply --sh-degree 1
  tsplat convert scene.spz scene.ply --json | jq .pictures.psnr_worst
  tsplat convert scene.ply small.splat --crop -2,-2,-2,2,2,2 --min-opacity 0.02
  tsplat convert scene.ply scene.spz --format-version 2 --fractional-bits 14 --sh-bits 8
  tsplat convert headlong.spz upright.ply --flip-y
  tsplat convert scene.sog out.bin --to ply --force --no-measure

The suffix says which format: .ply (INRIA's), .compressed.ply (PlayCanvas'), .splat
(antimatter15's), .spz (Niantic's); `tsplat plugins` lists more. The file is read back: how far
each field is off is said, and how far pictures from standard views are.
"""
INFO_EXAMPLES = """\
examples:
  tsplat info scene.ply
  tsplat info scene.ply --json | jq .gaussians
  tsplat info scene.ply --trim 1 --min-opacity 0.02    what these would leave out
"""
PLUGINS_EXAMPLES = """\
examples:
  tsplat plugins
  TSPLAT_PLUGINS= tsplat plugins        without third-party plugins
  TSPLAT_PLUGINS=a,b tsplat plugins     only these two
  tsplat plugins --terminal foot,-sync  what would be chosen in another terminal

In a terminal it also says what that was asked and answered, and which presenter follows.
"""
CHECK_EXAMPLES = """\
examples:
  tsplat check                            every backend on the demo scene
  tsplat check scene.ply --backend cffi --size 1280x720 --json
  tsplat check --full --backend mine      all of a backend, on hundreds of drawn scenes
  tsplat check --full --backend mine --examples 1000 --expect-fail laws/tiles,bits
  tsplat check --full --expect-fail @expected.txt
  tsplat check --presenter mine           a presenter, by its bytes alone
  tsplat check --presenter mine --decode kitty
  tsplat check --presenter mine --decode my_module:decode

On a scene every stage gets the reference's input. Exit code 1 if the contract is broken anywhere,
or if a check holds that was expected to fail. --full and --presenter need hypothesis:
pip install "tsplat[test]".
"""
BENCH_EXAMPLES = """\
examples:
  tsplat bench scene.ply
  tsplat bench scene.ply -o diagram.svg --csv rows.csv
  tsplat bench scene.ply --backend cffi --set scale=0.5,alpha_threshold=4/255 --show
  tsplat bench scene.ply --presets --size 640x360 --cameras 5 --json

Every backend is verified first. Errors are against the ideal picture: float64, no threshold, no
early stop. Ctrl-C keeps what is done.
"""


def _pair(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,6})[xX]([0-9]{1,6})", text)
    if not match or not int(match[1]) or not int(match[2]):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, such as 1280x720, got {text!r}")
    return int(match[1]), int(match[2])


def _vector(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
        if not all(abs(value) < 1e30 for value in (x, y, z)):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"expected three finite numbers, such as 0,-1,2.5, got {text!r}"
        ) from None
    return x, y, z


def _up(text: str) -> tuple[float, float, float]:
    axis = re.fullmatch(r"([-+]?)([xyz])", text.lower())
    if axis:
        sign = -1.0 if axis[1] == "-" else 1.0
        x, y, z = (sign * (name == axis[2]) + 0.0 for name in "xyz")
        return x, y, z
    if re.fullmatch(r"[a-zA-Z]+", text):
        raise argparse.ArgumentTypeError(
            f"expected x, -x, y, -y, z, -z or three numbers such as 0,-1,0, got {text!r}"
        )
    return _vector(text)


def _color(text: str) -> tuple[float, float, float] | None:
    if text == "none":
        return None
    color = _vector(text)
    if not all(0 <= channel <= 1 for channel in color):
        raise argparse.ArgumentTypeError(f"expected 'none' or R,G,B from 0 to 1, got {text!r}")
    return color


def _count(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,12}", text) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 on, got {text!r}")
    return int(text)


def _cells(text: str) -> int:
    value = _count(text)
    if value > 999:
        raise argparse.ArgumentTypeError(f"expected 1 to 999, got {value}")
    return value


def _number(text: str, fits: Callable[[float], bool], expected: str) -> float:
    with suppress(ValueError):
        value = float(text)
        if fits(value):
            return value
    raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")


def _positive(text: str) -> float:
    return _number(text, lambda value: 0 < value < float("inf"), "a number above 0")


def _share(text: str) -> float:
    return _number(text, lambda value: 0 <= value <= 1, "0 to 1")


def _percentile(text: str) -> float:
    return _number(text, lambda value: 0 <= value <= 49, "a percentile from 0 to 49")


def _factor(text: str) -> float:
    return _number(text, lambda value: 0 <= value <= 10, "a number from 0 to 10")


def _box(text: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    corners = text.split(",")
    low, high = _vector(",".join(corners[:3])), _vector(",".join(corners[3:]))
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise argparse.ArgumentTypeError(f"expected the lower corner first, got {text!r}")
    return low, high


def _bits(text: str) -> float:
    """Bits/s from a number with k, M or G behind it."""
    match = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)([kMG]?)", text)
    rate = float(match[1]) * {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}[match[2]] if match else 0
    if rate < 1000:
        raise argparse.ArgumentTypeError(
            f"expected bits/s from 1k on, such as 500k or 2M, got {text!r}"
        )
    return rate


def _sh_bits(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-8])(?:,([1-8]))?", text)
    if not match:
        raise argparse.ArgumentTypeError(f"expected 1 to 8, or two of these as 5,4, got {text!r}")
    return int(match[1]), int(match[2] or match[1])


def _fraction(text: str) -> int:
    return int(_number(text, lambda v: v in range(24), "a whole number from 0 to 23"))


def _threads(text: str) -> int:
    value = _count(text)
    if value > 256:
        raise argparse.ArgumentTypeError(f"expected 1 to 256, got {value}")
    return value


def _add_scene(parser: argparse.ArgumentParser, optional: bool = True, many: bool = False) -> None:
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="*" if many else "?" if optional else None,
        help="a splat file" + ("; the built-in demo scene if left out" if optional else ""),
    )
    _add_reading(parser).add_argument(
        "--sh-float32", action="store_true",
        help="keep colours in float32 even where float16 moves none by 1/4 of an 8-bit level",
    )  # fmt: skip


def _add_reading(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    reading = parser.add_argument_group("reading")
    reading.add_argument(
        "--max-splats", type=_count, metavar="N", help="keep N Gaussians, an even sample"
    )
    reading.add_argument(
        "--raw-opacity", action="store_true", help="the file's opacities are 0..1, not logits"
    )
    return reading


def _add_antialias(parser: argparse._ActionsContainer, text: str) -> None:
    parser.add_argument("--antialias", action=argparse.BooleanOptionalAction, help=text)


def _add_engine(parser: argparse.ArgumentParser) -> None:
    engine = parser.add_argument_group("rendering")
    engine.add_argument(
        "--backend",
        default="auto",
        metavar="B",
        help="a name from `tsplat plugins`, STAGE=NAME,... to mix, or auto (default): the fastest",
    )
    engine.add_argument(
        "--threads", type=_threads, metavar="N", help="default: every CPU this process may use"
    )
    _add_antialias(engine, "for scenes trained with antialiasing (default: what the file says)")
    engine.add_argument(
        "--sh-degree", type=int, choices=range(4), default=3, metavar="D",
        help="highest degree of view-dependent colour, 0 to 3 (default)",
    )  # fmt: skip


def _add_quality(parser: argparse.ArgumentParser) -> None:
    quality = parser.add_argument_group("quality", "`tsplat bench` says what each costs and saves")
    quality.add_argument(
        "--quality", choices=("exact", "contract", "balanced", "fast"), metavar="Q",
        help="exact, contract (default), balanced or fast",
    )  # fmt: skip
    quality.add_argument(
        "--set", metavar="NAME=VALUE,...",
        help="alpha_threshold, transmittance_min, sh_degree, depth_bits, scale, share or half",
    )  # fmt: skip
    quality.add_argument(
        "--max-error", metavar="E[,WORST]",
        help="the fastest settings whose 99.9th percentile and worst error stay below E 8-bit "
        "levels, as found by measuring on this scene",
    )  # fmt: skip


def _add_pose(parser: argparse.ArgumentParser) -> None:
    pose = parser.add_argument_group("camera", "default: a view that frames the scene")
    pose.add_argument(
        "--camera", metavar="FILE[#INDEX]", help="camera JSON, ours or INRIA's cameras.json"
    )
    pose.add_argument("--eye", type=_vector, metavar="X,Y,Z", help="where the camera stands")
    pose.add_argument(
        "--target", type=_vector, metavar="X,Y,Z", help="what it looks at (the scene's middle)"
    )
    pose.add_argument(
        "--up", type=_up, metavar="AXIS",
        help="which way is up: x, -x, y, -y, z, -z or X,Y,Z (what is known of the file: `tsplat "
        "info`; -y if nothing is)",
    )  # fmt: skip
    pose.add_argument(
        "--flip-y", action="store_true", help="up is the other way: for scenes that stand on "
        "their head"
    )  # fmt: skip
    pose.add_argument(
        "--fov", type=_positive, metavar="DEG", help="vertical field of view, degrees (50)"
    )
    pose.add_argument("--near", type=_positive, metavar="Z", help="nothing nearer is drawn")
    pose.add_argument("--far", type=_positive, metavar="Z", help="nothing farther is drawn")


def _add_edits(
    parser: argparse.ArgumentParser, text: str = "the scene is as if its file had been so"
) -> None:
    edits = parser.add_argument_group("edits", text)
    edits.add_argument(
        "--splat-scale", type=_positive, default=1.0, metavar="F", help="times as large splats (1)"
    )
    edits.add_argument(
        "--min-opacity", type=_share, default=0.0, metavar="O",
        help="leave out Gaussians of less opacity, 0 to 1 (0)",
    )  # fmt: skip
    edits.add_argument(
        "--max-scale", type=_positive, metavar="S",
        help="leave out Gaussians with a standard deviation above S world units",
    )  # fmt: skip
    edits.add_argument(
        "--trim", type=_percentile, default=0.0, metavar="P",
        help="leave out strays: before the percentile P of x, y or z, or behind 100 - P (0)",
    )  # fmt: skip
    edits.add_argument(
        "--saturation", type=_factor, default=1.0, metavar="F", help="of all colours; 0 is grey (1)"
    )
    edits.add_argument(
        "--crop", type=_box, metavar="X0,Y0,Z0,X1,Y1,Z1",
        help="leave out Gaussians whose mean is outside this box of the world",
    )  # fmt: skip


def _add_presenter(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--presenter", metavar="P",
        help="kitty, iterm2, sixel, blocks, halfblock, braille, letters, another of `tsplat "
        "plugins`, or auto ($TSPLAT_PRESENTER, else auto)",
    )  # fmt: skip


def _add_background(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--background", type=_color, default=(0.0, 0.0, 0.0), metavar="R,G,B", help="0..1 each"
    )


def _add_terminal(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--terminal", metavar="T",
        help="what the terminal is, whatever it answers: a name such as foot, features such as "
        "+sixel,-kitty, colors=256 ($TSPLAT_TERMINAL)",
    )  # fmt: skip


def make_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("tsplat", description=DESCRIPTION, formatter_class=raw)
    parser.add_argument("--version", action="version", version=f"tsplat {__version__}")
    parser.add_argument(
        "--print-completion", choices=SHELLS, metavar="SHELL",
        help=f"print a completion script for {', '.join(SHELLS)}",
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    def add(name: str, summary: str, examples: str = "") -> argparse.ArgumentParser:
        return commands.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + ".",
            epilog=examples, formatter_class=raw,
        )  # fmt: skip

    view = add("view", "look at a scene in this terminal", VIEW_EXAMPLES)
    _add_scene(view)
    _add_pose(view)
    view.add_argument(
        "--cameras", metavar="FILE",
        help="cameras for N to go through (cameras.json beside the scene or above it)",
    )  # fmt: skip
    _add_engine(view)
    _add_quality(view)
    _add_edits(view)
    _add_presenter(view)
    _add_background(view)
    view.add_argument("--play", metavar="FILE", help="go along a path of cameras; any key stops it")
    view.add_argument(
        "--fps", type=_positive, default=30.0, metavar="N",
        help="frames a second (30): a moving picture has as many pixels as that allows",
    )  # fmt: skip
    _add_terminal(view)
    view.add_argument(
        "--max-rate", type=_bits, metavar="R",
        help="send at most so many bits/s, such as 500k or 2M (default: what the link takes)",
    )  # fmt: skip
    view.add_argument(
        "--verify", action="store_true",
        help="compare still frames with the float64 reference, some tiles at a time, meanwhile",
    )  # fmt: skip

    cat = add("cat", "print a picture of each scene, among the terminal's text", CAT_EXAMPLES)
    _add_scene(cat, many=True)
    cat.add_argument("--columns", type=_cells, metavar="N", help="width in cells at most")
    cat.add_argument("--rows", type=_cells, metavar="N", help="height in cells at most")
    _add_presenter(cat)
    _add_pose(cat)
    _add_engine(cat)
    _add_quality(cat)
    _add_edits(cat)
    _add_background(cat)

    render = add("render", "make a picture of a scene", RENDER_EXAMPLES)
    _add_scene(render)
    render.add_argument(
        "-o", "--output", required=True, metavar="OUT",
        help=".png .jpg .webp, .npy (float32 premultiplied RGBA), "
        ".npz (rgb, transmittance, depth, camera), - for PNG on stdout",
    )  # fmt: skip
    render.add_argument(
        "--size", type=_pair, metavar="WxH",
        help="px (the camera's own, or 1280x720); cells for .cast (80x24)",
    )  # fmt: skip
    _add_pose(render)
    film = render.add_argument_group(
        "films", "to .gif .webp .mp4 (needs ffmpeg) .cast (asciinema), out-%04d.png or a folder"
    )
    film.add_argument(
        "--path", metavar="FILE|orbit", help="cameras to go through, or once round the scene"
    )
    film.add_argument(
        "--frames", type=_count, metavar="N", help="how many (those of the path's seconds, or 4 s)"
    )
    film.add_argument("--fps", type=_positive, metavar="R", help="frames a second (25)")
    film.add_argument(
        "--force", action="store_true", help="make frames of a PNG sequence again that are there"
    )
    film.add_argument("--presenter", metavar="P", help="what draws in a .cast (halfblock)")
    _add_engine(render)
    _add_quality(render)
    _add_edits(render)
    render.add_argument(
        "--background", type=_color, default=(0.0, 0.0, 0.0), metavar="R,G,B|none",
        help="0..1 each, or none for transparent (0,0,0)",
    )  # fmt: skip
    render.add_argument(
        "--ideal", action="store_true",
        help="the model's true value: float64, no alpha threshold, no early stop; slow",
    )  # fmt: skip
    render.add_argument(
        "--float64", action="store_true", help="the contract's picture worked out in float64; slow"
    )
    render.add_argument(
        "--everything", action="store_true",
        help="do the work too that the picture does not need, to compare",
    )  # fmt: skip
    render.add_argument(
        "--repeat", type=_count, default=1, metavar="N", help="render N times, for timing"
    )
    render.add_argument("--json", action="store_true", help="print facts and timings as JSON")

    convert = add("convert", "write a scene in another format", CONVERT_EXAMPLES)
    convert.add_argument("scene", metavar="IN", help="a splat file")
    convert.add_argument("output", metavar="OUT", help=".ply .compressed.ply .splat .spz")
    convert.set_defaults(sh_float32=True)
    convert.add_argument(
        "--to", metavar="NAME", help="a writer of `tsplat plugins`, whatever the suffix"
    )
    convert.add_argument("--force", action="store_true", help="replace OUT if it is there")
    convert.add_argument(
        "--sh-degree", type=int, choices=range(4), metavar="D",
        help="leave out harmonics above degree D, 0 to 3",
    )  # fmt: skip
    convert.add_argument("--json", action="store_true", help="print the summary as JSON")
    spz = convert.add_argument_group("SPZ")
    spz.add_argument(
        "--format-version", type=_count, metavar="V", help="2, 3 (default) or 4 (zstd)"
    )
    spz.add_argument(
        "--fractional-bits", type=_fraction, metavar="N",
        help="of positions, 0 to 23 (12; more for small Gaussians, fewer for far ones)",
    )  # fmt: skip
    spz.add_argument(
        "--sh-bits", type=_sh_bits, metavar="B[,B]",
        help="of harmonics of degree 1, and of higher ones, 1 to 8 (5,4)",
    )  # fmt: skip
    _add_reading(convert)
    convert.add_argument(
        "--flip-y", action="store_true",
        help="turn the scene by 180 degrees about x, if it stands on its head",
    )  # fmt: skip
    _add_edits(convert, "what they cut is left out of the file")
    measuring = convert.add_argument_group("measuring")
    measuring.add_argument(
        "--no-measure", action="store_true", help="do not read the file back and compare"
    )
    measuring.add_argument("--size", type=_pair, metavar="WxH", help="of pictures, px (480x270)")
    measuring.add_argument(
        "--cameras", metavar="FILE",
        help="more cameras to compare from (cameras.json beside the scene or above it)",
    )  # fmt: skip
    measuring.add_argument("--backend", default="auto", metavar="B", help="what draws (auto)")
    measuring.add_argument("--threads", type=_threads, metavar="N", help="default: every CPU")

    info = add("info", "say what is in a scene file", INFO_EXAMPLES)
    _add_scene(info, optional=False)
    _add_edits(info)
    info.add_argument("--json", action="store_true", help="print it as JSON")

    plugins = add("plugins", "list backends, presenters, readers and writers", PLUGINS_EXAMPLES)
    _add_terminal(plugins)
    plugins.add_argument("--json", action="store_true", help="print it as JSON")

    check = add("check", "compare every backend with the reference", CHECK_EXAMPLES)
    _add_scene(check)
    _add_edits(check)
    check.add_argument("--backend", metavar="B", help="only this one (default: all available)")
    check.add_argument(
        "--size",
        type=_pair,
        metavar="WxH",
        help="px (the camera's own, made smaller than 640, or 320x200)",
    )
    check.add_argument("--camera", metavar="FILE[#INDEX]", help="default: frames the scene")
    check.add_argument("--threads", type=_threads, metavar="N", help="default: every CPU")
    _add_antialias(check, "check the antialiased picture (default: what the file says)")
    check.add_argument(
        "--sh-degree", type=int, choices=range(4), default=3, metavar="D", help="0 to 3 (default)"
    )
    check.add_argument("--json", action="store_true", help="print the verdicts as JSON")
    kit = check.add_argument_group("drawn examples", "no scene is named: they draw their own")
    kit.add_argument(
        "--full", action="store_true",
        help="every check of --backend; without it, of all backends and presenters",
    )  # fmt: skip
    kit.add_argument("--presenter", metavar="P", help="every check of this presenter")
    kit.add_argument(
        "--decode", metavar="D",
        help="what reads the presenter's bytes: a built-in presenter's name or MODULE:NAME "
        "(a built-in presenter's own)",
    )  # fmt: skip
    kit.add_argument(
        "--examples", type=_count, metavar="N", help="drawn for each check (100); always the same"
    )
    kit.add_argument(
        "--expect-fail", action="append", metavar="CHECK,...|@FILE",
        help="checks known to fail, in a file one a line, # for notes; one that holds is an error",
    )  # fmt: skip

    bench = add("bench", "measure what each shortcut costs and saves", BENCH_EXAMPLES)
    _add_scene(bench)
    _add_edits(bench)
    bench.add_argument("--backend", metavar="B[,B]", help="default: all but the reference")
    bench.add_argument("--size", type=_pair, metavar="WxH", help="px (320x180)")
    bench.add_argument(
        "--camera", action="append", metavar="FILE[#INDEX]",
        help="a camera to take pictures with; may be given several times",
    )  # fmt: skip
    bench.add_argument(
        "--cameras", type=_count, default=3, metavar="N", help="without --camera: N round the scene"
    )
    bench.add_argument("--threads", type=_threads, metavar="N", help="default: every CPU")
    bench.add_argument("--runs", type=_count, default=5, metavar="N", help="of each row (5)")
    bench.add_argument(
        "--set", action="append", metavar="NAME=VALUE,...", help="a setting of your own to measure"
    )
    bench.add_argument("--presets", action="store_true", help="no single shortcuts")
    bench.add_argument("-o", "--output", metavar="OUT", help="the diagram, .png or .svg")
    bench.add_argument("--csv", metavar="FILE", help="the table as CSV")
    bench.add_argument("--show", action="store_true", help="show the diagram in this terminal")
    bench.add_argument("--json", action="store_true", help="print the table as JSON")
    return parser


def _arranged(argv: Sequence[str], parser: argparse.ArgumentParser) -> list[str]:
    """``argv`` with ``view`` put in where no command is named, and ``--eye -1,0,2`` made to work.

    argparse would take a vector that begins with a minus for an option.
    """
    out: list[str] = []
    words = iter(argv)
    for word in words:
        value = next(words, None) if word in VECTORS else None
        if value is None:
            out.append(word)
        elif re.match(r"-([0-9.]|[xyzXYZ]$)", value):
            out.append(f"{word}={value}")
        else:
            out += [word, value]
    first = out[0] if out else ""
    if first in ("-h", "--help", "--version", *COMMANDS) or first.startswith("--print-completion"):
        return out
    if re.fullmatch(r"[a-z]+", first) and not Path(first).exists():
        from difflib import get_close_matches

        close = get_close_matches(first, COMMANDS, 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        parser.error(f"{first!r} is neither a command nor a file{hint}")
    return ["view", *out]


def _run(words: Sequence[str], parser: argparse.ArgumentParser) -> int:
    if words[:1] == ["--print-completion"] and words[1:] and words[1] in SHELLS:
        import shtab

        print(shtab.complete(parser, words[1]))
        return 0
    arguments = parser.parse_args(words)
    module = importlib.import_module(f"tsplat.commands.{arguments.command}")
    gc.enable()
    run: Callable[[argparse.Namespace], int] = module.run
    return run(arguments)


def _open_streams() -> None:
    """Stands in for a stdout or stderr that the caller has closed, which Python leaves as None."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115 - until exit


def _silence(stream: TextIO) -> None:
    """Lets what is still buffered go nowhere: its reader is gone, or the disk is full."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; the exit code: 0, 1 for an error or a broken contract, 2 for usage."""
    _open_streams()
    if argv is None:  # the process is this program's own
        # Modules are not garbage: looking for it among what is imported, and at exit among
        # everything, takes 40 ms.
        gc.disable()
        atexit.register(gc.freeze)
    # NumPy's OpenBLAS would start a thread for each CPU, which spins for the first 0.1 s and takes
    # that time from threads that load the scene; the products here are too small to be shared.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    parser = make_parser()
    words = _arranged(sys.argv[1:] if argv is None else argv, parser)
    try:
        code = _run(words, parser)
        sys.stdout.flush()
        return code
    except TsplatError as error:
        print(f"tsplat: {printable(error, 1000)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("tsplat: interrupted", file=sys.stderr)
        return 130
    except MemoryError:
        print("tsplat: out of memory; try --max-splats or a smaller --size", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader of our output went away; there is nobody to tell
        _silence(sys.stdout)
        return 1
    except OSError as error:
        _silence(sys.stdout)
        print(f"tsplat: standard output cannot be written: {error.strerror}", file=sys.stderr)
        return 1
