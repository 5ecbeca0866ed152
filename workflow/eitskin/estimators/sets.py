"""Sets of training samples drawn from a simulator.

Sets of one seed have the same places, forces and times of presses and the same noise, that of the
recording's readings (`diagnose.noise`, from the recording alone).
"""

from typing import Protocol

import numpy as np
import pandas as pd

from eitskin.data import dataset
from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.errors import InputError
from eitskin.learn.train import Split
from eitskin.simulate.imitation import PressPrior, imitated_presses

VALIDATION_PERIOD = 5  # every fifth session validates: a fifth of the samples


class Source(Protocol):
    """What makes readings of states: a `simulators.Simulator`, or a world whose truth is known."""

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """Noise-free signed readings (N, M) of frames with a column `session`."""
        ...


def source_set(
    simulator: Source,
    recorded: Recording,
    samples: int,
    seed: int,
    prior: PressPrior,
    name: str,
    as_recorded: bool = False,
) -> Split:
    """A set of at least `samples` training samples of a simulator with imitated presses; every
    fifth session is the validation part.

    as_recorded: with magnitudes where the recording has these, and without the channels that it
    lost; else signed, of all channels. Raises InputError as `dataset.no_training` says.
    """
    refusal = dataset.no_training(recorded)
    if refusal is not None:
        raise InputError("recording", *refusal)
    states_rng, noise_rng = (np.random.default_rng([seed, k]) for k in (4, 5))
    touched = int(recorded.frames["touch"].sum())
    sessions = max(
        VALIDATION_PERIOD,
        int(np.ceil(samples / touched * VALIDATION_PERIOD / (VALIDATION_PERIOD - 1))) + 1,
    )
    states = imitated_presses(recorded, sessions, states_rng, prior)
    sd = estimate_noise(excerpt(recorded)).sd
    voltage = simulator.readings(states, recorded, seed)
    voltage += sd * noise_rng.standard_normal(voltage.shape)
    kind = "signed"
    if as_recorded:
        kind = recorded.metadata["voltage"]
        voltage = np.abs(voltage) if kind == "magnitude" else voltage
        voltage[:, dataset.from_recording(recorded, name).metadata["lost_channels"]] = np.nan
    metadata = recorded.metadata | {"voltage": kind, "source": "simulation"}
    source_dataset = dataset.from_recording(Recording(states, voltage, None, None, metadata), name)
    is_validation = (
        source_dataset.table["session"].to_numpy() % VALIDATION_PERIOD == VALIDATION_PERIOD - 1
    )
    return Split(source_dataset, np.where(is_validation, "validation", "train"))
