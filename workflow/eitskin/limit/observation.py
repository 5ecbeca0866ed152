"""The likelihood of one change of a simulated configuration.

    change = X diag(g) k(F) d(x, y, F; skin) + noise,

with d the touched less the untouched readings, k(F) the force-dependent gain, g the channels'
gains and X the crosstalk. The skin's shape and the gains are drawn once a session. Where they are
unknown, the gains are integrated in closed form, as they are Gaussian given d, and the parameters
of the skin stay as unknowns.
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

# The names in Forward.derivatives of the random parameters of the skin; of sites, with [site].
SLOPES = {
    ("ellipse", "sx"): "stretch_x",
    ("ellipse", "sy"): "stretch_y",
    ("electrode-position", "shift_deg"): "electrode_deg",
}
MODELLED = ("ellipse", "electrode-position", "channel-gain", "force-dependent-gain", "crosstalk")
RANDOM_PARAMETERS = (*SLOPES, ("channel-gain", "gain"))
STEP_MM, STEP_N, STEP = 0.02, 1e-3, 1e-2  # small against the slopes' scales, large against rounding


@dataclass(frozen=True)
class Experiment:
    """The distribution from which a configuration's samples are drawn.

    effects: the configuration's; noise: sd over the median |v|; averaged: untouched frames in a
    baseline; reach_mm: radius of the disc of places; forces: mean_N, sd_N, max_N; force_max_N: the
    set's largest. Raises InputError for an effect or a random parameter without a likelihood here.
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
            if name not in MODELLED or name in names[:k]:
                expected = f"each once, of {', '.join(MODELLED)}"
                raise InputError("limit", f"effects[{k}].name", repr(name), expected)
            for key, value in effect["parameters"].items():
                if isinstance(value, dict) and (name, key) not in RANDOM_PARAMETERS:
                    raise InputError("limit", f"effects[{k}].{key}", value, "a number")

    def drawn_session(self, seed: int, session: int) -> "SessionModel":
        """The session with the skin and gains that the simulator draws for it from `seed`."""
        counts = site_counts(self.channels)
        skin = sample_settings(skin_effects(self.effects), counts, (seed, session, 0))
        instrument = [
            setting
            for k, effect in enumerate(instrument_effects(self.effects).values(), start=1)
            for setting in sample_settings([effect], counts, (seed, session, k))
        ]
        value_count = sum(
            np.size(value) for setting in skin for value in _of_slopes(setting).values()
        )
        spreads = np.zeros((value_count, 0)), np.zeros((len(self.channels), 0))
        return SessionModel(self, skin, instrument, *spreads)

    def prior_session(self) -> "SessionModel":
        """A session whose skin and gains are known by their distributions only."""
        skin_configuration = skin_effects(self.effects)
        instrument_configuration = list(instrument_effects(self.effects).values())
        skin, instrument = (
            [self._mean(effect) for effect in configuration]
            for configuration in (skin_configuration, instrument_configuration)
        )
        skin_spread = [
            _spread(effect["parameters"].get(key), np.size(value))
            for effect, setting in zip(skin_configuration, skin, strict=True)
            for key, value in _of_slopes(setting).items()
        ]
        gain_spread = np.zeros((len(self.channels), 0))
        for effect, setting in zip(instrument_configuration, instrument, strict=True):
            if setting.effect.name == "channel-gain":
                assert setting.sites is not None
                spread = _spread(effect["parameters"]["gain"], len(setting.sites))
                gain_spread = np.zeros((len(self.channels), spread.shape[1]))
                gain_spread[setting.sites] = (spread.T / setting.values["gain"]).T
        return SessionModel(self, skin, instrument, block_diag(*skin_spread), gain_spread)

    def _mean(self, effect: dict) -> Setting:
        """The effect with every random parameter at its mean."""
        parameters = {
            key: {**value, "sd": 0.0} if isinstance(value, dict) else value
            for key, value in effect["parameters"].items()
        }
        counts = site_counts(self.channels)
        return settings([{**effect, "parameters": parameters}], counts, (0,))[0]


def _of_slopes(setting: Setting) -> dict:
    """The values of a skin's effect that SLOPES names: those that may be random."""
    return {key: v for key, v in setting.values.items() if (setting.effect.name, key) in SLOPES}


def _spread(parameter: object, size: int) -> np.ndarray:
    """(size, draws): the matrix that maps standard normal draws to a parameter's deviations;
    `parameter` as in the configuration."""
    if not isinstance(parameter, dict):
        return np.zeros((size, 0))
    basis = np.eye(size)
    if parameter.get("tie") == "mirror":
        half = size // 2
        basis = basis[:, : size - half]
        basis[size - half :] = np.eye(half, size - half)[::-1]
    return parameter["sd"] * basis


@dataclass
class SessionModel:
    """The readings of a session as a function of standard normal unknowns of its skin and gains.

    skin_spread (values, K) maps unknowns to deviations of the skin's parameters, gain_spread (M, G)
    to those of the channels' relative gains; read_channels (R,): the measured channels, None all.
    The noise is that of all M.
    """

    experiment: Experiment
    skin: list[Setting]
    instrument: list[Setting]
    skin_spread: np.ndarray
    gain_spread: np.ndarray
    read_channels: np.ndarray | None = None

    def __post_init__(self) -> None:
        self._forward: tuple[bytes, Forward, np.ndarray] | None = None
        self._base = Geometry.from_skin(self.experiment.skin)

    def at_mean(self) -> "SessionModel":
        """The model with every unknown fixed at its mean."""
        no_skin_spread, no_gain_spread = (
            np.zeros((len(spread), 0)) for spread in (self.skin_spread, self.gain_spread)
        )
        return replace(self, skin_spread=no_skin_spread, gain_spread=no_gain_spread)

    @cached_property
    def mixing(self) -> np.ndarray:
        """(R, M): X, the crosstalk into the measured channels."""
        return (
            self._crosstalk if self.read_channels is None else self._crosstalk[self.read_channels]
        )

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

    def geometry(self, unknowns: np.ndarray) -> Geometry:
        """The skin at standard normal unknowns (K,)."""
        deviations = self.skin_spread @ unknowns
        settings = []
        for setting in self.skin:
            values = dict(setting.values)
            for key, value in _of_slopes(setting).items():
                deviation, deviations = deviations[: np.size(value)], deviations[np.size(value) :]
                values[key] = value + deviation.reshape(np.shape(value))
            settings.append(replace(setting, values=values))
        return apply_skin(self._base, settings, START)

    def forward(self, unknowns: np.ndarray) -> tuple[Forward, np.ndarray]:
        """The forward model of the skin at unknowns (K,), and its untouched readings (M,) V; the
        latest is cached."""
        key = np.asarray(unknowns).tobytes()
        if self._forward is None or self._forward[0] != key:
            experiment = self.experiment
            forward = Forward(self.geometry(unknowns), experiment.accuracy)
            untouched = experiment.skin.current_A * forward.voltages(experiment.channels)
            self._forward = key, forward, untouched
        return self._forward[1:]

    def changes(self, xy: np.ndarray, force: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """e = g k(F) d, (F, M) V before the crosstalk, of forces (F,) N, 0 or more, at one place
        (x, y) mm."""
        experiment, forward = self.experiment, self.forward(unknowns)[0]
        place = (float(xy[0]), float(xy[1]), 0.5 * experiment.probe_mm)
        if not force.any() or not forward.meets([place])[0]:
            return np.zeros((len(force), len(experiment.channels)))
        contrast = experiment.skin.contrast_per_N * force
        d = forward.place(*place).channel_change(experiment.channels, contrast)
        return self.gain(force) * (experiment.skin.current_A * d)

    def change(self, state: np.ndarray, unknowns: np.ndarray) -> tuple[np.ndarray, float]:
        """e (M,) V of a state (x mm, y mm, F N), and the sd of the change's noise, V, with the
        gains at their mean.

        Every frame of an averaged baseline is taken to be as noisy as the sample's frame.
        """
        untouched = self.forward(unknowns)[1]
        force = state[2:]
        e = self.changes(state[:2], force, unknowns)[0]
        gained_untouched = self.gain(force)[0] * untouched
        untouched_level, touched_level = (
            np.median(np.abs(self._crosstalk @ v)) for v in (gained_untouched, gained_untouched + e)
        )
        experiment = self.experiment
        noise = experiment.noise * np.sqrt(
            untouched_level**2 / experiment.averaged + touched_level**2
        )
        return e, float(noise)

    def slopes(self, state: np.ndarray, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of e (3 + K, M) V and of the noise's sd (3 + K,) V with respect to x, y
        (1/mm), F (1/N) and the skin's unknowns.

        Exact, except for touches clipped by or close to the rim and for forces of 0, where they are
        forward differences.
        """
        experiment, force = self.experiment, float(state[2])
        contrast_per_N = experiment.skin.contrast_per_N
        assert contrast_per_N is not None
        names = self._slope_names()
        forward, untouched = self.forward(unknowns)
        touch = Touch(
            float(state[0]),
            float(state[1]),
            0.5 * experiment.probe_mm,
            contrast_per_N * force,
        )
        try:
            touched_slopes = forward.derivatives(
                [touch], [*names, "x_mm[0]", "y_mm[0]", "contrast[0]"]
            )
        except InputError:
            return self._differences(state, unknowns)
        untouched_slopes = forward.derivatives([], names)
        gain, next_gain = self.gain(force + np.arange(2.0))
        gain_slope = next_gain - gain

        def readings(slopes: list[np.ndarray]) -> np.ndarray:
            value = channel_values(np.array(slopes), experiment.channels)
            return experiment.skin.current_A * gain * value

        e, noise = self.change(state, unknowns)
        untouched_rows, change_rows = np.zeros((2, 3 + self.skin_spread.shape[1], len(e)))
        change_rows[:3] = readings(
            [touched_slopes["x_mm[0]"], touched_slopes["y_mm[0]"], touched_slopes["contrast[0]"]]
        )
        change_rows[2] = contrast_per_N * change_rows[2] + gain_slope / gain * e
        untouched_rows[2] = gain_slope * untouched
        if names:
            untouched_rows[3:] = self.skin_spread.T @ readings(
                [untouched_slopes[name] for name in names]
            )
            touched_rows = self.skin_spread.T @ readings([touched_slopes[name] for name in names])
            change_rows[3:] = touched_rows - untouched_rows[3:]
        parts = [
            (gain * untouched, untouched_rows),
            (gain * untouched + e, untouched_rows + change_rows),
        ]
        median, slope = zip(*(self._median(*part) for part in parts), strict=True)
        weight = experiment.noise**2 * np.array([1.0 / experiment.averaged, 1.0]) * median
        return change_rows, weight @ np.array(slope) / noise

    def _median(self, voltage: np.ndarray, slopes: np.ndarray) -> tuple[float, np.ndarray]:
        """The median |reading| of (M,) V before the crosstalk, and its slopes (n,), from (n, M)."""
        reading = self._crosstalk @ voltage
        middle_rank = (len(reading) - 1) / 2
        middle = np.argsort(np.abs(reading))[[int(middle_rank), int(np.ceil(middle_rank))]]
        slope = np.sign(reading[middle]) * (slopes @ self._crosstalk[middle].T)
        return float(np.abs(reading[middle]).mean()), slope.mean(axis=1)

    def _slope_names(self) -> list[str]:
        """The name in `Forward.derivatives` of each row of `skin_spread`."""
        if not self.skin_spread.shape[1]:
            return []
        return [
            SLOPES[setting.effect.name, key]
            + ("" if setting.sites is None else f"[{setting.sites[k]}]")
            for setting in self.skin
            for key, value in _of_slopes(setting).items()
            for k in range(np.size(value))
        ]

    def _differences(
        self, state: np.ndarray, unknowns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        size = 3 + len(unknowns)
        steps = np.full(size, STEP)
        steps[:3] = STEP_MM, STEP_MM, STEP_N
        point = np.concatenate([state, unknowns])

        def evaluated(values: np.ndarray) -> np.ndarray:
            return np.append(*self.change(values[:3], values[3:]))

        shifted = np.array([evaluated(point + step) for step in np.diag(steps)])
        differences = (shifted - evaluated(point)) / steps[:, None]
        return differences[:, :-1], differences[:, -1]


@dataclass(frozen=True)
class Covariance:
    """The covariance of a change: noise² 1 + B Bᵀ, B = X diag(e) T, T the `gain_spread`."""

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

    def solve(self, vectors: np.ndarray) -> np.ndarray:
        """The inverse times vectors (R, ...), by Woodbury's identity."""
        if self.basis.shape[1]:
            vectors = vectors - self.basis @ cho_solve(self._inner, self.basis.T @ vectors)
        return vectors / self.noise**2

    @cached_property
    def inverse(self) -> np.ndarray:
        """(R, R): the inverse."""
        return self.solve(np.eye(len(self.basis)))

    def information(self, slopes: np.ndarray, noise_slopes: np.ndarray) -> np.ndarray:
        """(n, n): Fisher's information of n parameters, from the slopes (n, M) of e and (n,) of the
        noise's sd. It leaves out the dependence of B on the parameters.
        """
        reading = slopes @ self.model.mixing.T
        noise_information = 2.0 * self.noise**2 * (self.inverse**2).sum()
        return reading @ self.inverse @ reading.T + noise_information * np.outer(
            noise_slopes, noise_slopes
        )

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant."""
        diagonal_part = 2.0 * (len(self.basis) - self.basis.shape[1]) * np.log(self.noise)
        if not self.basis.shape[1]:
            return float(diagonal_part)
        return float(diagonal_part + 2.0 * np.log(np.diag(self._inner[0])).sum())


@dataclass(frozen=True)
class Sample:
    """The likelihood of one change (R,) V, a `posterior.Likelihood` of the standard normal numbers
    of place (2) and force (1) and of the skin's unknowns (K)."""

    model: SessionModel
    delta_V: np.ndarray

    @property
    def size(self) -> int:
        """The number of unknowns, 3 + K."""
        return 3 + self.model.skin_spread.shape[1]

    def state(self, z: np.ndarray) -> np.ndarray:
        """(..., 3): x mm, y mm, F N of standard normal numbers (..., size)."""
        experiment = self.model.experiment
        force = force_N(z[..., 2:3], **experiment.forces)
        return np.concatenate([place_mm(z[..., :2], experiment.reach_mm), force], axis=-1)

    def log(self, z: np.ndarray) -> float:
        """Logarithm of the likelihood at z (size,), up to a constant."""
        e, noise = self.model.change(self.state(z), z[3:])
        return self._log(Covariance(self.model, e, noise))

    def _log(self, covariance: Covariance) -> float:
        residual = self.delta_V - self.model.mixing @ covariance.e
        square = residual @ covariance.solve(residual)
        return float(-0.5 * (square + covariance.log_determinant))

    def local(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The log-likelihood at z (size,), its gradient (size,) and Fisher's information (size,
        size)."""
        state = self.state(z)
        e, noise = self.model.change(state, z[3:])
        slopes, noise_slopes = self.model.slopes(state, z[3:])
        change_by_z, noise_by_z = (
            self._by_normal(z, state, derivative) for derivative in (slopes, noise_slopes)
        )
        covariance = Covariance(self.model, e, noise)
        mixing, spread = self.model.mixing, self.model.gain_spread
        inverse = covariance.inverse
        solved = inverse @ (self.delta_V - mixing @ e)
        weighted_residual, gain_covariance = mixing.T @ solved, spread @ spread.T
        gradient_by_e = weighted_residual + weighted_residual * (
            gain_covariance @ (e * weighted_residual)
        )
        gradient_by_e -= ((gain_covariance * e) * (mixing.T @ inverse @ mixing)).sum(axis=1)
        gradient_by_noise = noise * (solved @ solved - np.trace(inverse))
        information = covariance.information(change_by_z, noise_by_z)
        return (
            self._log(covariance),
            change_by_z @ gradient_by_e + gradient_by_noise * noise_by_z,
            information,
        )

    def _by_normal(self, z: np.ndarray, state: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        experiment = self.model.experiment
        by_z = slopes.copy()
        by_z[:2] = place_slope(z[:2], experiment.reach_mm).T @ slopes[:2]
        inside = 0.0 < state[2] < experiment.forces["max_N"]
        by_z[2] = experiment.forces["sd_N"] * slopes[2] if inside else 0.0
        return by_z
