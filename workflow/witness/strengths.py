"""Random effects: their sites, and how they grow with one strength.

`DRAWN[name](rng, scene)` returns a Strength: `law_at(a)` is the law at strength a, without effect
at 0, `unit` a typical strength and `max_strength` the largest physical one (None: no strength).
Units and largest strengths are those of plausible skins and rigs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eitskin.physics.skin import Skin


@dataclass(frozen=True)
class Strength:
    """One drawn effect; scope: sparse, common or dense."""

    law_at: Callable[[float], dict]
    unit: float | None
    max_strength: float | None
    scope: str


@dataclass(frozen=True)
class Scene:
    """The scene of an effect: the nominal skin, its untouched frame (M,) V, channels (M, 4), the
    disc of a patch (x, y, radius, mm), whether the sink is grounded, and the skin's thickness."""

    skin: Skin
    channels: np.ndarray
    untouched_V: np.ndarray
    patch: tuple[float, float, float] | None
    sink_grounded: bool
    depth_mm: float

    @property
    def n(self) -> int:
        """The number of electrodes."""
        assert self.skin.electrode_deg is not None
        return len(self.skin.electrode_deg)

    @property
    def median_V(self) -> float:
        """Median of the untouched frame's readings."""
        return float(np.median(np.abs(self.untouched_V)))


Drawer = Callable[[np.random.Generator, Scene], Strength]
Parameters = Callable[[np.random.Generator, Scene], Callable[[float], dict]]


def _spread(rng: np.random.Generator, size: int) -> np.ndarray:
    """Standard normal values, rounded so that a file holds them exactly."""
    return np.round(rng.standard_normal(size), 3)


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _scope(rng: np.random.Generator, common: bool, dense: bool = True) -> str:
    u = rng.uniform()
    if common and u < 0.15:
        return "common"
    return "dense" if dense and u > 0.85 else "sparse"


@dataclass(frozen=True)
class _Sited:
    """A drawer for an effect with sites: value(x, scene) is the parameter `key` at x = strength
    times a sign or normal value; common: whether it may be the same for all sites."""

    name: str
    kind: str
    key: str
    unit: float
    max_strength: float
    value: Callable[[float, Scene], float]
    common: bool

    def __call__(self, rng: np.random.Generator, scene: Scene) -> Strength:
        """The effect with its sites and directions drawn."""
        count = len(scene.channels) if self.kind == "channels" else scene.n
        scope = _scope(rng, self.common)
        if scope == "dense":
            direction = _spread(rng, count)
            sites = {self.kind: list(range(count))}
            largest = self.max_strength / np.abs(direction).max()
        else:
            channels = self.kind == "channels"
            size = int(rng.integers(1, 4)) if channels else 1 + (rng.uniform() < 0.2)
            site_list = sorted(rng.choice(count, size, replace=False).tolist())
            sites = {self.kind: site_list} if scope == "sparse" else {}
            direction = np.array([_sign(rng)] * (len(site_list) if sites else 1))
            if len(site_list) > 1 and sites:
                direction[1:] *= np.round(rng.uniform(0.5, 1.0, len(site_list) - 1), 3)
            largest = self.max_strength

        def law_at(a: float) -> dict:
            values = [float(self.value(x, scene)) for x in a * direction]
            parameters = {self.key: values if sites else values[0]}
            return {"name": self.name, **sites, "parameters": parameters}

        return Strength(law_at, self.unit, float(largest), scope)


def _plain(
    name: str, unit: float, max_strength: float, parameters: Parameters, signed: bool = True
) -> Drawer:
    """A drawer for an effect without sites: parameters(rng, scene) gives a -> its parameters."""

    def draw(rng: np.random.Generator, scene: Scene) -> Strength:
        sign = _sign(rng) if signed else 1.0
        parameters_at = parameters(rng, scene)
        return Strength(
            lambda a: {"name": name, "parameters": parameters_at(sign * a)},
            unit,
            max_strength,
            "common",
        )

    return draw


def _shifted(key: str, neutral: float = 0.0) -> Parameters:
    return lambda rng, scene: lambda a: {key: neutral + a}


def _ratio(key: str) -> Parameters:
    return lambda rng, scene: lambda a: {key: float(np.exp(a))}


def _directed(key: str, neutral: float, turn: float) -> Parameters:
    def parameters(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
        angle = round(float(rng.uniform(0.0, turn)), 2)
        return lambda a: {key: neutral + a, "angle_deg": angle}

    return parameters


def _shape(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
    harmonic = int(rng.choice([0, 2, 2, 3, 4, 5]))
    phase = 0.0 if harmonic == 0 else round(float(rng.uniform(0.0, 360.0)), 2)
    return lambda a: {"harmonic": harmonic, "amplitude": a, "phase_deg": phase}


def _patch(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
    assert scene.patch is not None
    x, y, radius = scene.patch
    return lambda a: {"x_mm": x, "y_mm": y, "radius_mm": radius, "contrast": float(np.exp(a))}


def _mains(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
    tone = float(rng.choice([50.0, 60.0])) + round(float(rng.uniform(-0.05, 0.05)), 3)
    phase = round(float(rng.uniform(0.0, 360.0)), 2)
    median = scene.median_V
    return lambda a: {"frequency_Hz": tone, "volt": a * median, "phase_deg": phase}


def _converter(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
    largest = float(np.abs(scene.untouched_V).max())
    if rng.uniform() < 0.3:
        return lambda a: {"limit_V": largest * (1.0 - abs(a))}
    return lambda a: {"cubic": a / largest**2}


def _registration(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
    direction = rng.uniform(0.0, 2.0 * np.pi)
    x, y = float(np.cos(direction)), float(np.sin(direction))
    kind = rng.integers(3)
    turn = _sign(rng) if kind else 0.0
    shift = 0.0 if kind == 2 else 1.0
    return lambda a: {"dx_mm": shift * a * x, "dy_mm": shift * a * y, "rotation_deg": turn * a}


def _relaxation(rng: np.random.Generator, scene: Scene) -> Callable[[float], dict]:
    tau = round(float(np.exp(rng.uniform(np.log(0.7), np.log(15.0)))), 3)
    return lambda a: {"fraction": a, "tau_s": tau}


def _impedance_with_force(rng: np.random.Generator, scene: Scene) -> Strength:
    draw = _Sited(
        "force-dependent-impedance", "electrodes", "per_N", 0.1, 5.0, lambda x, s: abs(x), True
    )
    strength = draw(rng, scene)
    radius = scene.skin.radius_mm
    assert radius is not None
    range_mm = round(radius * rng.uniform(0.3, 0.8), 1) if strength.scope != "sparse" else None

    def law_at(a: float) -> dict:
        law = strength.law_at(a)
        return {**law, "parameters": {**law["parameters"], "range_mm": range_mm}}

    return Strength(law_at, strength.unit, strength.max_strength, strength.scope)


def _drift(rng: np.random.Generator, scene: Scene) -> Strength:
    draw = _Sited("contact-drift", "electrodes", "per_minute", 0.02, 0.1, lambda x, s: x, True)
    return draw(rng, scene)


def _leak(rng: np.random.Generator, scene: Scene) -> Strength:
    size = 1 if scene.sink_grounded and rng.uniform() < 0.5 else 2
    sites = sorted(rng.choice(scene.n, size, replace=False).tolist())
    share = [1.0, round(float(rng.uniform(0.5, 1.0)), 3)][:size]
    return Strength(
        lambda a: {
            "name": "ground-leak",
            "electrodes": sites,
            "parameters": {"siemens": [a * s for s in share]},
        },
        1e-4,
        1e-1,
        "sparse",
    )


def _fixed(name: str, size: int) -> Drawer:
    def draw(rng: np.random.Generator, scene: Scene) -> Strength:
        sites = sorted(rng.choice(scene.n, size, replace=False).tolist())
        return Strength(lambda a: {"name": name, "electrodes": sites}, None, None, "sparse")

    return draw


def _deep(rng: np.random.Generator, scene: Scene) -> Strength:
    is_known = scene.skin.thickness_mm is not None
    law: dict[str, Any] = {"name": "third-dimension"}
    law["parameters"] = {} if is_known else {"depth_mm": scene.depth_mm}
    return Strength(lambda a: law, None, None, "common")


def _offset(rng: np.random.Generator, scene: Scene) -> Strength:
    kind = "measures" if rng.uniform() < 0.7 else "channels"
    median = scene.median_V
    return _Sited("offset", kind, "volt", 0.05, 3.0, lambda x, s: x * median, False)(rng, scene)


def _position(rng: np.random.Generator, scene: Scene) -> Strength:
    key, per_deg = "shift_deg", 1.0
    if scene.skin.rim is not None:
        assert scene.skin.radius_mm is not None
        key, per_deg = "shift_mm", float(np.radians(scene.skin.radius_mm))
    draw = _Sited(
        "electrode-position", "electrodes", key, 0.3, 5.0, lambda x, s: per_deg * x, False
    )
    return draw(rng, scene)


def _width(x: float, scene: Scene) -> float:
    assert scene.skin.electrode_width_mm is not None
    return scene.skin.electrode_width_mm * (1.0 + x)


DRAWN: dict[str, Drawer] = {
    "contact-impedance": _Sited(
        "contact-impedance", "electrodes", "ratio", 0.3, 1.6, lambda x, s: np.exp(x), True
    ),
    "electrode-width": _Sited("electrode-width", "electrodes", "width_mm", 0.1, 0.6, _width, True),
    "electrode-position": _position,
    "electrode-open": _fixed("electrode-open", 1),
    "electrode-swap": _fixed("electrode-swap", 2),
    "domain-shape": _plain("domain-shape", 0.01, 0.12, _shape, signed=False),
    "anisotropy": _plain("anisotropy", 0.05, 1.0, _directed("ratio", 1.0, 180.0), signed=False),
    "conductivity-gradient": _plain(
        "conductivity-gradient",
        0.05,
        0.9,
        _directed("relative_across", 0.0, 360.0),
        signed=False,
    ),
    "conductivity-patch": _plain("conductivity-patch", 0.2, 1.6, _patch),
    "third-dimension": _deep,
    "ground-leak": _leak,
    "drive-gain": _Sited("drive-gain", "drives", "gain", 0.02, 0.5, lambda x, s: 1 + x, False),
    "measurement-gain": _Sited(
        "measurement-gain", "measures", "gain", 0.02, 0.5, lambda x, s: 1 + x, False
    ),
    "channel-gain": _Sited(
        "channel-gain", "channels", "gain", 0.05, 0.9, lambda x, s: 1 + x, False
    ),
    "offset": _offset,
    "crosstalk": _plain("crosstalk", 0.01, 0.24, _shifted("epsilon")),
    "common-mode": _plain("common-mode", 0.01, 0.5, _shifted("ratio")),
    "multiplexer-memory": _plain("multiplexer-memory", 0.01, 0.5, _shifted("mu"), signed=False),
    "frame-skew": _plain("frame-skew", 0.1, 0.5, _shifted("fraction")),
    "adc-nonlinearity": _plain("adc-nonlinearity", 0.02, 0.5, _converter),
    "mains-interference": _plain("mains-interference", 0.03, 3.0, _mains, signed=False),
    "touch-contrast": _plain("touch-contrast", 0.2, 1.6, _ratio("ratio")),
    "contact-law": _plain("contact-law", 0.1, 0.6, _shifted("exponent", 1.0)),
    "contact-area-growth": _plain("contact-area-growth", 0.05, 0.35, _shifted("exponent"), False),
    "probe-radius": _plain("probe-radius", 0.05, 0.5, _ratio("ratio")),
    "indenter-grounding": _plain(
        "indenter-grounding", 1e-4, 0.1, _shifted("siemens_per_N"), signed=False
    ),
    "force-dependent-impedance": _impedance_with_force,
    "force-dependent-gain": _plain("force-dependent-gain", 0.003, 0.09, _shifted("per_N")),
    "force-lag": _plain("force-lag", 0.2, 3.0, _shifted("lag_s")),
    "force-offset": _plain("force-offset", 0.2, 2.0, _shifted("offset_N")),
    "registration": _plain("registration", 0.5, 6.0, _registration, signed=False),
    "relaxation": _plain("relaxation", 0.1, 0.95, _relaxation, signed=False),
    "hysteresis": _plain("hysteresis", 0.1, 0.95, _shifted("fraction")),
    "conductivity-drift": _plain("conductivity-drift", 0.005, 0.1, _shifted("per_minute")),
    "contact-drift": _drift,
}
