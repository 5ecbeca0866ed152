"""An exported predictor, applied to one frame's change at a time."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from eitskin.data.dataset import UNITS
from eitskin.errors import InputError
from eitskin.exported import file
from eitskin.exported.channels import Channels, Missing
from eitskin.exported.electrodes import channels_using
from eitskin.exported.file import Exported
from eitskin.exported.graph import GraphFunction


@dataclass(frozen=True)
class Estimate:
    """A state (T,) in the units of the targets, and the half widths (T,) of its intervals."""

    state: np.ndarray
    half: np.ndarray


class Predictor:
    """Estimates of touches from changes (M,) in the unit of the training set, NaN where a channel
    is missing."""

    def __init__(self, exported: Exported):
        header, arrays = exported.header, exported.arrays
        self.header, self.targets = header, header["dataset"]["targets"]
        self.scale, self.touch_scale = arrays["scale"], arrays["touch_scale"]
        self.channels = Channels(arrays["precision"], np.array(header["intervals"]["edges"]))
        self.untouched: np.ndarray | None = arrays.get("untouched")
        trained = header["trained"]
        self.weakest, self._range = trained["weakest"], np.array(trained["range"])
        self.half = np.array(header["intervals"]["half"])
        self._half_without = np.array(header["intervals"]["half_without"])
        self._widening = np.array(header["intervals"]["widening"])
        graphs = {name: GraphFunction(graph, arrays) for name, graph in exported.graphs.items()}
        self._activity, self._strangeness = graphs["activity"], graphs["strangeness"]
        self._states, self._without = graphs["states"], graphs["without"]
        table = np.array(header["dataset"]["channels"])
        self._electrodes = 1 + int(table.max())
        self._channel_users = np.array(
            [channels_using(table, [k]) for k in range(self._electrodes)]
        )

    def activity(self, change: np.ndarray) -> float:
        """Size of a change over its measured channels, as `learn.gates.activity`."""
        return float(self._activity(change[None])[0][0])

    def touched(self, change: np.ndarray, noise: float = 1.0) -> bool:
        """Whether a change is larger than those of untouched frames with `noise` times the noise of
        the training set."""
        return self.exceeds(self.activity(change), noise)

    def exceeds(self, size: float, noise: float) -> bool:
        """Whether a change of this size is larger than those of untouched frames."""
        return bool(size > noise * self.header["touch"]["threshold"])

    def out_of_range(self, estimate: Estimate) -> str:
        """The targets that lie outside the range of the training set, in words; empty if none."""
        (low, high), words = self._range, []
        outside = (estimate.state < low) | (estimate.state > high)
        for k in np.flatnonzero(outside):
            unit = UNITS[self.targets[k]]
            value = f"{self.targets[k]} {estimate.state[k]:.1f} {unit}"
            words.append(f"{value}, of {low[k]:.1f} to {high[k]:.1f} {unit}")
        return "; ".join(words)

    def familiar(self, change: np.ndarray) -> bool:
        """Whether a change without missing channels is like those of the training set."""
        residual, distance = self._strangeness(change[None])
        limits = self.header["familiar"]
        close = distance[0] <= limits["limit_distance"]
        return bool(close and residual[0] <= limits["limit_residual"])

    def states(self, change: np.ndarray) -> np.ndarray:
        """States (B, T) of changes (B, M) without missing channels."""
        return self._states(change)[0]

    def filled(self, change: np.ndarray) -> tuple[np.ndarray, Missing]:
        """A change with its missing channels at their conditional mean, and those channels."""
        z = change / self.scale
        filled, missing = self.channels.filled(z, self.channels.strength_class(z))
        return filled * self.scale, missing

    def estimate(
        self, change: np.ndarray, missing: Missing, lost: tuple[int, ...] = ()
    ) -> Estimate:
        """The state of a change from `filled`. Where electrodes are lost the network trained
        without them gives it, with an interval never narrower than with all electrodes."""
        state, spread = self.propagated(change, missing, lost)
        half = self.half_of(missing.class_number, lost)
        return Estimate(state, np.sqrt(half**2 + (self._widening * spread) ** 2))

    def half_of(self, class_number: int, lost: tuple[int, ...]) -> np.ndarray:
        """(T,): half an interval's width, for a class of strength and up to two lost electrodes."""
        if not lost:
            return np.asarray(self.half[class_number])
        return np.maximum(self.half[class_number], self._half_without[len(lost) - 1, class_number])

    def states_without(self, change: np.ndarray, lost: tuple[int, ...]) -> np.ndarray:
        """States (B, T) of changes (B, M) in which the channels of lost electrodes are filled."""
        lost_indicator = np.zeros((len(change), self._electrodes))
        lost_indicator[:, list(lost)] = 1.0
        return self._without(np.hstack([change, lost_indicator]))[0]

    def propagated(
        self, change: np.ndarray, missing: Missing, lost: tuple[int, ...] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state (T,) averaged over the missing channels, and its standard deviation (T,), both
        to second order, from states one standard deviation away along each principal direction of
        the missing channels (unscented transform, Julier and Uhlmann 1997).

        Channels of lost electrodes do not count as missing: their network does not depend on them.
        """
        network = partial(self.states_without, lost=lost) if lost else self.states
        uncertain_channels = missing.channels
        if lost:
            uncertain_channels = tuple(
                k for k in uncertain_channels if not self._channel_users[list(lost), k].any()
            )
        if not uncertain_channels:
            state = network(change[None])[0]
            return state, np.zeros_like(state)
        root = self.channels.root(missing.class_number, missing.channels, uncertain_channels)
        missing_channels = list(missing.channels)
        directions = root.shape[1]
        frames = np.repeat(change[None], 1 + 2 * directions, axis=0)
        deviations = root.T * self.scale[missing_channels]
        frames[1 : 1 + directions, missing_channels] += deviations
        frames[1 + directions :, missing_channels] -= deviations
        states = network(frames)
        state = states[0]
        states_ahead = states[1 : 1 + directions]
        states_behind = states[1 + directions :]
        first_order = 0.5 * (states_ahead - states_behind)
        second_order = 0.5 * (states_ahead + states_behind) - state
        spread = np.sqrt((first_order**2).sum(axis=0) + 0.5 * (second_order**2).sum(axis=0))
        return state + second_order.sum(axis=0), spread


def read(path: str | Path) -> Predictor:
    """The predictor of a file, tried on one frame; raises InputError for a damaged file."""
    exported = file.read(path)
    try:
        predictor = Predictor(exported)
        change, missing = predictor.filled(np.full(len(predictor.scale), 1e-9))
        predictor.touched(change), predictor.familiar(change)
        sizes = {len(predictor.estimate(change, missing, lost).state) for lost in ((), (0,))}
    except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError):
        sizes = set()
    if sizes != {len(exported.header["dataset"]["targets"])}:
        content, expected = "networks that cannot be applied", "those of its channels and targets"
        raise InputError(path, "graphs", content, expected)
    return predictor
