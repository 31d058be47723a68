"""What ``--help`` says at length: the whole program, and examples of each command."""

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
