"""Tests of the hard cases: each wrong backend is caught by those meant for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.meta.wrong import REFERENCE, WRONG
from tsplat.core import reference
from tsplat.core.stages import Counts, Stages
from tsplat.testing.stiff import CASES, REFUSALS, Refusal, check_refusal, check_stiff, prepared

BY_NAME = {case.name: case for case in CASES}
NEAR = "on the near and the far plane"
TURNED = "one float64 in front of a turned near plane"
BEYOND = "depths beyond the end of float32"
ON = "exactly on a turned near plane"


def projecting(change):
    """A backend whose project stage gets a changed scene, camera and params."""

    def project(scene, camera, params, workspace):
        return reference.project(*change(scene, camera, params))

    return replace(REFERENCE, project=project)


def patched(stage, **numbers):
    """The reference with other constants in one stage."""

    def run(*arguments):
        with pytest.MonkeyPatch.context() as patch:
            for name, value in numbers.items():
                patch.setattr(reference, name, value)
            return getattr(reference, stage)(*arguments)

    return replace(REFERENCE, **{stage: run})


def changed(change):
    """A backend whose splats are changed."""

    def project(scene, camera, params, workspace):
        return change(reference.project(scene, camera, params), scene, camera, params)

    return replace(REFERENCE, project=project)


def _kept(splats, keep):
    names = ("means2d", "factors", "depths", "opacities", "colors", "radii", "gaussian_ids")
    return replace(splats, **{name: getattr(splats, name)[keep] for name in names})


def _near_in_float32(splats, scene, camera, params):
    return _kept(splats, splats.depths > np.float32(camera.near))


def _other_order(scene, camera, params):
    """Camera z of a single Gaussian, summed from the other end; moves the near plane instead."""
    (d,), (p,) = reference.camera_space(scene, camera, slice(0, 1))
    r = camera.rotation[2]
    z = r[0] * d[0] + (r[1] * d[1] + r[2] * d[2])
    near = np.nextafter(p[2], 0) if z > camera.near else p[2]
    return scene, replace(camera, near=float(near)), params


def _endless(scene, camera, params):
    camera = replace(camera)
    object.__setattr__(camera, "far", np.inf)
    return scene, camera, params


def _short_factors(splats, scene, camera, params):
    """Factors of 18 bits."""
    bits = splats.factors.view(np.int32) & ~np.int32(63)
    return replace(splats, factors=bits.view(np.float32))


def _means_in_float32(splats, scene, camera, params):
    return replace(splats, means2d=splats.means2d.astype(np.float32).astype(np.float64))


def _depths_cut_off(splats, scene, camera, params):
    """Rounded towards 0, not to nearest."""
    z = reference.camera_space(scene, camera, slice(0, len(scene)))[1][splats.gaussian_ids, 2]
    up = splats.depths > z
    return replace(
        splats, depths=np.where(up, np.nextafter(splats.depths, np.float32(0)), splats.depths)
    )


def _culled_by_angle(splats, scene, camera, params):
    p = reference.camera_space(scene, camera, slice(0, len(scene)))[1][splats.gaussian_ids]
    return _kept(splats, (abs(p[:, :2]) < 100 * p[:, 2:]).all(axis=1))


def _means_held(splats, scene, camera, params):
    """Means held near the picture, as the Jacobian's slopes are."""
    size = np.array([camera.width, camera.height])
    return replace(splats, means2d=np.clip(splats.means2d, -0.3 * size, 1.3 * size))


def _flushed(scene, camera, params):
    """Subnormal numbers are 0, as -ffast-math makes them."""

    def flush(array):
        return np.where(abs(array) < np.finfo(np.float32).tiny, np.float32(0), array)

    fields = {name: flush(getattr(scene, name)) for name in ("means", "scales", "sh")}
    return replace(scene, **fields), camera, params


def _threshold(number):
    """The reference with another alpha threshold."""

    def project(scene, camera, params, workspace):
        return reference.project(scene, camera, replace(params, alpha_threshold=number))

    def composite(splats, bins, params, workspace):
        return reference.composite(splats, bins, replace(params, alpha_threshold=number))

    return replace(REFERENCE, project=project, composite=composite)


def _infinite(splats, bins, params, workspace):
    """Stops nowhere and divides by what is left."""
    frame = reference.composite(splats, bins, replace(params, transmittance_min=0.0))
    with np.errstate(divide="ignore"):
        return replace(frame, rgb=frame.rgb * (1 + 1e-45 / frame.transmittance)[..., None])


def _warns(splats, bins, params, workspace):
    frame = reference.composite(splats, bins, params)
    np.log(frame.transmittance - 1)  # of what is not positive
    return frame


NEEDLES = [name for name in BY_NAME if name.startswith("needles of")]
FAR = [name for name in BY_NAME if name.startswith("needles whose")]
LAYERS = ["10,000 opaque layers", "100,000 faint layers"]
CAUGHT: dict[str, tuple[Stages, list[str]]] = {
    "naive determinant": (WRONG["cancelling determinant"][0], NEEDLES[1:]),
    "factors of 18 bits": (changed(_short_factors), FAR),
    "float32 subtraction": (
        WRONG["float32 camera subtraction"][0], ["centres at 1e7 m", "focal length of 1e7 px"],
    ),
    "means in float32": (changed(_means_in_float32), ["picture of 10000x1"]),
    "near plane ignored": (
        projecting(lambda s, c, p: (s, replace(c, near=1e-30), p)), [NEAR, ON],
    ),
    "near plane drawn": (
        projecting(lambda s, c, p: (s, replace(c, near=np.nextafter(c.near, 0)), p)), [NEAR, ON],
    ),
    "near test in float32": (changed(_near_in_float32), [TURNED]),
    "z summed in another order": (projecting(_other_order), [TURNED, ON]),
    "far plane at infinity": (projecting(_endless), [BEYOND]),
    "far plane drawn": (
        projecting(lambda s, c, p: (s, replace(c, far=np.nextafter(c.far, np.inf)), p)), [NEAR],
    ),
    "no overflow test": (
        patched("project", VARIANCE_MAX=np.inf, OFFSCREEN_MAX=np.inf),
        ["beyond float32", "focal length of 1e200 px"],
    ),
    "no low-pass filter": (
        projecting(lambda s, c, p: (s, c, replace(p, low_pass=0.01))),
        ["discs from the side", "scales from 1e-12 to 1e6", "logits at the ends of float32"],
    ),
    "slopes not held": (patched("project", CLAMP_MARGIN=1e9), [NEAR, "camera within giants"]),
    "means held": (changed(_means_held), ["camera within giants", NEAR, *FAR]),
    "culled by angle": (
        changed(_culled_by_angle), ["focal length of 0.001 px", "focal length of 1e-100 px"],
    ),
    "antialias ignored": (
        WRONG["antialias ignored"][0], ["antialiased points, needles and discs"],
    ),
    "alpha cap missing": (WRONG["alpha cap missing"][0], ["10,000 opaque layers"]),
    "unstable ties": (WRONG["unstable ties"][0], ["3,000 at equal depth", "depths by one ulp"]),
    "ties by row": (
        WRONG["ties by row"][0], ["3,000 at equal depth", "3,000 large ones at five depths"],
    ),
    "depths cut off": (changed(_depths_cut_off), ["depths by one ulp"]),
    "early stop missing": (
        replace(REFERENCE, composite=lambda s, b, p, w: reference.composite(
            s, b, replace(p, transmittance_min=0.0))), LAYERS,
    ),
    "stop too early": (WRONG["stop too early"][0], LAYERS),
    "threshold too low": (_threshold(0.998 / 255), ["opacities one ulp from 1/255"]),
    "threshold too high": (_threshold(1.003 / 255), ["opacities one ulp from 1/255", LAYERS[1]]),
    "coefficients in float16": (
        projecting(lambda s, c, p: (replace(s, sh=s.sh.astype(np.float16)), c, p)),
        ["colours that cancel"],
    ),
    "colours clipped": (WRONG["colour clipped early"][0], ["colours of 1e36"]),
    "subnormals flushed": (projecting(_flushed), ["a world of 1e-40 units"]),
    "infinity where opaque": (
        replace(REFERENCE, composite=_infinite), ["5,000 layers without a stop"],
    ),
    "a warning": (replace(REFERENCE, composite=_warns), ["picture of 1x1"]),
}  # fmt: skip
"""Name -> the stages, and the cases that must catch them."""


@pytest.mark.parametrize("name", CAUGHT)
def test_a_wrong_backend_is_caught(name):
    """Every case meant for this fault shows it."""
    stages, meant = CAUGHT[name]
    assert meant
    for case in meant:
        assert not check_stiff(stages, BY_NAME[case]).passed, case


FLAT = {  # nothing in them depends on half a pixel
    "exactly on a turned near plane", "focal length of 1e200 px", BEYOND, "100,000 faint layers",
    "5,000 layers without a stop",
}  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=str)
def test_no_case_is_empty(case):
    """Half a pixel off is beyond every bound, where there is something to be seen at all."""
    wrong = WRONG["half a pixel off"][0]
    assert check_stiff(wrong, case).passed == (case.name in FLAT)
    caught = {name for _, meant in CAUGHT.values() for name in meant}
    assert case.name not in FLAT or case.name in caught


def test_dropped_gaussians_are_counted():
    """A loader that drops one more than it should fails the case."""
    case = BY_NAME["quaternions of any length"]
    assert check_stiff(REFERENCE, case).passed
    wrong = replace(case, dropped={**case.dropped, "mean not finite": 1})
    assert "dropped" in check_stiff(REFERENCE, wrong).faults[0]


def test_overflows_are_counted():
    """A project stage that drops them in silence fails, though its picture is right."""

    def silent(splats, scene, camera, params):
        return replace(splats, overflowed=0)

    verdict = check_stiff(changed(silent), BY_NAME["beyond float32"])
    assert verdict.faults == ("overflowed: expected 5, got 0 Gaussians",)


def test_negative_transmittance_is_a_fault():
    """As is more than 1, however little: both are within the bound."""

    def shifted(by):
        def composite(splats, bins, params, workspace):
            frame = reference.composite(splats, bins, params)
            return replace(frame, transmittance=frame.transmittance + np.float32(by))

        return replace(REFERENCE, composite=composite)

    for name, by in ((TURNED, 1e-6), ("5,000 layers without a stop", -1e-6)):
        verdict = check_stiff(shifted(by), BY_NAME[name])
        assert len(verdict.faults) == 1
        assert "outside 0..1" in verdict.faults[0]


def test_a_fused_frame_is_looked_at_too():
    """One that is wrong is caught although its four stages are right."""

    def fused(scene, camera, params, workspace, everything=False):
        frame = reference.render(scene, camera, params)
        return replace(frame, rgb=frame.rgb + np.float32(0.01)), Counts(0, 0, 0, {})

    verdict = check_stiff(replace(REFERENCE, fused=fused), BY_NAME["picture of 1x1"])
    assert len(verdict.faults) == 1
    assert verdict.faults[0].startswith("fused: ")


def test_a_refusal_must_be_one_and_say_why():
    """A camera that is taken, one refused in other words, and one that warns all fail."""
    good = REFUSALS[0]
    assert check_refusal(good).passed
    taken = Refusal("taken", lambda: prepared(CASES[0])[1], "anything")
    assert check_refusal(taken).faults == ("it was taken",)
    assert not check_refusal(replace(good, words="other words")).passed
    warning = replace(good, make=lambda: np.float64(1e300) * np.float64(1e300))
    assert "FloatingPointError" in check_refusal(warning).faults[0]
