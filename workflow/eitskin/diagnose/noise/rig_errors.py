"""The errors of a rig about a fit, and the covariance assembled from them.

The covariance of all readings is that of the noise plus a term U diag(w) U^T of low rank for every
component: U are its columns (`NoiseComponent.basis`), w its squared standard deviations
(`NoiseComponent.weights`), which `component_sds` learns.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakValueDictionary

import numpy as np

from eitskin.diagnose.noise.components import COMPONENTS, TouchComponent
from eitskin.diagnose.noise.linearisation import Linearisation
from eitskin.diagnose.noise.low_rank import press_indicator
from eitskin.diagnose.noise.spectrum import WHITE
from eitskin.diagnose.noise.whitening import ErrorColumns, Whitening

FREE = 10.0  # times an error's sd, at which a hundredth of its size is expected to be there


@dataclass(frozen=True)
class RigErrors:
    """The components that a recording can have, about a fit of N frames and M channels.

    noise_whitening: the covariance without them. columns (K, N, M): what one unit of each of K
    independent errors does, by component. prior_sds: of the components' sds, in their units.
    derivatives (N, M): of the readings by the touches, as in `Linearisation`. displacements: of the
    components of touches, for each of the K the displacements (N,) by one unit, by column of the
    states. press (N,): the press that a frame is of, -1 for none. assumed: components whose sd
    the recording does not show; they have that of the prior.
    """

    noise_whitening: Whitening
    columns: dict[str, np.ndarray]
    prior_sds: dict[str, float]
    derivatives: Mapping[str, np.ndarray]
    displacements: dict[str, list[dict[str, np.ndarray]]]
    press: np.ndarray
    assumed: frozenset[str]
    _whitenings: WeakValueDictionary = field(
        default_factory=WeakValueDictionary, init=False, repr=False, compare=False
    )

    @classmethod
    def from_linearisation(
        cls, linearisation: Linearisation, noise_whitening: Whitening
    ) -> "RigErrors":
        """All registered components that the recording can have."""
        present = {
            name: component
            for name, component in COMPONENTS.items()
            if component.is_present(linearisation)
        }
        typical = linearisation.typical_reading
        return cls(
            noise_whitening=noise_whitening,
            columns={
                name: np.where(noise_whitening.mask, component.basis(linearisation), 0.0)
                for name, component in present.items()
            },
            prior_sds={
                name: component.prior_in_unit(typical) for name, component in present.items()
            },
            derivatives=linearisation.derivatives,
            displacements={
                name: component.displacements(linearisation)
                for name, component in present.items()
                if isinstance(component, TouchComponent)
            },
            press=linearisation.press,
            assumed=frozenset(
                name
                for name, component in present.items()
                if not component.is_identifiable(linearisation)
            ),
        )

    def __getstate__(self) -> dict:
        derived = (
            "_whitenings",
            "filtered",
            "single_precision_columns",
            "shared_columns",
            "latest_press",
        )
        return {name: value for name, value in vars(self).items() if name not in derived}

    def __setstate__(self, state: dict) -> None:
        vars(self).update(state, _whitenings=WeakValueDictionary())

    @cached_property
    def filtered(self) -> dict[str, np.ndarray]:
        """`columns` as the filter of the noise in time leaves them (`Whitening.filtered`)."""
        return {
            name: self.noise_whitening.filtered(columns, COMPONENTS[name].acts_on)
            for name, columns in self.columns.items()
        }

    @cached_property
    def single_precision_columns(self) -> dict[str, np.ndarray]:
        """`filtered` times the priors' sd, in single precision: in the recording's unit squares of
        squares would overflow."""
        return {
            name: (self.prior_sds[name] * columns).astype(np.float32)
            for name, columns in self.filtered.items()
        }

    @cached_property
    def shared_columns(self) -> np.ndarray:
        """(K, N, M): what all presses share of the errors of touches, and all frames of a gain
        (`NoiseComponent.alike`), filtered, FREE times as large as the priors' sd."""
        shape = self.noise_whitening.mask.shape
        columns = [
            FREE * self.prior_sds[name] * columns[COMPONENTS[name].alike]
            for name, columns in self.columns.items()
        ]
        shared = np.concatenate([np.zeros((0, *shape)), *columns])
        return self.noise_whitening.filtered(shared, "whole")

    @cached_property
    def latest_press(self) -> np.ndarray:
        """(N,): the press that was the latest to begin by each frame, -1 before the first: where
        noise lasts, `filtered` columns of a press go on after its touch, up to the next one."""
        latest = np.maximum.accumulate(np.where(self.press < 0, -1, np.arange(len(self.press))))
        return np.where(latest < 0, -1, self.press[latest])

    @property
    def press_indicator(self) -> np.ndarray:
        """(B, N): 1 where a press was the latest to begin, else 0."""
        return press_indicator(self.latest_press)

    def whitening(
        self,
        error_sds: Mapping[str, float],
        discrepancy: bool = True,
        fitted: bool = False,
        restricted: bool = False,
    ) -> Whitening:
        """The covariance with components of these sds.

        Components without columns here add nothing. discrepancy: with those that stand for physics
        without a name. fitted: in the form for fits, which follows lasting errors into the channels
        that the errors of frames and presses carry them to (`NoiseComponent.weights`). restricted:
        in the form for learning sds, with `shared_columns` beside the components: what all presses
        or frames share may be an effect's, and tells nothing of how they differ. A whitening that
        is still in use elsewhere is returned again, with the factors that it has computed.
        """
        positive = {k: v for k, v in error_sds.items() if v > 0.0 and k in self.columns}
        fitted = fitted and any(COMPONENTS[name].lasting for name in positive)
        key = discrepancy, fitted, restricted, *positive.items()
        whitening = self._whitenings.get(key)
        if whitening is None:
            whitening = self._assembled(positive, discrepancy, fitted, restricted)
            self._whitenings[key] = whitening
        return whitening

    def _assembled(
        self, error_sds: Mapping[str, float], discrepancy: bool, fitted: bool, restricted: bool
    ) -> Whitening:
        """The noise's covariance with the weighted columns of all components of some sd."""
        weighted: dict[str, list[tuple[float, np.ndarray]]]
        weighted = {"channel": [], "frame": [], "whole": [], "press": [], "linked": []}
        for name, error_sd in error_sds.items():
            component = COMPONENTS[name]
            if discrepancy or not component.discrepancy:
                for acts_on, weight in component.weights(error_sd, fitted).items():
                    weighted[acts_on].append((weight, self.filtered[name]))
        if restricted and len(self.shared_columns):
            weighted["whole"].append((1.0, self.shared_columns))
        if not weighted["frame"] and not weighted["press"]:
            # Nothing carries them to other channels.
            weighted["channel"] += weighted.pop("linked")
        if not any(weighted.values()):
            return self.noise_whitening
        shape = self.noise_whitening.mask.shape
        columns = {acts_on: _stacked(terms, shape) for acts_on, terms in weighted.items()}
        errors = ErrorColumns(**columns, press_label=self.latest_press, filtered=True)
        return self.noise_whitening.with_errors(errors)

    @property
    def learned(self) -> list[str]:
        """Components whose sds are learned."""
        return [name for name in self.columns if name not in self.assumed]

    def learned_first(self, start_sds: Mapping[str, float]) -> list[str]:
        """Those of `learned` with which learning begins: all but occasional ones without an sd at
        the start."""
        return [
            name
            for name in self.learned
            if not COMPONENTS[name].occasional or start_sds.get(name, 0.0) > 0.0
        ]

    def initial_sds(self, start_sds: Mapping[str, float]) -> dict[str, float]:
        """The sd of every component: that of a start, else 0; the prior's where it is assumed, 0
        where fits do not reckon with it."""
        return {
            name: self.prior_sds[name] if name in self.assumed else float(start_sds.get(name, 0.0))
            for name in self.columns
            if COMPONENTS[name].in_covariance
        }

    def log_prior(self, error_sds: Mapping[str, float]) -> float:
        """Log density of sds, above that of none: -sum (sd / prior sd)^2 / 2."""
        return -0.5 * sum(
            (error_sds.get(name, 0.0) / prior_sd) ** 2 for name, prior_sd in self.prior_sds.items()
        )

    def log_likelihood(
        self,
        error_sds: Mapping[str, float],
        residual: np.ndarray,
        whitening: Whitening | None = None,
    ) -> float:
        """Restricted log density of a residual (N, M) in the recording's unit, with the prior of
        the sds, up to a constant that is the same for all sds; whitening: the restricted one of
        these sds, where it is known."""
        whitening = whitening or self.whitening(error_sds, restricted=True)
        chi2 = float((whitening(residual) ** 2).sum())
        return -0.5 * (chi2 + whitening.log_determinant) + self.log_prior(error_sds)

    def displacement_sds(self, error_sds: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Sd (N,) by which touches are displaced, in mm and N, by column of the states."""
        variances = {column: np.zeros(len(self.press)) for column in self.derivatives}
        for name, errors in self.displacements.items():
            for error in errors:
                for column, displacement in error.items():
                    variances[column] += (error_sds.get(name, 0.0) * displacement) ** 2
        return {column: np.sqrt(variance) for column, variance in variances.items()}

    def free_in_frames(self, error_sds: Mapping[str, float]) -> dict[str, float]:
        """Sds with FREE times as large errors, independent from frame to frame, in place of those
        that have an sd and move the readings of a frame, or its touch, in the same directions.

        What is tested in such a covariance does not depend on the course of these errors in time.
        """
        free_sds = dict(error_sds)
        square: dict[str, float] = {}
        for name, columns in self.columns.items():
            counterpart = COMPONENTS[name].every_frame
            if counterpart in self.columns and (error_sd := error_sds.get(name, 0.0)) > 0.0:
                length = float((columns**2).sum()) * error_sd**2
                unit_length = float((self.columns[counterpart] ** 2).sum())
                square[counterpart] = square.get(counterpart, 0.0) + length / unit_length
        return free_sds | {name: FREE * float(np.sqrt(value)) for name, value in square.items()}

    def frame_whitening(self, error_sds: Mapping[str, float]) -> Whitening:
        """The covariance of each frame by itself, its touch being where it is: the noise, what
        moves all its readings together, and the mean square of the errors of channels. Touches are
        not moved to explain these."""
        common_mode = [
            error_sds.get(name, 0.0) * columns
            for name, columns in self.columns.items()
            if COMPONENTS[name].common_mode
        ]
        empty = np.zeros((0, *self.noise_whitening.mask.shape))
        variance = self.noise_whitening.sd**2
        count = np.maximum(self.noise_whitening.mask.sum(axis=0), 1)
        for name, columns in self.columns.items():
            if COMPONENTS[name].acts_on == "channel":
                square = (error_sds.get(name, 0.0) * columns) ** 2
                variance = variance + square.sum(axis=(0, 1)) / count
        return replace(
            self.noise_whitening,
            sd=np.sqrt(variance),
            offset_ratio=np.zeros_like(self.noise_whitening.offset_ratio),
            spectrum=WHITE,
            errors=ErrorColumns(empty, np.concatenate([empty, *common_mode]), empty),
        )

    def response(self, displacements: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N, M): what displacements (N,) of touches change in the readings, in proportion; 0 where
        the physics has no derivatives."""
        changes = [
            displacements[column][:, None] * derivative
            for column, derivative in self.derivatives.items()
        ]
        return sum(changes, start=np.zeros(self.noise_whitening.mask.shape))


def _stacked(terms: list[tuple[float, np.ndarray]], shape: tuple[int, ...]) -> np.ndarray:
    """(K, N, M): all columns of terms, each times its weight."""
    stacked = np.empty((sum(len(columns) for _, columns in terms), *shape))
    start = 0
    for weight, columns in terms:
        np.multiply(columns, weight, out=stacked[start : start + len(columns)])
        start += len(columns)
    return stacked
