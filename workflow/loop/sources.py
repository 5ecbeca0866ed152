"""The world of a recording whose truth is known, as a source of training samples beside the others:

belief     the nominal skin, its calibrations fitted to the recording, without effects
authors    belief with the perturbations of a configuration, drawn for every session
diagnosis  the skin and the effects of the diagnosis, at their values (`simulators.Simulator`)
truth      the world of the recording
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, largest_force_N
from eitskin.physics.skin import Skin
from witness.world import World


@dataclass(frozen=True)
class Truth:
    """The witness' world with its effects."""

    world: World
    effects: list[dict]

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """Noise-free signed readings (N, M), as `Simulator.readings`."""
        readings = np.empty((len(states), len(recorded.channels)))
        for rows in states.groupby("session").indices.values():
            session_frames = states.iloc[rows].reset_index(drop=True)
            readings[rows] = self.world.readings(
                session_frames, self.effects, force_max_N=largest_force_N(recorded)
            )
        return readings


def truth(description: dict, recorded: Recording) -> Truth:
    """The world of a truth.json of `loop.case`."""
    metadata = recorded.metadata
    grounded = metadata["source_reference"] == "sink-grounded"
    skin = Skin.from_metadata(description["true"], "truth.json")
    return Truth(
        World(skin, recorded.channels, metadata["frame_s"], grounded), description["effects"]
    )
