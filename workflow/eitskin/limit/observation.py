"""What one sample of a simulated configuration says of its touch: the likelihood of a change.

    change = X diag(g) k(F) d(x, y, F; skin) + noise,

d the touched less the untouched readings, k(F) the gain that follows the force, g the channels'
gains, X the crosstalk. The skin's shape and the gains are a session's draws. Where they are unknown
the gains are integrated in closed form, a Gaussian given d, and the skin's stay as unknowns.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from eitskin.effects.effect import START, Frames, Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin
from eitskin.physics.touch import Touch
from eitskin.simulate.chain import instrument_effects, skin_effects
from eitskin.simulate.readings import apply_instrument, apply_skin
from eitskin.simulate.sets import sample_settings
from eitskin.simulate.state_priors import force_N, place_mm, place_slope

# What Forward.derivatives calls the parameters that may be drawn; of sites, with [site].
SLOPES = {
    ("ellipse", "sx"): "stretch_x",
    ("ellipse", "sy"): "stretch_y",
    ("electrode-position", "shift_deg"): "electrode_deg",
}
KNOWN = ("ellipse", "electrode-position", "channel-gain", "force-dependent-gain", "crosstalk")
DRAWN = (*SLOPES, ("channel-gain", "gain"))
STEP_MM, STEP_N, STEP = 0.02, 1e-3, 1e-2  # of differences where a touch has no exact slopes


@dataclass(frozen=True)
class Experiment:
    """What a configuration's samples are drawn from.

    effects: the configuration's; noise: sd over the median |v|; averaged: untouched frames in a
    baseline; reach_mm: radius of the disc of places; forces: mean_N, sd_N, max_N; force_max_N: the
    set's largest. Raises InputError for an effect, or a drawn parameter, that has no likelihood
    here.
    """

    skin: Skin
    channels: np.ndarray
    accuracy: str
    effects: list[dict]
    noise: float
    averaged: int
    reach_mm: float
    probe_mm: float
    forces: dict[str, float]
    force_max_N: float

    def __post_init__(self) -> None:
        names = [effect["name"] for effect in self.effects]
        for k, effect in enumerate(self.effects):
            name = effect["name"]
            if name not in KNOWN or name in names[:k]:
                expected = f"each once, of {', '.join(KNOWN)}"
                raise InputError("limit", f"effects[{k}].name", repr(name), expected)
            for key, value in effect["parameters"].items():
                if isinstance(value, dict) and (name, key) not in DRAWN:
                    raise InputError("limit", f"effects[{k}].{key}", value, "a number")

    def known(self, seed: int, session: int) -> "SessionModel":
        """The session's own skin and gains, as the simulator draws them from `seed`."""
        counts = site_counts(self.channels)
        skin = sample_settings(skin_effects(self.effects), counts, (seed, session, 0))
        instrument = [
            one
            for k, effect in enumerate(instrument_effects(self.effects).values(), start=1)
            for one in sample_settings([effect], counts, (seed, session, k))
        ]
        values = sum(np.size(value) for setting in skin for value in setting.values.values())
        still = np.zeros((values, 0)), np.zeros((len(self.channels), 0))
        return SessionModel(self, skin, instrument, *still)

    def unknown(self) -> "SessionModel":
        """A session of which only the distributions are known."""
        in_skin = skin_effects(self.effects)
        in_instrument = list(instrument_effects(self.effects).values())
        skin, instrument = ([self._mean(e) for e in items] for items in (in_skin, in_instrument))
        skin_spread = [
            _spread(effect["parameters"].get(key), np.size(value))
            for effect, setting in zip(in_skin, skin, strict=True)
            for key, value in setting.values.items()
        ]
        gain_spread = np.zeros((len(self.channels), 0))
        for effect, setting in zip(in_instrument, instrument, strict=True):
            if setting.effect.name == "channel-gain":
                assert setting.sites is not None
                spread = _spread(effect["parameters"]["gain"], len(setting.sites))
                gain_spread = np.zeros((len(self.channels), spread.shape[1]))
                gain_spread[setting.sites] = (spread.T / setting.values["gain"]).T
        return SessionModel(self, skin, instrument, block_diag(*skin_spread), gain_spread)

    def _mean(self, effect: dict) -> Setting:
        """The effect, every drawn parameter at its mean."""
        parameters = {
            key: {**value, "sd": 0.0} if isinstance(value, dict) else value
            for key, value in effect["parameters"].items()
        }
        counts = site_counts(self.channels)
        return settings([{**effect, "parameters": parameters}], counts, (0,))[0]


def _spread(given: object, size: int) -> np.ndarray:
    """(size, draws): what standard normal draws add to a parameter's values, given as the
    configuration has it."""
    if not isinstance(given, dict):
        return np.zeros((size, 0))
    tie = np.eye(size)
    if given.get("tie") == "mirror":
        half = size // 2
        tie = tie[:, : size - half]
        tie[size - half :] = np.eye(half, size - half)[::-1]
    return given["sd"] * tie


@dataclass
class SessionModel:
    """The readings of a session whose skin and gains are given but for standard normal unknowns.

    skin_spread (values, K): what unknowns add to the skin's drawn values, one after the other;
    gain_spread (M, G): what unknowns add to the channels' relative gains; read (R,): the channels
    of which a change is known, None all. The noise is that of all M.
    """

    experiment: Experiment
    skin: list[Setting]
    instrument: list[Setting]
    skin_spread: np.ndarray
    gain_spread: np.ndarray
    read: np.ndarray | None = None

    def __post_init__(self) -> None:
        self._forward: tuple[bytes, Forward, np.ndarray] | None = None
        self._base = Geometry.from_skin(self.experiment.skin)

    def at_mean(self) -> "SessionModel":
        """The same without unknowns, each at its mean."""
        skin, gain = (np.zeros((len(one), 0)) for one in (self.skin_spread, self.gain_spread))
        return replace(self, skin_spread=skin, gain_spread=gain)

    @cached_property
    def mixing(self) -> np.ndarray:
        """(R, M): X, of the channels that are read."""
        return self._crosstalk if self.read is None else self._crosstalk[self.read]

    @cached_property
    def _crosstalk(self) -> np.ndarray:
        mixing = [setting for setting in self.instrument if setting.effect.order == "mixing"]
        unit = np.eye(len(self.experiment.channels))
        return apply_instrument(unit, mixing, self._frames(np.zeros(len(unit)))).T

    def gain(self, force: np.ndarray) -> np.ndarray:
        """(F, M): k(F) times the channels' gains at forces (F,) N; linear in the force."""
        gains = [setting for setting in self.instrument if setting.effect.order == "gain"]
        unit = np.ones((len(force), len(self.experiment.channels)))
        return apply_instrument(unit, gains, self._frames(force))

    def _frames(self, force: np.ndarray) -> Frames:
        experiment = self.experiment
        return Frames(
            np.zeros(len(force)), force, experiment.channels, force_max_N=experiment.force_max_N
        )

    def geometry(self, unknown: np.ndarray) -> Geometry:
        """The skin at standard normal unknowns (K,)."""
        added = self.skin_spread @ unknown
        moved = []
        for setting in self.skin:
            values = {}
            for key, value in setting.values.items():
                own, added = added[: np.size(value)], added[np.size(value) :]
                values[key] = value + own.reshape(np.shape(value))
            moved.append(replace(setting, values=values))
        return apply_skin(self._base, moved, START)

    def forward(self, unknown: np.ndarray) -> tuple[Forward, np.ndarray]:
        """The skin at unknowns (K,), solved, and its untouched readings (M,) V; the last is
        kept."""
        key = np.asarray(unknown).tobytes()
        if self._forward is None or self._forward[0] != key:
            experiment = self.experiment
            forward = Forward(self.geometry(unknown), experiment.accuracy)
            untouched = experiment.skin.current_A * forward.voltages(experiment.channels)
            self._forward = key, forward, untouched
        return self._forward[1:]

    def changes(self, xy: np.ndarray, force: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        """e = g k(F) d, (F, M) V before the crosstalk, of forces (F,) N, 0 or more, at one place
        (x, y) mm."""
        experiment, forward = self.experiment, self.forward(unknown)[0]
        place = (float(xy[0]), float(xy[1]), 0.5 * experiment.probe_mm)
        if not force.any() or not forward.meets([place])[0]:
            return np.zeros((len(force), len(experiment.channels)))
        contrast = experiment.skin.contrast_per_N * force
        d = forward.place(*place).channel_change(experiment.channels, contrast)
        return self.gain(force) * (experiment.skin.current_A * d)

    def change(self, state: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, float]:
        """e (M,) V of a state (x mm, y mm, F N); and the sd of the noise, V, of the change, the
        unknown gains at their mean.

        Of an averaged baseline every frame is taken to be as noisy as the sample's own.
        """
        untouched = self.forward(unknown)[1]
        force = state[2:]
        e = self.changes(state[:2], force, unknown)[0]
        base = self.gain(force)[0] * untouched
        still, touched = (np.median(np.abs(self._crosstalk @ v)) for v in (base, base + e))
        experiment = self.experiment
        noise = experiment.noise * np.sqrt(still**2 / experiment.averaged + touched**2)
        return e, float(noise)

    def slopes(self, state: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by x, y (1/mm), F (1/N) and the skin's unknowns of e (3 + K, M) V and of the
        noise's sd (3 + K,) V.

        Exact, but for touches that the rim clips or all but meets, and for forces of 0: there
        differences, forwards.
        """
        experiment, force = self.experiment, float(state[2])
        contrast_per_N = experiment.skin.contrast_per_N
        assert contrast_per_N is not None
        names = self._slope_names()
        forward, untouched = self.forward(unknown)
        touch = Touch(
            float(state[0]),
            float(state[1]),
            0.5 * experiment.probe_mm,
            contrast_per_N * force,
        )
        try:
            by = forward.derivatives([touch], [*names, "x_mm[0]", "y_mm[0]", "contrast[0]"])
        except InputError:
            return self._differences(state, unknown)
        still_by = forward.derivatives([], names)
        gain, more = self.gain(force + np.arange(2.0))
        gain_slope = more - gain

        def readings(slopes: list[np.ndarray]) -> np.ndarray:
            value = channel_values(np.array(slopes), experiment.channels)
            return experiment.skin.current_A * gain * value

        e, noise = self.change(state, unknown)
        still, found = np.zeros((2, 3 + self.skin_spread.shape[1], len(e)))
        found[:3] = readings([by["x_mm[0]"], by["y_mm[0]"], by["contrast[0]"]])
        found[2] = contrast_per_N * found[2] + gain_slope / gain * e
        still[2] = gain_slope * untouched
        if names:
            still[3:] = self.skin_spread.T @ readings([still_by[name] for name in names])
            both = self.skin_spread.T @ readings([by[name] for name in names])
            found[3:] = both - still[3:]
        parts = [(gain * untouched, still), (gain * untouched + e, still + found)]
        median, slope = zip(*(self._median(*part) for part in parts), strict=True)
        weight = experiment.noise**2 * np.array([1.0 / experiment.averaged, 1.0]) * median
        return found, weight @ np.array(slope) / noise

    def _median(self, voltage: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
        """The median |reading| of (M,) V before the crosstalk, and its slopes, of (n, M)."""
        reading = self._crosstalk @ voltage
        half = (len(reading) - 1) / 2
        middle = np.argsort(np.abs(reading))[[int(half), int(np.ceil(half))]]
        slope = np.sign(reading[middle]) * (slopes @ self._crosstalk[middle].T)
        return float(np.abs(reading[middle]).mean()), slope.mean(axis=1)

    def _slope_names(self) -> list[str]:
        """What `Forward.derivatives` calls each row of `skin_spread`."""
        if not self.skin_spread.shape[1]:
            return []
        return [
            SLOPES[setting.effect.name, key]
            + ("" if setting.sites is None else f"[{setting.sites[k]}]")
            for setting in self.skin
            for key, value in setting.values.items()
            for k in range(np.size(value))
        ]

    def _differences(self, state: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = 3 + len(unknown)
        steps = np.full(size, STEP)
        steps[:3] = STEP_MM, STEP_MM, STEP_N
        whole = np.concatenate([state, unknown])

        def at(place: np.ndarray) -> np.ndarray:
            return np.append(*self.change(place[:3], place[3:]))

        moved = np.array([at(whole + step) for step in np.diag(steps)])
        found = (moved - at(whole)) / steps[:, None]
        return found[:, :-1], found[:, -1]


@dataclass(frozen=True)
class Covariance:
    """noise² 1 + B Bᵀ, B = X diag(e) T: of a change, the gains T z unknown (T: gain_spread)."""

    model: SessionModel
    e: np.ndarray
    noise: float

    @cached_property
    def basis(self) -> np.ndarray:
        """B (R, G)."""
        return self.model.mixing @ (self.e[:, None] * self.model.gain_spread)

    @cached_property
    def _inner(self) -> tuple[np.ndarray, bool]:
        inner = self.basis.T @ self.basis
        return cho_factor(inner + self.noise**2 * np.eye(len(inner)), lower=True)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The inverse times (R, ...), by Woodbury's identity."""
        if self.basis.shape[1]:
            right = right - self.basis @ cho_solve(self._inner, self.basis.T @ right)
        return right / self.noise**2

    @cached_property
    def inverse(self) -> np.ndarray:
        """(R, R)."""
        return self.solve(np.eye(len(self.basis)))

    def information(self, slopes: np.ndarray, noise_slopes: np.ndarray) -> np.ndarray:
        """(n, n): Fisher's, of n parameters by which e changes by (n, M) and the noise by (n,).

        Without what the spread by the gains says of them, a share of the gains' variance.
        """
        reading = slopes @ self.model.mixing.T
        of_noise = 2.0 * self.noise**2 * (self.inverse**2).sum()
        return reading @ self.inverse @ reading.T + of_noise * np.outer(noise_slopes, noise_slopes)

    @property
    def log_determinant(self) -> float:
        """Of the whole covariance."""
        apart = 2.0 * (len(self.basis) - self.basis.shape[1]) * np.log(self.noise)
        if not self.basis.shape[1]:
            return float(apart)
        return float(apart + 2.0 * np.log(np.diag(self._inner[0])).sum())


@dataclass(frozen=True)
class Sample:
    """The likelihood of one change (R,) V: a `posterior.Likelihood` of the standard normal numbers
    behind place (2) and force, and of the skin's unknowns."""

    model: SessionModel
    delta_V: np.ndarray

    @property
    def size(self) -> int:
        """3 and the skin's unknowns."""
        return 3 + self.model.skin_spread.shape[1]

    def state(self, z: np.ndarray) -> np.ndarray:
        """(..., 3): x mm, y mm, F N of standard normal numbers (..., size)."""
        experiment = self.model.experiment
        force = force_N(z[..., 2:3], **experiment.forces)
        return np.concatenate([place_mm(z[..., :2], experiment.reach_mm), force], axis=-1)

    def log(self, z: np.ndarray) -> float:
        """As `posterior.Likelihood.log`."""
        e, noise = self.model.change(self.state(z), z[3:])
        return self._log(Covariance(self.model, e, noise))

    def _log(self, covariance: Covariance) -> float:
        residual = self.delta_V - self.model.mixing @ covariance.e
        square = residual @ covariance.solve(residual)
        return float(-0.5 * (square + covariance.log_determinant))

    def local(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """As `posterior.Likelihood.local`."""
        state = self.state(z)
        e, noise = self.model.change(state, z[3:])
        slopes, noise_slopes = self.model.slopes(state, z[3:])
        by_z, noise_by_z = (self._by_normal(z, state, part) for part in (slopes, noise_slopes))
        covariance = Covariance(self.model, e, noise)
        mixing, spread = self.model.mixing, self.model.gain_spread
        inverse = covariance.inverse
        solved = inverse @ (self.delta_V - mixing @ e)
        pull, between = mixing.T @ solved, spread @ spread.T
        by_e = pull + pull * (between @ (e * pull))
        by_e -= ((between * e) * (mixing.T @ inverse @ mixing)).sum(axis=1)
        by_noise = noise * (solved @ solved - np.trace(inverse))
        information = covariance.information(by_z, noise_by_z)
        return self._log(covariance), by_z @ by_e + by_noise * noise_by_z, information

    def _by_normal(self, z: np.ndarray, state: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        experiment = self.model.experiment
        by_z = slopes.copy()
        by_z[:2] = place_slope(z[:2], experiment.reach_mm).T @ slopes[:2]
        inside = 0.0 < state[2] < experiment.forces["max_N"]
        by_z[2] = experiment.forces["sd_N"] * slopes[2] if inside else 0.0
        return by_z
