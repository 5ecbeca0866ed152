"""An exported predictor, applied to one frame's change at a time."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from eitskin.data.dataset import UNITS
from eitskin.errors import InputError
from eitskin.exported import file
from eitskin.exported.channels import Channels, Missing
from eitskin.exported.electrodes import using
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
        self.scale, self.touch_scale = arrays["scale"], arrays["touch_scale"]
        self.channels = Channels(arrays["precision"], np.array(header["intervals"]["edges"]))
        self.untouched: np.ndarray | None = arrays.get("untouched")
        trained = header["trained"]
        self.weakest, self._range = trained["weakest"], np.array(trained["range"])
        self.half = np.array(header["intervals"]["half"])
        self._half_without = np.array(header["intervals"]["half_without"])
        self._widening = np.array(header["intervals"]["widening"])
        graphs = {name: Applied(graph, arrays) for name, graph in exported.graphs.items()}
        self._activity, self._strangeness = graphs["activity"], graphs["strangeness"]
        self._states, self._without = graphs["states"], graphs["without"]
        table = np.array(header["dataset"]["channels"])
        self._electrodes = 1 + int(table.max())
        self._used = np.array([using(table, [k]) for k in range(self._electrodes)])

    def activity(self, change: np.ndarray) -> float:
        """Size of a change over the channels that are there, as `learn.gates.activity`."""
        return float(self._activity(change[None])[0][0])

    def touched(self, change: np.ndarray, noise: float = 1.0) -> bool:
        """Whether a change is larger than those of untouched frames, of `noise` times the noise."""
        return self.exceeds(self.activity(change), noise)

    def exceeds(self, size: float, noise: float) -> bool:
        """Whether a change of such a size is larger than those of untouched frames."""
        return bool(size > noise * self.header["touch"]["threshold"])

    def beyond(self, estimate: Estimate) -> str:
        """Which targets lie outside the range trained on, in words; nothing where none does."""
        (low, high), words = self._range, []
        out = (estimate.state < low) | (estimate.state > high)
        for k in np.flatnonzero(out):
            unit = UNITS[self.targets[k]]
            value = f"{self.targets[k]} {estimate.state[k]:.1f} {unit}"
            words.append(f"{value}, of {low[k]:.1f} to {high[k]:.1f} {unit}")
        return "; ".join(words)

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
        state, spread = self.propagated(whole, missing, lost)
        half = self.half_of(missing.number, lost)
        return Estimate(state, np.sqrt(half**2 + (self._widening * spread) ** 2))

    def half_of(self, number: int, lost: tuple[int, ...]) -> np.ndarray:
        """(T,): half an interval's width, of a class of strength and up to two lost electrodes."""
        if not lost:
            return np.asarray(self.half[number])
        return np.maximum(self.half[number], self._half_without[len(lost) - 1, number])

    def states_without(self, whole: np.ndarray, lost: tuple[int, ...]) -> np.ndarray:
        """States (B, T) of changes (B, M) whose channels of lost electrodes are filled."""
        which = np.zeros((len(whole), self._electrodes))
        which[:, list(lost)] = 1.0
        return self._without(np.hstack([whole, which]))[0]

    def propagated(
        self, whole: np.ndarray, missing: Missing, lost: tuple[int, ...] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state (T,), and how much (T,) it varies with what the missing channels beside those
        of lost electrodes may be: of the states a standard deviation away along each direction, to
        first and second order.

        The mean over what is missing, to second order, is the state (Julier, Uhlmann 1997).
        """
        apply = partial(self.states_without, lost=lost) if lost else self.states
        of = missing.gone
        if lost:
            of = tuple(k for k in of if not self._used[list(lost), k].any())
        if not of:
            state = apply(whole[None])[0]
            return state, np.zeros_like(state)
        root, gone = self.channels.root(missing.number, missing.gone, of), list(missing.gone)
        directions = root.shape[1]
        frames = np.repeat(whole[None], 1 + 2 * directions, axis=0)
        off = root.T * self.scale[gone]
        frames[1 : 1 + directions, gone] += off
        frames[1 + directions :, gone] -= off
        states = apply(frames)
        state, ahead, behind = states[0], states[1 : 1 + directions], states[1 + directions :]
        slope, bend = 0.5 * (ahead - behind), 0.5 * (ahead + behind) - state
        spread = np.sqrt((slope**2).sum(axis=0) + 0.5 * (bend**2).sum(axis=0))
        return state + bend.sum(axis=0), spread


def read(path: str | Path) -> Predictor:
    """The predictor of a file, tried on a frame; raises InputError for a file that is damaged."""
    exported = file.read(path)
    try:
        predictor = Predictor(exported)
        whole, missing = predictor.filled(np.full(len(predictor.scale), 1e-9))
        predictor.touched(whole), predictor.familiar(whole)
        sizes = {len(predictor.estimate(whole, missing, lost).state) for lost in ((), (0,))}
    except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError):
        sizes = set()
    if sizes != {len(exported.header["dataset"]["targets"])}:
        found, expected = "networks that cannot be applied", "those of its channels and targets"
        raise InputError(path, "graphs", found, expected)
    return predictor
