"""Decoded arrays -> a Scene: normalised, re-based, and without what cannot be drawn.

Every reader ends here, so that no stage ever meets a NaN, a zero quaternion or a negative scale.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsplat.core.errors import SceneError
from tsplat.core.types import F32, F64, I32, Floats, Scene
from tsplat.io.half import to_half

if TYPE_CHECKING:
    from tsplat.io.native import Decoder

CHUNK = 4096
"""Rows worked on at a time: 1 MB of a degree-3 scene. Fewer, and threads spend their time on
waiting for each other between NumPy's steps; more, and they leave a core's cache. Of 1,024 to
16,384, the fastest on two cores (1M Gaussians of degree 3)."""

THREADS = 8
"""More would wait for each other: between two of NumPy's steps only one runs."""

DETAIL = 1e-3
"""Standard deviations of a typical Gaussian that rounding a position to float32 may cost."""

OPACITY_SLACK = 1e-6
"""An opacity this far outside 0..1 is rounding and is clipped; farther, and it is a fault."""

FLOAT32_MAX = float(np.finfo(np.float32).max)

SH_MAX = FLOAT32_MAX / 16
"""A coefficient beyond it may make a colour that float32 does not hold: the largest values of the
sixteen harmonics (half.SH_PEAKS) sum to 8.9. Infinity times 0 would be NaN beside the Gaussian."""

MEAN = "mean not finite"
QUAT = "quaternion not finite"
QUAT_ZERO = "quaternion of length zero"
SCALE = "scale not finite"
SCALE_NEGATIVE = "negative scale"
OPACITY = "opacity not a number"
OPACITY_RANGE = "opacity outside 0..1"
SH = "colour not finite"
REASONS = (MEAN, QUAT, QUAT_ZERO, SCALE, SCALE_NEGATIVE, OPACITY, OPACITY_RANGE, SH)


def sigmoid(logits: F64) -> F64:
    """1 / (1 + e^-x) in float64; exactly 0 and 1 at the infinities."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        return 1 / (1 + np.exp(-logits))


class SceneBuilder:
    """Takes decoded Gaussians a few thousand rows at a time; ``build`` gives the Scene.

    Rows that cannot be drawn are left out and counted by the first reason that applies.
    Results are float32 whatever comes in, so peak memory is the scene and one chunk a thread.
    """

    def __init__(
        self, capacity: int, coefficients: int, *, wide: bool = False, half: bool = False
    ) -> None:
        """Room for ``capacity`` Gaussians.

        ``wide`` keeps means in float64 until ``build`` has chosen an origin. ``half`` keeps
        coefficients in float16; whether that will do is for :attr:`sh_error` to say.
        """
        self._means = np.empty((capacity, 3), np.float64 if wide else np.float32)
        self._quats = np.empty((capacity, 4), np.float32)
        self._scales = np.empty((capacity, 3), np.float32)
        self._opacities = np.empty(capacity, np.float32)
        self._sh = np.empty((capacity, coefficients, 3), np.float16 if half else np.float32)
        self._wide = wide
        self._count = 0
        self._gaps: list[NDArray[np.integer]] = []  # rows that nothing was put into
        self._lock = threading.Lock()
        self.dropped: Counter[str] = Counter()
        self.sh_error = 0.0  # of what has been added; see Scene.sh_error

    def __len__(self) -> int:
        return self._count

    def add(
        self,
        means: Floats,  # [n, 3]     world units
        quats: Floats,  # [n, 4]     w, x, y, z; any length
        scales: Floats,  # [n, 3]    world units, linear
        opacities: Floats,  # [n]    0..1
        sh: Floats,  # [n, K, 3]
        to: slice | NDArray[np.integer],
    ) -> None:
        """Puts the rows that can be drawn into rows ``to``, n of the builder's capacity.

        Threads may add at once, each to rows of its own. All rows must be added to before
        ``build``, which closes the gaps that others leave.
        """
        # what overflows is dropped; what underflows is 0, or close to it
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            if not self._wide:
                means = means.astype(np.float32, copy=False)
            scales = scales.astype(np.float32, copy=False)
            sh = sh.astype(np.float32, copy=False)
            units, lengths = _normalised(quats)
            # after re-basing a mean may be twice as far out as it was
            limit = FLOAT32_MAX / 2 if self._wide else FLOAT32_MAX
            dropped: Counter[str] = Counter()
            keep: NDArray[np.bool_] | slice = slice(None)
            gaps: list[NDArray[np.integer]] = []
            if not _sound(means, lengths, scales, opacities, sh, limit):
                keep = _judge(means, lengths, scales, opacities, sh, limit, dropped)
                rows = np.arange(to.start, to.stop) if isinstance(to, slice) else to
                to, gaps = rows[keep], [rows[~keep]]
        with np.errstate(under="ignore"):
            _put(self._means, to, means[keep])
            _put(self._quats, to, units[keep])
            _put(self._scales, to, scales[keep])
            self._opacities[to] = np.clip(opacities[keep], 0, 1)
            error = self._put_sh(to, sh[keep])
        with self._lock:
            self._count += len(means) - dropped.total()
            self._gaps += gaps
            self.dropped.update(dropped)
            self.sh_error = max(self.sh_error, error)

    def decode(self, decoder: Decoder, rows: NDArray[np.void] | F32, to: slice | I32) -> bool:
        """Like :meth:`add`, of rows as a file has them.

        False if some cannot be drawn: then they all have to be added.
        """
        error = None
        if not self._wide:
            error = decoder(
                rows, self._means, self._quats, self._scales, self._opacities, self._sh, to
            )
        if error is None:
            return False
        with self._lock:
            self._count += len(rows)
            self.sh_error = max(self.sh_error, error)
        return True

    def _put_sh(self, to: slice | NDArray[np.integer], sh: F32) -> float:
        """The colour error that keeping ``sh`` costs."""
        if sh.dtype == self._sh.dtype:
            _put(self._sh, to, sh)
            return 0.0
        halves = np.empty(sh.shape, np.float16)
        error = to_half(np.ascontiguousarray(sh), halves)
        _put(self._sh, to, halves)
        return error

    def _close_gaps(self, numbers: I32 | None) -> I32 | None:
        """Moves all rows together, in order, and counts ``numbers`` anew."""
        if not self._gaps:
            return numbers
        full = np.ones(len(self._means), np.bool_)
        for gaps in self._gaps:
            full[gaps] = False
        size = 0
        for start in range(0, len(full), CHUNK):
            rows = start + np.flatnonzero(full[start : start + CHUNK])
            for array in (self._means, self._quats, self._scales, self._opacities, self._sh):
                array[size : size + len(rows)] = array[rows]
            size += len(rows)
        if numbers is None:
            return None
        left = np.zeros(len(full), np.bool_)
        left[numbers[full]] = True
        return (np.cumsum(left, dtype=np.int32) - 1)[numbers[full]]

    def build(self, name: str, origin: F64 | None = None, *, numbers: I32 | None = None) -> Scene:
        """The Scene of everything added; the builder is used up.

        ``origin`` is what the means were relative to. ``numbers`` [capacity] says which row of the
        file was put into each; the Scene's count only those that are left.
        """
        base = np.zeros(3) if origin is None else origin
        numbers = self._close_gaps(numbers)
        size = len(self)
        means = self._means[:size]
        if self._wide:
            shift = detail_origin(means, self._scales[:size])
            means = means - shift
            base = base + shift
        with np.errstate(under="ignore"):
            self._means = np.ascontiguousarray(means, np.float32)
        self._quats, self._scales = self._quats[:size], self._scales[:size]
        self._opacities, self._sh = self._opacities[:size], self._sh[:size]
        return Scene(
            means=self._means,
            quats=self._quats,
            scales=self._scales,
            opacities=self._opacities,
            sh=self._sh,
            origin=base,
            name=name,
            dropped=MappingProxyType(dict(sorted(self.dropped.items(), key=_place))),
            sh_error=self.sh_error,
            numbers=numbers,
        )


def _put(
    array: NDArray[np.floating], to: slice | NDArray[np.integer], rows: NDArray[np.floating]
) -> None:
    """``array[to] = rows``, of whole rows as single items: NumPy puts those twice as fast."""
    if isinstance(to, slice) or not len(to):
        array[to] = rows
        return
    item = np.dtype((np.void, array[0].nbytes))
    rows = np.ascontiguousarray(rows, array.dtype)
    array.reshape(len(array), -1).view(item)[to, 0] = rows.reshape(len(to), -1).view(item)[:, 0]


def _place(dropped: tuple[str, int]) -> int:
    """Where a reason stands in a list of them, whichever thread met it first."""
    return REASONS.index(dropped[0]) if dropped[0] in REASONS else -1


def _sound(
    means: Floats, lengths: F64, scales: F32, opacities: Floats, sh: F32, limit: float
) -> bool:
    """Whether every row can be drawn, as nearly all can; False may be a false alarm.

    A few extremes, in which NaN wins, take a third of the time that judging every row does.
    """
    return bool(
        np.abs(means).max(initial=0) <= limit
        and lengths.min(initial=1) > 0
        and lengths.max(initial=1) < np.inf
        and scales.min(initial=0) >= 0
        and scales.max(initial=0) < np.inf
        and np.abs(opacities - 0.5).max(initial=0) <= 0.5 + OPACITY_SLACK
        and sh.max(initial=0) <= SH_MAX
        and sh.min(initial=0) >= -SH_MAX
    )


def _judge(
    means: Floats, lengths: F64, scales: F32, opacities: Floats, sh: F32, limit: float,
    dropped: Counter[str],
) -> NDArray[np.bool_]:  # fmt: skip
    """Which rows can be drawn; the others are counted in ``dropped`` by the first reason."""
    faults = {
        MEAN: ~(np.abs(means) <= limit),
        QUAT: ~np.isfinite(lengths),
        QUAT_ZERO: lengths == 0,
        SCALE: ~np.isfinite(scales),
        SCALE_NEGATIVE: scales < 0,
        OPACITY: np.isnan(opacities),
        OPACITY_RANGE: np.abs(opacities - 0.5) > 0.5 + OPACITY_SLACK,
        SH: ~(np.abs(sh) <= SH_MAX),
    }
    bad = np.zeros(len(means), np.bool_)
    for reason, where in faults.items():
        rows = where.reshape(len(bad), -1).any(1)
        new = int(np.count_nonzero(rows & ~bad))
        if new:
            dropped[reason] = new
        bad |= rows
    return ~bad


def judged(
    means: Floats, quats: Floats, scales: F32, opacities: Floats, sh: F32, *, wide: bool
) -> NDArray[np.bool_]:
    """[n] which Gaussians a :class:`SceneBuilder` that is ``wide`` would keep."""
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        lengths = _normalised(quats)[1]
        limit = FLOAT32_MAX / 2 if wide else FLOAT32_MAX
        return _judge(means, lengths, scales, opacities, sh, limit, Counter())


def _normalised(quats: Floats) -> tuple[F64, F64]:
    """Unit quaternions, and their lengths before: 0 or not finite where there is none."""
    with np.errstate(divide="ignore", invalid="ignore", under="ignore"):
        wide = quats.T.astype(np.float64, order="C")  # [4, n]: sums down columns are fast
        if quats.dtype != np.float32:  # whose squares float64 holds, but not those of 1e300
            largest = np.abs(wide).max(0)
            wide /= np.where(largest > 0, largest, 1)
        lengths = np.sqrt((wide * wide).sum(0))
        wide /= lengths
    return wide.T, lengths


def median(values: NDArray[np.floating]) -> float:
    """Of those that are finite; 0 of none. NumPy's would import numpy.ma."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0
    middle = [(len(finite) - 1) // 2, len(finite) // 2]
    low, high = np.partition(finite, middle)[middle].astype(np.float64) / 2
    return float(low + high)


def detail_origin(means: Floats, scales: F32) -> F64:
    """[3] what to subtract from float64 ``means`` before they become float32; often zero.

    It is zero unless rounding to float32 moves a typical mean (half a unit in the last place of
    the median distance from zero along any axis) by more than ``DETAIL`` of a typical Gaussian
    (the median of largest standard deviations). Else it is the median mean.
    """
    if not len(means):
        return np.zeros(3)
    far = max(median(np.abs(column)) for column in means.T)
    if far * 2.0**-24 <= DETAIL * median(scales.max(1)):
        return np.zeros(3)
    return np.array([median(column) for column in means.T])


def _floats(name: str, array: ArrayLike, shape: tuple[int | str, ...]) -> Floats:
    """``array`` as float32 if it was (or is narrower), as float64 otherwise, of ``shape``."""
    given = np.asarray(array)
    if given.dtype.kind not in "fiu":
        raise SceneError(f"{name}: expected numbers, got {given.dtype.name}")
    fits = given.ndim == len(shape) and all(
        isinstance(s, str) or s == n for s, n in zip(shape, given.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join(map(str, shape))
        raise SceneError(f"{name}: expected [{wanted}], got {list(given.shape)}")
    if np.can_cast(given.dtype, np.float32):
        return given.astype(np.float32, copy=False)
    with np.errstate(over="ignore"):  # long double beyond float64 becomes inf and is dropped
        return given.astype(np.float64, copy=False)


def scene_from_arrays(
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    sh: ArrayLike,
    *,
    name: str = "scene",
    origin: ArrayLike | None = None,
    dropped: Mapping[str, int] | None = None,
) -> Scene:
    """A Scene of arrays of any number type; none of them is kept or changed.

    Quaternions are normalised. Gaussians that cannot be drawn (anything not finite, a quaternion
    of length zero, a negative scale, an opacity outside 0..1) are left out and counted in
    ``Scene.dropped``. float32 means keep their bits; float64 means get an origin where float32
    would lose detail (:func:`detail_origin`).

    Args:
        means: [N, 3] world units, relative to ``origin``.
        quats: [N, 4] w, x, y, z; any length but zero.
        scales: [N, 3] world units, linear.
        opacities: [N] in 0..1.
        sh: [N, K, 3] with K in {1, 4, 9, 16}, or [N, 3] for degree 0; coefficients as in the
            files of Kerbl et al. 2023: colour is 0.5 + 0.2820948 sh[:, 0] + ...
        name: for messages.
        origin: [3] world units, added to what re-basing finds.
        dropped: counts by reason of what was left out before.

    Raises:
        SceneError: an array has another shape, or holds no numbers.
    """
    m = _floats("means", means, ("N", 3))
    n = len(m)
    q = _floats("quats", quats, (n, 4))
    s = _floats("scales", scales, (n, 3))
    o = _floats("opacities", opacities, (n,))
    colours = np.asarray(sh)
    c = _floats("sh", colours[:, None] if colours.ndim == 2 else colours, (n, "K", 3))
    if c.shape[1] not in (1, 4, 9, 16):
        raise SceneError(f"sh: expected 1, 4, 9 or 16 coefficients, got {c.shape[1]}")
    base: NDArray[np.float64] | None = None
    if origin is not None:
        base = _floats("origin", origin, (3,)).astype(np.float64)
        if not np.isfinite(base).all():
            raise SceneError(f"origin: expected finite numbers, got {base.tolist()}")
    builder = SceneBuilder(n, c.shape[1], wide=m.dtype == np.float64)
    builder.dropped.update(dropped or {})
    for start in range(0, n, CHUNK):
        rows = slice(start, min(start + CHUNK, n))
        builder.add(m[rows], q[rows], s[rows], o[rows], c[rows], rows)
    return builder.build(name, base)
