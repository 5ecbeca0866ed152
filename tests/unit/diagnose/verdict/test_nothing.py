"""A stated interval that holds no effect at all: never certain, left out of what is."""

import pytest

from eitskin.diagnose.verdict import words
from eitskin.diagnose.verdict.nothing import holds_nothing
from eitskin.effects import EFFECTS
from eitskin.quantities import MINUS


def entry(name: str, scope: str = "common", **values) -> dict:
    """An effect of diagnosis.json with (value, low, high) by parameter."""
    parameters = {
        key: dict(zip(("value", "low", "high"), numbers, strict=True))
        | {"unit": EFFECTS[name].parameters[key].unit}
        for key, numbers in values.items()
    }
    sites = {kind: [] for kind in words.NOUNS}
    return {"name": name, "scope": scope, "parameters": parameters, **sites}


FADING = entry("relaxation", fraction=(-0.4, -1.0, 0.9), tau_s=(0.3, 0.001, 370.0))


@pytest.mark.parametrize(
    ("stated", "nothing"),
    [
        (FADING, True),
        (entry("relaxation", fraction=(0.4, 0.01, 0.8), tau_s=(3.0, 1.0, 9.0)), False),
        (entry("domain-shape", amplitude=(0.01, 0.0, 0.02), phase_deg=(40.0, 39.0, 41.0)), True),
        (entry("domain-shape", amplitude=(0.01, 0.005, 0.02), phase_deg=(0.0, -9.0, 9.0)), False),
        (entry("probe-radius", ratio=(1.1, 1.0, 1.2)), True),
        (
            entry("electrode-position", "sparse", shift_deg=([1.0, 0.1], [0.9, -0.1], [1.1, 0.3])),
            True,
        ),
        (
            entry("electrode-position", "dense", shift_deg=([1.0, 0.1], [0.9, -0.1], [1.1, 0.3])),
            False,
        ),
        (entry("electrode-open", "sparse"), False),
    ],
    ids=str,
)
def test_what_may_be_nothing_is_no_finding(stated, nothing):
    assert holds_nothing(stated) == nothing
    assert words.is_certain(stated | {"certain": True}) != nothing
    assert not words.is_certain(stated | {"certain": False})


def test_every_effect_is_nothing_at_its_neutral_values_and_something_away_from_them():
    for name, effect in EFFECTS.items():
        sizes = {k: p.neutral for k, p in effect.parameters.items() if p.neutral is not None}
        if effect.polar is not None:
            sizes.pop(effect.polar[1], None)
        if not sizes:
            continue
        none = {key: (at, at, at) for key, at in sizes.items()}
        assert holds_nothing(entry(name, **none)), name
        some = {key: (at + 2.0, at + 1.0, at + 3.0) for key, at in sizes.items()}
        assert not holds_nothing(entry(name, **some)), name


def test_amounts_stand_for_what_is_not_told_apart():
    stated = entry("conductivity-patch", contrast=(0.98, 0.95, 1.01), radius_mm=(5.0, 1.0, 25.0))
    assert holds_nothing(stated)
    assert not holds_nothing(stated | {"amounts": {"equivalent_radius_mm": {}}})


def test_a_part_that_may_be_nothing_is_left_out_beside_one_that_is_something():
    shifted = {"dx_mm": (0.007, -0.024, 0.037), "dy_mm": (-0.114, -0.147, -0.081)}
    stated = entry("registration", **shifted, rotation_deg=(0.01, -0.03, 0.05))
    text = words.effect_sentence(stated, EFFECTS["registration"])
    assert text.replace(MINUS, "-") == (
        "Touches are not where they are reported, shifted by -0.114"
        " (90 %: -0.147 to -0.081)\xa0mm along y."
    )


@pytest.mark.parametrize(
    ("harmonic", "phase", "said"),
    [
        (
            1,
            40.0,
            "The rim is 2.0 (90 %: 1.0 to 3.0)\xa0% of its radius off centre, towards 40.0° (",
        ),
        (2, 40.0, "The rim is an oval: its half axis along 20.00° (90 %: 19.50° to 20.50°) is 2.0"),
        (2, -320.0, "half axis along 20.00° (90 %: 19.50° to 20.50°)"),
        (
            3,
            450.0,
            "bulges at 3 places by 2.0 (90 %: 1.0 to 3.0)\xa0% of its radius, the first at 30.00°",
        ),
    ],
)
def test_a_rim_is_told_by_directions(harmonic, phase, said):
    sizes = {"amplitude": (0.02, 0.01, 0.03), "phase_deg": (phase, phase - 1.0, phase + 1.0)}
    stated = entry("domain-shape", harmonic=(harmonic,) * 3, **sizes)
    text = words.effect_sentence(stated, EFFECTS["domain-shape"])
    assert said in text and "phase" not in text and "harmonic" not in text


def test_a_time_constant_that_may_be_anything_is_said_to_be_untold():
    text = words.effect_sentence(FADING | {"certain": False}, EFFECTS["relaxation"])
    assert text.replace(MINUS, "-") == (
        "Perhaps the skin gives way under a force that is held: -40 (90 %: -100 to 90)\xa0% of its"
        " answer fades. These readings do not tell its time constant."
    )


@pytest.mark.parametrize(
    ("name", "key", "above", "below"),
    [
        ("electrode-position", "shift_deg", "towards larger angles.", "towards smaller angles."),
        ("offset", "volt", "\xa0V too much.", "\xa0V too little."),
        ("force-lag", "lag_s", "\xa0s late.", "\xa0s early."),
        ("force-offset", "offset_N", "\xa0N more than reported.", "\xa0N less than reported."),
    ],
)
def test_a_value_below_nothing_is_said_without_its_sign(name, key, above, below):
    effect = EFFECTS[name]
    sites = {effect.sites[0]: [3]} if effect.sites else {}
    scope = "sparse" if effect.sites else "common"
    for value, words_there in ((2.0, above), (-2.0, below)):
        stated = entry(name, scope, **{key: (value, value - 1.0, value + 1.0)}) | sites
        text = words.effect_sentence(stated, effect)
        assert text.endswith(words_there) and MINUS not in text
        assert "2.0" in text and "1.0" in text and "3.0" in text
    both = entry(name, scope, **{key: ([-2.0, 2.0], [-3.0, 1.0], [-1.0, 3.0])}) | sites
    assert MINUS in words.effect_sentence(both, effect)


@pytest.mark.parametrize(
    ("name", "size", "said"),
    [("conductivity-gradient", "relative_across", "188.0°"), ("anisotropy", "ratio", "8.0°")],
)
def test_a_direction_is_told_from_0_on(name, size, said):
    stated = entry(name, **{size: (2.0, 1.5, 2.5)}, angle_deg=(-172.0, -175.0, -169.0))
    assert said in words.effect_sentence(stated, EFFECTS[name])
