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
from pathlib import Path
from typing import TextIO

from tsplat._version import __version__
from tsplat.commands import INTERRUPTED, texts, values
from tsplat.core.errors import TsplatError, printable

COMMANDS = ("view", "cat", "render", "convert", "info", "plugins", "check", "bench")
SHELLS = ("bash", "zsh", "tcsh")
VECTORS = ("--eye", "--target", "--up", "--background", "--crop")


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
        "--max-splats", type=values.count, metavar="N", help="keep N Gaussians, an even sample"
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
        "--threads",
        type=values.threads,
        metavar="N",
        help="default: every CPU this process may use",
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
    pose.add_argument("--eye", type=values.vector, metavar="X,Y,Z", help="where the camera stands")
    pose.add_argument(
        "--target",
        type=values.vector,
        metavar="X,Y,Z",
        help="what it looks at (the scene's middle)",
    )
    pose.add_argument(
        "--up", type=values.up, metavar="AXIS",
        help="which way is up: x, -x, y, -y, z, -z or X,Y,Z (what is known of the file: `tsplat "
        "info`; -y if nothing is)",
    )  # fmt: skip
    pose.add_argument(
        "--flip-y", action="store_true", help="up is the other way: for scenes that stand on "
        "their head"
    )  # fmt: skip
    pose.add_argument(
        "--fov", type=values.positive, metavar="DEG", help="vertical field of view, degrees (50)"
    )
    pose.add_argument("--near", type=values.positive, metavar="Z", help="nothing nearer is drawn")
    pose.add_argument("--far", type=values.positive, metavar="Z", help="nothing farther is drawn")


def _add_edits(
    parser: argparse.ArgumentParser, text: str = "the scene is as if its file had been so"
) -> None:
    edits = parser.add_argument_group("edits", text)
    edits.add_argument(
        "--splat-scale",
        type=values.positive,
        default=1.0,
        metavar="F",
        help="times as large splats (1)",
    )
    edits.add_argument(
        "--min-opacity", type=values.share, default=0.0, metavar="O",
        help="leave out Gaussians of less opacity, 0 to 1 (0)",
    )  # fmt: skip
    edits.add_argument(
        "--max-scale", type=values.positive, metavar="S",
        help="leave out Gaussians with a standard deviation above S world units",
    )  # fmt: skip
    edits.add_argument(
        "--trim", type=values.percentile, default=0.0, metavar="P",
        help="leave out strays: before the percentile P of x, y or z, or behind 100 - P (0)",
    )  # fmt: skip
    edits.add_argument(
        "--saturation",
        type=values.factor,
        default=1.0,
        metavar="F",
        help="of all colours; 0 is grey (1)",
    )
    edits.add_argument(
        "--crop", type=values.box, metavar="X0,Y0,Z0,X1,Y1,Z1",
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
        "--background",
        type=values.color,
        default=(0.0, 0.0, 0.0),
        metavar="R,G,B",
        help="0..1 each",
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
    parser = argparse.ArgumentParser("tsplat", description=texts.DESCRIPTION, formatter_class=raw)
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

    view = add("view", "look at a scene in this terminal", texts.VIEW_EXAMPLES)
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
        "--fps", type=values.positive, default=30.0, metavar="N",
        help="frames a second (30): a moving picture has as many pixels as that allows",
    )  # fmt: skip
    _add_terminal(view)
    view.add_argument(
        "--max-rate", type=values.bits, metavar="R",
        help="send at most so many bits/s, such as 500k or 2M (default: what the link takes)",
    )  # fmt: skip
    view.add_argument(
        "--verify", action="store_true",
        help="compare still frames with the float64 reference, some tiles at a time, meanwhile",
    )  # fmt: skip

    cat = add("cat", "print a picture of each scene, among the terminal's text", texts.CAT_EXAMPLES)
    _add_scene(cat, many=True)
    cat.add_argument("--columns", type=values.cells, metavar="N", help="width in cells at most")
    cat.add_argument("--rows", type=values.cells, metavar="N", help="height in cells at most")
    _add_presenter(cat)
    _add_pose(cat)
    _add_engine(cat)
    _add_quality(cat)
    _add_edits(cat)
    _add_background(cat)

    render = add("render", "make a picture of a scene", texts.RENDER_EXAMPLES)
    _add_scene(render)
    render.add_argument(
        "-o", "--output", required=True, metavar="OUT",
        help=".png .jpg .webp, .npy (float32 premultiplied RGBA), "
        ".npz (rgb, transmittance, depth, camera), - for PNG on stdout",
    )  # fmt: skip
    render.add_argument(
        "--size", type=values.pair, metavar="WxH",
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
        "--frames",
        type=values.count,
        metavar="N",
        help="how many (those of the path's seconds, or 4 s)",
    )
    film.add_argument("--fps", type=values.positive, metavar="R", help="frames a second (25)")
    film.add_argument(
        "--force", action="store_true", help="make frames of a PNG sequence again that are there"
    )
    film.add_argument("--presenter", metavar="P", help="what draws in a .cast (halfblock)")
    _add_engine(render)
    _add_quality(render)
    _add_edits(render)
    render.add_argument(
        "--background", type=values.color, default=(0.0, 0.0, 0.0), metavar="R,G,B|none",
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
        "--repeat", type=values.count, default=1, metavar="N", help="render N times, for timing"
    )
    render.add_argument("--json", action="store_true", help="print facts and timings as JSON")

    convert = add("convert", "write a scene in another format", texts.CONVERT_EXAMPLES)
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
        "--format-version", type=values.count, metavar="V", help="2, 3 (default) or 4 (zstd)"
    )
    spz.add_argument(
        "--fractional-bits", type=values.fraction, metavar="N",
        help="of positions, 0 to 23 (12; more for small Gaussians, fewer for far ones)",
    )  # fmt: skip
    spz.add_argument(
        "--sh-bits", type=values.sh_bits, metavar="B[,B]",
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
    measuring.add_argument(
        "--size", type=values.pair, metavar="WxH", help="of pictures, px (480x270)"
    )
    measuring.add_argument(
        "--cameras", metavar="FILE",
        help="more cameras to compare from (cameras.json beside the scene or above it)",
    )  # fmt: skip
    measuring.add_argument("--backend", default="auto", metavar="B", help="what draws (auto)")
    measuring.add_argument("--threads", type=values.threads, metavar="N", help="default: every CPU")

    info = add("info", "say what is in a scene file", texts.INFO_EXAMPLES)
    _add_scene(info, optional=False)
    _add_edits(info)
    info.add_argument("--json", action="store_true", help="print it as JSON")

    plugins = add(
        "plugins", "list backends, presenters, readers and writers", texts.PLUGINS_EXAMPLES
    )
    _add_terminal(plugins)
    plugins.add_argument("--json", action="store_true", help="print it as JSON")

    check = add("check", "compare every backend with the reference", texts.CHECK_EXAMPLES)
    _add_scene(check)
    _add_edits(check)
    check.add_argument("--backend", metavar="B", help="only this one (default: all available)")
    check.add_argument(
        "--size",
        type=values.pair,
        metavar="WxH",
        help="px (the camera's own, made smaller than 640, or 320x200)",
    )
    check.add_argument("--camera", metavar="FILE[#INDEX]", help="default: frames the scene")
    check.add_argument("--threads", type=values.threads, metavar="N", help="default: every CPU")
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
        "--examples",
        type=values.count,
        metavar="N",
        help="drawn for each check (100); always the same",
    )
    kit.add_argument(
        "--expect-fail", action="append", metavar="CHECK,...|@FILE",
        help="checks known to fail, in a file one a line, # for notes; one that holds is an error",
    )  # fmt: skip

    bench = add("bench", "measure what each shortcut costs and saves", texts.BENCH_EXAMPLES)
    _add_scene(bench)
    _add_edits(bench)
    bench.add_argument("--backend", metavar="B[,B]", help="default: all but the reference")
    bench.add_argument("--size", type=values.pair, metavar="WxH", help="px (320x180)")
    bench.add_argument(
        "--camera", action="append", metavar="FILE[#INDEX]",
        help="a camera to take pictures with; may be given several times",
    )  # fmt: skip
    bench.add_argument(
        "--cameras",
        type=values.count,
        default=3,
        metavar="N",
        help="without --camera: N round the scene",
    )
    bench.add_argument("--threads", type=values.threads, metavar="N", help="default: every CPU")
    bench.add_argument("--runs", type=values.count, default=5, metavar="N", help="of each row (5)")
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
        return INTERRUPTED
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
