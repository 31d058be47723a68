"""Loads damaged files without end, and keeps each that makes a reader do what it may not.

python -m tests.fuzz spz --runs 100000                     # own mutations, by kind of refusal
python -m tests.fuzz spz --runs 100000 --engine atheris    # guided by coverage: tsplat[fuzz]
python -m tests.fuzz spz --again                           # what was found, loaded once more
python -m tests.fuzz --report                              # what has been run
python -m tests.fuzz --table                               # the same for docs/fuzzing.md

Counts are kept in ``--state`` and go on from there; ``--total`` runs until there are as many.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import random
import re
import shutil
import sys
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KEPT = 1500
"""Inputs that are mutated further beside the seeds."""

PRECISE = 64
"""Every so many executions: bytes counted instead of the process's map."""


def options_of(rng: random.Random) -> dict:
    """Mostly none."""
    return rng.choice(
        [{}] * 8 + [{"sh_float32": True}] * 3 + [{"max_splats": rng.choice((1, 2, 5))}] * 2
        + [{"raw_opacity": True}]
    )  # fmt: skip


class Session:
    """One reader, one engine: what was run, and what was found."""

    def __init__(self, reader: str, engine: str, state: Path, data: Path | None, read=None) -> None:
        from tests.fuzz import seeds
        from tests.fuzz.contract import Guard
        from tests.fuzz.mutators import mutator

        self.reader, self.engine = reader, engine
        self.state = state
        self._file = state / f"{reader}-{engine}.json"
        self.counts = json.loads(self._file.read_text()) if self._file.is_file() else {}
        self.counts = {"executions": 0, "scenes": 0, "cpu": 0.0, "findings": {}, **self.counts}
        self.lines: Counter[str] = Counter(self.counts.get("lines", {}))
        self.seeds = seeds.written(reader)
        if data is not None and data.is_dir():
            self.seeds += seeds.real(reader, data)
        self.corpus = state / "corpus" / reader
        self.corpus.mkdir(parents=True, exist_ok=True)
        self.kept = [f.read_bytes() for f in sorted(self.corpus.iterdir())[:KEPT]]
        self.mutate = mutator(reader, self.seeds)
        if read is None:
            from tsplat.io import load_scene as read
        self._read = read
        memory = Path("/dev/shm")
        self._folder = (memory if memory.is_dir() else state) / f"tsplat-fuzz-{os.getpid()}"
        (self._folder / "case" / "folder").mkdir(parents=True, exist_ok=True)
        (self._folder / "secret.webp").write_bytes(b"RIFF")
        (self._folder / "case" / "secret.webp").write_bytes(b"RIFF")
        self._lay_out = seeds.lay_out
        self._guard = Guard(self._folder / "case")
        for content in (*self.seeds, *(s[: len(s) // 2] for s in self.seeds)):  # imports
            try:
                path = seeds.lay_out(self._folder / "case", reader, content)
                for more in ({}, {"sh_float32": True}, {"max_splats": 1}):
                    self._guard.load(path, self._read, **more)
            except Exception:
                pass
        self._guard.arm()
        self._started = time.process_time()

    def close(self) -> None:
        """Writes the counts and takes the folder away."""
        self.save()
        shutil.rmtree(self._folder, ignore_errors=True)

    def save(self) -> None:
        now = time.process_time()
        self.counts["cpu"] += now - self._started
        self._started = now
        self.counts["lines"] = dict(self.lines.most_common(2000))
        made = self._file.with_suffix(".new")
        made.write_text(json.dumps(self.counts, indent=1))
        made.replace(self._file)

    def load(self, content: bytes, options: dict, *, precisely: bool = False) -> str:
        """See :meth:`tests.fuzz.contract.Guard.load`."""
        path = self._lay_out(self._folder / "case", self.reader, content)
        return self._guard.load(path, self._read, precisely=precisely, **options)

    def execute(self, content: bytes, options: dict) -> bool:
        """Whether what it did was seen for the first time."""
        from tests.fuzz.contract import Finding

        counts = self.counts
        counts["executions"] += 1
        precisely = counts["executions"] % PRECISE == 0
        try:
            line = self.load(content, options, precisely=precisely)
        except Finding as finding:
            self._keep(finding, content, options)
            return False
        if line.startswith(" "):
            counts["scenes"] += 1
            kind = line
        else:
            kind = re.sub(r"[0-9]+", "0", line.partition(": ")[2])
            kind = re.sub(r"'.*?'|got .*?;", "'", kind)[:90]
        self.lines[kind] += 1
        return self.lines[kind] == 1

    def _keep(self, finding: Exception, content: bytes, options: dict) -> None:
        name = str(finding).replace(str(self._folder), "")
        name = re.sub(r"0x\w+|[0-9][0-9.]*|b?'.*?'|b?\".*?\"", "_", " ".join(name.split()))[:120]
        known = self.counts["findings"]
        known[name] = known.get(name, 0) + 1
        if known[name] > 3:
            return
        folder = self.state / "findings" / self.reader
        folder.mkdir(parents=True, exist_ok=True)
        digest = hashlib.sha256(content).hexdigest()[:12]
        (folder / f"{digest}.bin").write_bytes(content)
        (folder / f"{digest}.txt").write_text(f"{options}\n{finding}\n")
        print(f"{self.reader}: {str(finding)[:300]} {options} -> {digest}", flush=True)

    def keep_input(self, content: bytes) -> None:
        """Mutates it further, in later sessions too."""
        if len(content) > 1 << 16 or len(self.kept) >= KEPT:
            return
        self.kept.append(content)
        digest = hashlib.sha256(content).hexdigest()[:16]
        (self.corpus / digest).write_bytes(content)

    def pick(self, rng: random.Random) -> bytes:
        if self.kept and rng.random() < 0.3:
            return rng.choice(self.kept)
        return rng.choice(self.seeds)


def run_random(session: Session, runs: int, seconds: float) -> None:
    """Own mutations; an input that is refused in a way not seen before is mutated further."""
    until = time.monotonic() + seconds
    first = session.counts["executions"]
    if first == 0:
        for seed in session.seeds:
            session.execute(seed, {})
    while (done := session.counts["executions"]) - first < runs and time.monotonic() < until:
        rng = random.Random(f"{session.reader} {done}")
        content = session.mutate(rng, session.pick(rng))
        if session.execute(content, options_of(rng)):
            session.keep_input(content)
        if done % 5000 == 0:
            session.save()


def run_atheris(session: Session, runs: int, seconds: float) -> None:
    """Mutations guided by which branches of tsplat.io they reach."""
    import atheris

    first = session.counts["executions"]

    def once(content: bytes) -> None:
        rng = random.Random(len(content) * 7919 + sum(content[:64]))
        session.execute(content, options_of(rng))
        if session.counts["executions"] % 5000 == 0:
            session.save()
        if session.counts["executions"] - first >= runs:
            session.close()
            os._exit(0)  # libFuzzer would end the process without a word to Python

    def mutated(content: bytes, most: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if rng.random() < 0.35:
            return atheris.Mutate(content, most)
        source = content if content and rng.random() < 0.9 else session.pick(rng)
        made = session.mutate(rng, source)
        return made[:most]

    folder = session.state / "atheris" / session.reader
    folder.mkdir(parents=True, exist_ok=True)
    for content in (*session.seeds, *session.kept):
        (folder / hashlib.sha256(content).hexdigest()[:16]).write_bytes(content)
    most = max(map(len, session.seeds)) + 4096
    atheris.Setup(
        [
            sys.argv[0], str(folder), f"-max_len={most}", "-rss_limit_mb=0", "-timeout=300",
            f"-max_total_time={int(seconds)}", "-print_final_stats=0", "-verbosity=0",
            f"-seed={1 + first % (1 << 30)}", "-detect_leaks=0",
        ],
        once,
        custom_mutator=mutated,
    )  # fmt: skip
    try:
        atheris.Fuzz()
    finally:
        session.close()


def report(state: Path) -> None:
    """Executions, scenes, kinds of refusal, CPU time and findings by reader and engine."""
    row = "{:<16}{:<10}{:>11}{:>9}{:>9}{:>8}  {}"
    print(row.format("reader", "engine", "executions", "scenes", "refusals", "cpu s", "findings"))
    for file in sorted(state.glob("*.json")):
        c = json.loads(file.read_text())
        reader, _, engine = file.stem.rpartition("-")
        kinds = sum(not kind.startswith(" ") for kind in c.get("lines", {}))
        numbers = c["executions"], c["scenes"], kinds, round(c["cpu"]), len(c["findings"])
        print(row.format(reader, engine, *numbers))
        for name, count in c["findings"].items():
            print(f"    {count:>6} x {name}")


def table(state: Path) -> None:
    """Rows of docs/fuzzing.md: executions by engine, scenes, kinds of refusal, kept findings."""
    from tests.fuzz.seeds import READERS

    for reader in READERS:
        files = [state / f"{reader}-{engine}.json" for engine in ("random", "atheris")]
        both = [json.loads(f.read_text()) if f.is_file() else {"executions": 0} for f in files]
        runs = [c["executions"] for c in both]
        scenes = sum(c.get("scenes", 0) for c in both)
        kinds = {k for c in both for k in c.get("lines", {}) if not k.startswith(" ")}
        cells = [*runs, sum(runs), scenes, len(kinds)]
        print(f"| `{reader}` | " + " | ".join(f"{c:,}" for c in cells) + " |")


def again(session: Session) -> None:
    """Loads what was found of the reader, and says of each whether it still is a finding."""
    from tests.fuzz.contract import Finding

    for file in sorted((session.state / "findings" / session.reader).glob("*.bin")):
        options = ast.literal_eval(file.with_suffix(".txt").read_text().splitlines()[0])
        try:
            print(f"{file.stem}: mended: {session.load(file.read_bytes(), options)[:120]}")
        except Finding as finding:
            print(f"{file.stem}: {finding}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("reader", nargs="?")
    parser.add_argument("--engine", choices=("random", "atheris"), default="random")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--total", type=int)
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--state", type=Path, default=ROOT / ".fuzz")
    parser.add_argument("--data", type=Path, default=None, help="a folder of real files")
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--again", action="store_true")
    args = parser.parse_args()
    if args.table:
        table(args.state)
        return
    if args.report or args.reader is None:
        report(args.state)
        return
    if args.engine == "atheris":
        import atheris

        with atheris.instrument_imports(include=["tsplat.io"], enable_loader_override=False):
            from tsplat.plugins import plugins

            plugins()
    session = Session(args.reader, args.engine, args.state, args.data)
    if args.again:
        again(session)
        session.close()
        return
    runs = args.runs
    if args.total is not None:
        runs = args.total - session.counts["executions"]
    if runs > 0:
        engine = run_atheris if args.engine == "atheris" else run_random
        engine(session, runs, args.seconds)
    session.close()


if __name__ == "__main__":
    main()
