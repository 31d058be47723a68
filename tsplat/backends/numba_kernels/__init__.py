"""The four stages in numba: ``wrap`` checks, lends and calls; the others hold the kernels."""
