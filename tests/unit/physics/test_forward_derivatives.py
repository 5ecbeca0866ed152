"""Derivatives of the transfer impedance against central differences, for every parameter."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.touch import Touch

ELECTRODES = np.arange(16) * 22.5 + 3.0
RNG = np.random.default_rng(5)
GEOMETRY = Geometry(
    80.0,
    3.0,
    0.5,
    ELECTRODES + RNG.normal(0, 0.5, 16),
    5.0 + RNG.normal(0, 0.3, 16),
    1e-3 * np.exp(RNG.normal(0, 0.3, 16)),
    shape_cos={0: 0.01, 2: 0.02, 3: -0.01},
    shape_sin={2: 0.015, 3: 0.02},
    stretch_x=1.03,
    stretch_y=0.98,
    anisotropy_ratio=1.2,
    anisotropy_deg=25.0,
)
TOUCHES = [Touch(20.0, 31.0, 7.5, 4.0), Touch(-52.0, -10.0, 5.0, -0.4)]
STEP = {"conductivity_S_per_m": 1e-4, "contact_impedivity_ohm_m2": 1e-6, "contrast": 1e-4}


def moved(geometry: Geometry, touches: list[Touch], name: str, step: float):
    kind, _, index = name.rstrip("]").partition("[")
    if kind in ("x_mm", "y_mm", "radius_mm", "contrast"):
        touches = list(touches)
        old = touches[int(index)]
        touches[int(index)] = replace(old, **{kind: getattr(old, kind) + step})
        return geometry, touches
    value = getattr(geometry, kind)
    if kind in ("shape_cos", "shape_sin"):
        value = {**value, int(index): value[int(index)] + step}
    elif index:
        value = value.copy()
        value[int(index)] += step
    else:
        value = value + step
    return geometry.with_values(**{kind: value}), touches


def largest_error(geometry: Geometry, touches: list[Touch], accuracy: str) -> dict[str, float]:
    forward = Forward(geometry, accuracy)
    errors: dict[str, float] = {}
    for name, slope in forward.derivatives(touches).items():
        kind = name.partition("[")[0]
        step = STEP.get(kind, 1e-4)

        def central(h, name=name):
            after = [moved(geometry, touches, name, s * h) for s in (1, -1)]
            plus, minus = (Forward(g, accuracy).transfer_impedance(t) for g, t in after)
            return (plus - minus) / (2 * h)

        numeric = (4 * central(step / 2) - central(step)) / 3
        off = ~np.eye(len(slope), dtype=bool) if geometry.points else np.ones(slope.shape, bool)
        pairs = (slope - slope.mean(0))[off], (numeric - numeric.mean(0))[off]
        if geometry.points:
            pairs = slope[off], numeric[off]
        if kind == "anisotropy_deg" and geometry.anisotropy_ratio == 1.0:
            assert not np.any(pairs)
            continue
        error = np.abs(pairs[0] - pairs[1]).max() / np.abs(pairs[1]).max()
        errors[kind] = max(errors.get(kind, 0.0), error)
    return errors


@pytest.mark.parametrize("accuracy", ["train", "diagnose"])
def test_every_parameter(accuracy):
    errors = largest_error(GEOMETRY, TOUCHES, accuracy)
    assert len(errors) == 15
    assert max(errors.values()) < 1e-6, errors


def test_untouched_points():
    geometry = Geometry(
        80.0, 3.0, 0.5, ELECTRODES, 0.0, 0.0, shape_cos={2: 0.03}, anisotropy_ratio=1.1
    )
    errors = largest_error(geometry, [TOUCHES[0]], "diagnose")
    assert max(errors.values()) < 1e-6, errors


@pytest.mark.parametrize(
    ("radius", "accuracy", "message"), [(12.0, "train", "clipped"), (8.0, "diagnose", "at the rim")]
)
def test_a_touch_at_the_rim_has_no_derivative(radius, accuracy, message):
    forward = Forward(Geometry(80.0, 3.0, 0.5, ELECTRODES, 5.0, 1e-3), accuracy)
    for parameter in ("x_mm[0]", "radius_mm[0]", "stretch_x"):
        with pytest.raises(InputError, match=message):
            forward.derivatives([Touch(72.0, 0.0, radius, 4.0)], [parameter])


def test_a_touch_near_the_rim():
    geometry = Geometry(80.0, 3.0, 0.5, ELECTRODES, 5.0, 1e-3, shape_cos={2: 0.01})
    errors = largest_error(geometry, [Touch(68.0, 5.0, 7.5, 4.0)], "diagnose")
    assert max(errors.values()) < 1e-6, errors
