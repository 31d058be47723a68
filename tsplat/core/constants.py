"""Every number that two backends must share, each with its source.

Codebases of the field disagree on several of these. tsplat follows gsplat
(https://github.com/nerfstudio-project/gsplat), whose names have become the field's.
The C kernel reads the same numbers from ``backends/cffi/constants.h``, which
``python -m tsplat.backends.cffi.build --constants`` writes from this file.
"""

NEAR = 0.01
"""World units; Gaussians at or in front of it are not drawn (gsplat ``near_plane``)."""

FAR = 1e10
"""World units; Gaussians at or behind it are not drawn (gsplat ``far_plane``)."""

FAR_MAX = 1e31
"""World units; no far plane is farther. float32 ends at 3.4e38, depths must be finite, and what
rounds them to few bits multiplies them by up to 4e6 (``RenderParams.depth_split``)."""

EPS2D = 0.3
"""px^2 added to both variances of a projected Gaussian: the low-pass filter of EWA splatting
(Zwicker et al. 2001, eq. 35; INRIA forward.cu ``0.3f``; gsplat ``eps2d``)."""

CLAMP_MARGIN = 0.3
"""Half fields of view past the image border at which x/z and y/z stop growing in the Jacobian
(INRIA ``1.3f * tan_fov``; gsplat's per-border form of it)."""

ALPHA_MAX = 0.999
"""A splat never covers more than this, so transmittance never reaches 0 in one step
(gsplat ``MAX_ALPHA``)."""

ALPHA_THRESHOLD = 1.0 / 255.0
"""Below this alpha a splat is not drawn at a pixel (INRIA forward.cu, gsplat)."""

TRANSMITTANCE_MIN = 1e-4
"""A pixel stops before the splat that would take its transmittance to this or below
(INRIA forward.cu ``0.0001f``; gsplat stops at ``<=``, and so does tsplat)."""

ALPHA_FLOOR = 1e-12
"""Where the alpha threshold is 0 (the ideal picture), extents end at this alpha instead of at
infinity. A picture of N Gaussians is short of the true sum by at most N times this."""

VARIANCE_MAX = 1e18
"""px^2. A projected Gaussian whose variances sum to more is dropped and counted: the square
root of its determinant's largest term, 1e36, is the last that float32 holds with room to spare."""

OFFSCREEN_MAX = 1e18
"""px. A projected mean farther out than this is dropped and counted, for the same reason."""

RADIUS_SLACK = 1e-5
RADIUS_PAD = 1e-3
"""A splat's box is made larger by this fraction and by this many px, so that rounding to float32
(6e-5 px at a mean of 1500 px) can never push a reached pixel out of it."""

SH_DEGREE_MAX = 3
"""Highest degree of spherical harmonics that the stages evaluate."""

# Real spherical harmonics, in INRIA's order and signs (diff-gaussian-rasterization auxiliary.h;
# Sloan 2013, "Efficient Spherical Harmonic Evaluation", appendix A2).
SH_C0 = 0.28209479177387814
SH_C1 = 0.4886025119029199
SH_C2 = (
    1.0925484305920792,
    -1.0925484305920792,
    0.31539156525252005,
    -1.0925484305920792,
    0.5462742152960396,
)
SH_C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)

EXP2_POLY = (
    1.000000001e00,
    6.931472057e-01,
    2.402264689e-01,
    5.550328777e-02,
    9.618488957e-03,
    1.339993122e-03,
    1.534581202e-04,
)
"""2^f on [-1/2, 1/2] as a polynomial in f, constant term first: minimax in relative error, 1.9e-9
in exact arithmetic, 9.6e-8 when evaluated in float32 (bench/fit_exp2.py)."""

EXP2_FLOOR = (
    9.999999251e-01,
    6.931530732e-01,
    2.401536170e-01,
    5.582631805e-02,
    8.989340091e-03,
    1.877576675e-03,
)
"""2^f on [0, 1] likewise, for processors that round down in one step: 7.5e-8 in exact arithmetic,
1.6e-7 when evaluated in float32."""
