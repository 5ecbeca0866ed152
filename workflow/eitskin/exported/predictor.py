"""An exported predictor, applied to one frame's change at a time."""

from dataclasses import dataclass

import numpy as np

from eitskin.exported.channels import Channels, Missing
from eitskin.exported.file import Exported
from eitskin.exported.graph import Applied


@dataclass(frozen=True)
class Estimate:
    """state (T,) in the units of the targets, half (T,): half its interval's width."""

    state: np.ndarray
    half: np.ndarray


class Predictor:
    """Changes (M,) in the unit trained on, NaN where a channel is missing, to estimates."""

    def __init__(self, exported: Exported):
        header, arrays = exported.header, exported.arrays
        self.header, self.targets = header, header["dataset"]["targets"]
        self.level = header["intervals"]["level"]
        self.scale, self.touch_scale = arrays["scale"], arrays["touch_scale"]
        self.channels = Channels(arrays["precision"], np.array(header["intervals"]["edges"]))
        self.half = np.array(header["intervals"]["half"])
        self._half_without = np.array(header["intervals"]["half_without"])
        self._widening = np.array(header["intervals"]["widening"])
        graphs = {name: Applied(graph, arrays) for name, graph in exported.graphs.items()}
        self._activity, self._strangeness = graphs["activity"], graphs["strangeness"]
        self._states, self._without = graphs["states"], graphs["without"]
        self._electrodes = 1 + int(np.max(header["dataset"]["channels"]))

    def activity(self, change: np.ndarray) -> float:
        """Size of a change over the channels that are there, as `learn.gates.activity`."""
        return float(self._activity(change[None])[0][0])

    def touched(self, change: np.ndarray) -> bool:
        """Whether a change is larger than those of untouched frames."""
        return self.activity(change) > self.header["touch"]["threshold"]

    def familiar(self, whole: np.ndarray) -> bool:
        """Whether a change without gaps looks like what the model was trained on."""
        residual, distance = self._strangeness(whole[None])
        limits = self.header["familiar"]
        near = distance[0] <= limits["limit_distance"]
        return bool(near and residual[0] <= limits["limit_residual"])

    def states(self, whole: np.ndarray) -> np.ndarray:
        """States (B, T) of changes (B, M) without gaps."""
        return self._states(whole)[0]

    def filled(self, change: np.ndarray) -> tuple[np.ndarray, Missing]:
        """A change without gaps, in what is missing as the other channels say, and how that is
        known."""
        z = change / self.scale
        whole, missing = self.channels.filled(z, self.channels.class_of(z))
        return whole * self.scale, missing

    def estimate(self, whole: np.ndarray, missing: Missing, lost: tuple[int, ...] = ()) -> Estimate:
        """The state of what `filled` has made of a change; of one without the channels of lost
        electrodes by the network that has learned to do without, its interval never narrower than
        with all of them."""
        number = missing.number
        if lost:
            return Estimate(self.states_without(whole[None], lost)[0], self.half_of(number, lost))
        state, spread = self.propagated(whole, missing)
        return Estimate(state, np.sqrt(self.half[number] ** 2 + (self._widening * spread) ** 2))

    def half_of(self, number: int, lost: tuple[int, ...]) -> np.ndarray:
        """(T,): half an interval's width, of a class of strength and one or two lost electrodes."""
        return np.maximum(self.half[number], self._half_without[len(lost) - 1, number])

    def states_without(self, whole: np.ndarray, lost: tuple[int, ...]) -> np.ndarray:
        """States (B, T) of changes (B, M) whose channels of lost electrodes are filled."""
        which = np.zeros((len(whole), self._electrodes))
        which[:, list(lost)] = 1.0
        return self._without(np.hstack([whole, which]))[0]

    def propagated(self, whole: np.ndarray, missing: Missing) -> tuple[np.ndarray, np.ndarray]:
        """The state (T,), and how much (T,) it varies with what the missing channels may be: of the
        states a standard deviation away along each direction, to first and second order.

        The mean over what is missing, to second order, is the state (Julier, Uhlmann 1997).
        """
        if not missing.gone:
            state = self.states(whole[None])[0]
            return state, np.zeros_like(state)
        root, gone = self.channels.root(missing.number, missing.gone), list(missing.gone)
        directions = root.shape[1]
        frames = np.repeat(whole[None], 1 + 2 * directions, axis=0)
        off = root.T * self.scale[gone]
        frames[1 : 1 + directions, gone] += off
        frames[1 + directions :, gone] -= off
        states = self.states(frames)
        state, ahead, behind = states[0], states[1 : 1 + directions], states[1 + directions :]
        slope, bend = 0.5 * (ahead - behind), 0.5 * (ahead + behind) - state
        spread = np.sqrt((slope**2).sum(axis=0) + 0.5 * (bend**2).sum(axis=0))
        return state + bend.sum(axis=0), spread
