"""Named settings: presets, and what --set reads."""

from __future__ import annotations

import pytest

from tsplat.core.errors import ParamsError
from tsplat.core.params import (
    CONTRACT,
    IDEAL,
    KNOBS,
    PRESETS,
    RenderParams,
    parse_settings,
    settings_text,
)
from tsplat.quality.sweep import LADDERS


def test_contract_is_the_default_and_exact_is_the_ideal_but_for_float64():
    """The presets that are not shortcuts say what they promise, to the last field."""
    assert PRESETS["contract"] == RenderParams()
    assert PRESETS["exact"] == RenderParams(
        alpha_threshold=IDEAL.alpha_threshold, transmittance_min=IDEAL.transmittance_min
    )


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_changes_knobs_only(name):
    """Antialiasing, depth and float64 are nobody's shortcut."""
    changed = {k for k, v in vars(PRESETS[name]).items() if v != getattr(CONTRACT, k)}
    assert changed <= set(KNOBS)


def test_settings_are_read_and_written():
    """What settings_text writes, parse_settings reads; fractions are numbers."""
    made = parse_settings("scale=0.5, alpha_threshold=4/256,half=true,depth_bits=20,sh_degree=1")
    assert made == RenderParams(
        scale=0.5, alpha_threshold=4 / 256, half=True, depth_bits=20, sh_degree=1
    )
    assert parse_settings(settings_text(made)) == made
    assert settings_text(CONTRACT) == "contract"
    assert settings_text(parse_settings("alpha_threshold=1/1020")) == "alpha_threshold=1/1020"
    for text in (*LADDERS, "scale=0.3333", "transmittance_min=0.0123456789"):
        assert parse_settings(settings_text(parse_settings(text))) == parse_settings(text)
    assert parse_settings("", PRESETS["fast"]) == PRESETS["fast"]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("speed=9", "expected NAME=VALUE with a name of alpha_threshold"),
        ("antialias=true", "expected NAME=VALUE"),
        ("scale", "expected NAME=VALUE"),
        ("scale=half", "scale: expected a number, got 'half'"),
        ("scale=0", "scale: expected 0 < value <= 1, got 0"),
        ("scale=nan", "scale: expected 0 < value <= 1, got nan"),
        ("share=2", "share: expected 0 < value <= 1"),
        ("alpha_threshold=1/0", "alpha_threshold: expected a number"),
        ("sh_degree=1.5", "sh_degree: expected a whole number"),
        ("sh_degree=4", "sh_degree: expected 0 to 3"),
        ("depth_bits=9", "depth_bits: expected 10 to 32"),
        ("half=perhaps", "half: expected true or false"),
    ],
)
def test_what_cannot_be_is_refused(text, word):
    """A wrong name or value is a sentence that says what was expected."""
    with pytest.raises(ParamsError) as caught:
        parse_settings(text)
    assert word in str(caught.value)


@pytest.mark.parametrize("bits", [10, 16, 20, 24, 31, 32])
def test_depths_are_rounded_to_so_many_bits(bits):
    """Of 24 significant bits 32 - bits are 0, and the error is at most half a step."""
    import numpy as np

    from tsplat.core.reference import rounded_depths

    depths = np.random.default_rng(1).uniform(0.01, 1e6, 1000).astype(np.float32)
    rounded = rounded_depths(depths.astype(np.float64), RenderParams(depth_bits=bits))
    cut = 32 - bits
    assert not (rounded.view(np.uint32) & np.uint32((1 << cut) - 1)).any()
    assert (abs(rounded - depths) <= np.float32(2.0 ** (cut - 24)) * depths).all()
    assert (rounded != depths).any() == (bits < 32)
