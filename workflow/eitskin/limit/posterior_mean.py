"""How well physics allows a touch to be known from one change of the voltages.

The best estimate in squared error is the posterior mean, under the distribution that the set was
drawn from: places even over the disc, clipped normal forces, and the session's skin and gains
either known or drawn as the configuration says. Its errors on tested samples are the limit that a
model of the same samples is held against, in the same metrics.
"""

from typing import TypedDict

import numpy as np
import pandas as pd
from scipy.special import ndtri

from eitskin.data.dataset import Dataset
from eitskin.limit.observation import Experiment, Sample, SessionModel
from eitskin.limit.posterior import different, draw, find_mode
from eitskin.limit.score import ESTIMATES, SEED, TARGETS
from eitskin.physics.skin import Skin
from eitskin.progress import patient
from eitskin.simulate.state_priors import force_N, place_normal

PLACES, FORCES = 600, 8  # from which searches may start
STARTS, APART_MM = 2, 12.0
LEAST_EFFECTIVE, MORE = 16.0, (4, 16)  # draws; with fewer as many times the pairs are drawn


def experiment_of(
    dataset: Dataset,
    skin: dict,
    accuracy: str,
    effects: list[dict],
    session_frames: int,
    continuous: dict,
) -> Experiment:
    """What a continuous set's samples were drawn from, by the configuration's blocks; raises
    InputError for effects without a likelihood."""
    return Experiment(
        Skin.from_metadata(skin, "config.yaml"),
        np.array(dataset.metadata["channels"]),
        accuracy,
        effects,
        dataset.metadata["noise"],
        session_frames if dataset.metadata["baseline"] == "averaged" else 1,
        force_max_N=dataset.table["force_N"].max(),
        **{key: value for key, value in continuous.items() if key != "samples"},
    )


class Starts:
    """Noise-free changes of the mean skin, spread over places and forces, to start from."""

    def __init__(self, model: SessionModel):
        experiment = model.experiment
        turn = np.arange(PLACES) * np.pi * (3.0 - np.sqrt(5.0))
        radius = experiment.reach_mm * np.sqrt((np.arange(PLACES) + 0.5) / PLACES)
        self.place = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
        self.force_normal = ndtri((np.arange(FORCES) + 0.5) / FORCES)
        self.place_normal = place_normal(self.place, experiment.reach_mm)
        force = force_N(self.force_normal, **experiment.forces)
        mean = np.zeros(model.skin_spread.shape[1])
        self.change = np.array(
            [model.changes(place, force, mean) @ model.mixing.T for place in self.place]
        )

    def of(self, delta_V: np.ndarray, read: np.ndarray | None = None) -> np.ndarray:
        """(STARTS, 3): standard normal numbers of the states whose changes come nearest to (M,) V,
        in the channels that are read, None all; places apart."""
        seen = slice(None) if read is None else read
        misfit = ((self.change[..., seen] - delta_V[seen]) ** 2).sum(axis=-1)
        force, best = misfit.argmin(axis=1), misfit.min(axis=1)
        chosen: list[int] = []
        for k in np.argsort(best, kind="stable"):
            near = np.linalg.norm(self.place[chosen] - self.place[k], axis=1) < APART_MM
            if not near.any():
                chosen.append(int(k))
            if len(chosen) == STARTS:
                break
        return np.column_stack([self.place_normal[chosen], self.force_normal[force[chosen]]])


class Estimate(TypedDict):
    """Posterior `mean` and `sd` (3,) of x mm, y mm and F N; `effective`, the share of the weighted
    draws that counts, and `modes`, how many there are."""

    mean: np.ndarray
    sd: np.ndarray
    effective: float
    modes: int


def estimate(
    model: SessionModel,
    delta_V: np.ndarray,
    starts: np.ndarray,
    pairs: int,
    rng: np.random.Generator,
) -> Estimate:
    """What the posterior says given a change (R,) V of the channels that the model reads.

    starts (S, 3): standard normal numbers of the states from which modes are sought.
    """
    sample = Sample(model, delta_V)
    rest = np.zeros(sample.size - 3)
    modes = different([find_mode(sample, np.concatenate([start, rest])) for start in starts])
    draws = draw(sample, modes, pairs, rng)
    for more in MORE:
        if draws.effective < LEAST_EFFECTIVE:
            draws = draw(sample, modes, more * pairs, rng)
    state = sample.state(draws.z)
    mean = draws.weight @ state
    return {
        "mean": mean,
        "sd": np.sqrt(draws.weight @ (state - mean) ** 2),
        "effective": draws.effective / len(draws.z),
        "modes": len(modes),
    }


def estimates(
    experiment: Experiment, dataset: Dataset, part: np.ndarray, seed: int, samples: int, pairs: int
) -> pd.DataFrame:
    """A row an estimate and tested sample, of `samples` drawn from the test part: `estimate`,
    sample, session, the true x_mm, y_mm, force_N, their posterior `_mean` and `_sd`, `effective`
    and `modes`.
    """
    tested = np.flatnonzero(part == "test")
    rng = np.random.default_rng([seed, SEED])
    rows = np.sort(rng.choice(tested, min(samples, len(tested)), replace=False))
    unknown = experiment.unknown()
    starts = Starts(unknown)
    known: tuple[int, SessionModel] | None = None
    found = []
    for row in patient(rows, "samples"):
        truth, change = dataset.table.iloc[row], dataset.delta_V[row].astype(float)
        session = int(truth["session"])
        if known is None or known[0] != session:
            known = session, experiment.known(seed, session)
        for name, model in zip(ESTIMATES, (unknown, known[1]), strict=True):
            own = np.random.default_rng([seed, SEED, int(truth["sample"])])
            posterior = estimate(model, change, starts.of(change), pairs, own)
            one = {"estimate": name, "sample": int(truth["sample"]), "session": session}
            for k, column in enumerate(TARGETS.values()):
                one[column] = truth[column]
                one[f"{column}_mean"] = posterior["mean"][k]
                one[f"{column}_sd"] = posterior["sd"][k]
            one |= {"effective": posterior["effective"], "modes": posterior["modes"]}
            found.append(one)
    return pd.DataFrame(found)
