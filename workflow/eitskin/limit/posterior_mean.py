"""The lowest error with which a touch can be estimated from one change of the voltages.

The best estimate in squared error is the posterior mean under the distribution the set was drawn
from: places uniform over the disc, clipped normal forces, and the session's skin and gains either
known or distributed as in the configuration. Its errors on test samples are the limit for models
tested on the same samples, in the same metrics.
"""

from typing import TypedDict

import numpy as np
import pandas as pd
from scipy.special import ndtri

from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.limit.observation import Experiment, Sample, SessionModel
from eitskin.limit.posterior import distinct_modes, draw, find_mode
from eitskin.limit.score import ESTIMATES, SEED, TARGETS
from eitskin.physics.skin import Skin
from eitskin.progress import patient
from eitskin.simulate.state_priors import force_N, place_normal

PLACES, FORCES = 600, 8  # of the table of starts: places some 5 mm apart on a disc of 72 mm
STARTS, APART_MM = 2, 12.0  # searches, from places farther apart than one mode is wide
MIN_EFFECTIVE, PAIR_FACTORS = 16.0, (4, 16)  # effective draws; below, pairs are multiplied so


def experiment_of(
    dataset: Dataset,
    skin: dict,
    accuracy: str,
    effects: list[dict],
    session_frames: int,
    continuous: dict,
) -> Experiment:
    """The distribution of a continuous set's samples, from the configuration's blocks; raises
    InputError for effects without a likelihood, and for a skin with an outline."""
    if continuous["reach_mm"] is None:
        expected = "a disc: the limit's prior of places is uniform over one"
        raise InputError("config.yaml", "skin.outline", "an outline", expected)
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
    """Starting points of searches: noise-free changes of the mean skin on a spiral of PLACES and at
    FORCES quantiles of the force."""

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

    def nearest(self, delta_V: np.ndarray, read_channels: np.ndarray | None = None) -> np.ndarray:
        """(STARTS, 3): standard normal numbers of the states whose changes are nearest to (M,) V in
        `read_channels`, None all, with places at least APART_MM apart."""
        channels = slice(None) if read_channels is None else read_channels
        misfit = ((self.change[..., channels] - delta_V[channels]) ** 2).sum(axis=-1)
        force, best = misfit.argmin(axis=1), misfit.min(axis=1)
        start_places: list[int] = []
        for k in np.argsort(best, kind="stable"):
            too_close = np.linalg.norm(self.place[start_places] - self.place[k], axis=1) < APART_MM
            if not too_close.any():
                start_places.append(int(k))
            if len(start_places) == STARTS:
                break
        return np.column_stack(
            [self.place_normal[start_places], self.force_normal[force[start_places]]]
        )


class Estimate(TypedDict):
    """Posterior `mean` and `sd` (3,) of x mm, y mm and F N; `effective`, the effective sample size
    over the number of draws; `modes`, the number of modes."""

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
    """The posterior's mean and sd given a change (R,) V of the model's measured channels.

    starts (S, 3): standard normal numbers of the states from which searches for modes start; pairs:
    of draws, more where their effective size is below MIN_EFFECTIVE.
    """
    sample = Sample(model, delta_V)
    skin_start = np.zeros(sample.size - 3)
    modes = distinct_modes(
        [find_mode(sample, np.concatenate([start, skin_start])) for start in starts]
    )
    draws = draw(sample, modes, pairs, rng)
    for factor in PAIR_FACTORS:
        if draws.effective_size < MIN_EFFECTIVE:
            draws = draw(sample, modes, factor * pairs, rng)
    state = sample.state(draws.z)
    mean = draws.weight @ state
    return {
        "mean": mean,
        "sd": np.sqrt(draws.weight @ (state - mean) ** 2),
        "effective": draws.effective_size / len(draws.z),
        "modes": len(modes),
    }


def estimates(
    experiment: Experiment, dataset: Dataset, part: np.ndarray, seed: int, samples: int, pairs: int
) -> pd.DataFrame:
    """One row for each estimate and sample, of `samples` drawn from the test part: `estimate`,
    sample, session, the true x_mm, y_mm, force_N, their posterior `_mean` and `_sd`, `effective`
    and `modes`.
    """
    tested = np.flatnonzero(part == "test")
    rng = np.random.default_rng([seed, SEED])
    rows = np.sort(rng.choice(tested, min(samples, len(tested)), replace=False))
    prior_session = experiment.prior_session()
    starts = Starts(prior_session)
    session_model: tuple[int, SessionModel] | None = None
    estimate_rows = []
    for row in patient(rows, "samples"):
        truth, change = dataset.table.iloc[row], dataset.delta_V[row].astype(float)
        session = int(truth["session"])
        if session_model is None or session_model[0] != session:
            session_model = session, experiment.drawn_session(seed, session)
        for name, model in zip(ESTIMATES, (prior_session, session_model[1]), strict=True):
            sample_rng = np.random.default_rng([seed, SEED, int(truth["sample"])])
            posterior = estimate(model, change, starts.nearest(change), pairs, sample_rng)
            estimate_row = {"estimate": name, "sample": int(truth["sample"]), "session": session}
            for k, column in enumerate(TARGETS.values()):
                estimate_row[column] = truth[column]
                estimate_row[f"{column}_mean"] = posterior["mean"][k]
                estimate_row[f"{column}_sd"] = posterior["sd"][k]
            estimate_row |= {"effective": posterior["effective"], "modes": posterior["modes"]}
            estimate_rows.append(estimate_row)
    return pd.DataFrame(estimate_rows)
