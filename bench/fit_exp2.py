"""Fits constants.EXP2_POLY and EXP2_FLOOR: 2^f by a polynomial, minimax in relative error.

    python bench/fit_exp2.py [DEGREE [LOW]]    # on [LOW, LOW + 1]; LOW is -1/2 unless given

Remez's exchange: solve for equal, alternating errors at DEGREE + 2 points, move the points to
the extremes of the error found, repeat.
"""

import sys

import numpy as np
from numpy.polynomial.polynomial import polyval


def fit(degree: int, low: float) -> np.ndarray:
    """Coefficients, constant term first."""
    points = degree + 2
    x = low + 0.5 - 0.5 * np.cos(np.pi * np.arange(points) / (points - 1))
    grid = np.linspace(low, low + 1, 200_001)
    signs = (-1.0) ** np.arange(points)
    for _ in range(30):
        powers = np.vander(x, degree + 1, increasing=True) / np.exp2(x)[:, None]
        solved = np.linalg.solve(np.hstack([powers, signs[:, None]]), np.ones(points))
        error = polyval(grid, solved[:-1]) / np.exp2(grid) - 1
        runs = np.split(np.arange(len(grid)), np.flatnonzero(np.diff(np.sign(error))) + 1)
        if len(runs) != points:
            break
        x = np.array([grid[run[np.argmax(abs(error[run]))]] for run in runs])
    return solved[:-1]


def main() -> None:
    degree = int(sys.argv[1]) if sys.argv[1:] else 6
    low = float(sys.argv[2]) if sys.argv[2:] else -0.5
    coefficients = fit(degree, low)
    grid = np.linspace(low, low + 1, 200_001, dtype=np.float32)
    value = np.full_like(grid, coefficients[-1])
    for c in coefficients[-2::-1].astype(np.float32):
        value = value * grid + c
    exact = np.exp2(grid.astype(np.float64))
    print([f"{c:.9e}" for c in coefficients])
    fitted = polyval(grid.astype(np.float64), coefficients)
    print(f"relative error in exact arithmetic {abs(fitted / exact - 1).max():.2g}")
    print(f"relative error in float32 {abs(value / exact - 1).max():.2g}")


if __name__ == "__main__":
    main()
