"""What `eitskin stream` says of an emulated skin that is pressed slowly, too hard, by a palm, or
that drifts: `PYTHONPATH=workflow:tests python -m streamed_verdicts` prints the share of frames.

Right: no touch where nothing touches; a touch whose force lies in its interval where there is one,
which calibrated intervals miss one time in ten. A palm is right as nothing but "cannot tell".
"""

import sys
from dataclasses import dataclass

import numpy as np
import pandas as pd

import streamed_skin as skin
from eitskin.exported.predictor import Predictor
from eitskin.quantities import percent
from eitskin.stream.judge import CANNOT_TELL, NO_TOUCH, TOUCH, Judge

FRAMES = 300
FINGER = (20.0, -10.0)  # mm
HELD_N = 6.0
MOST_WRONG = 0.2  # twice what the intervals miss


@dataclass(frozen=True)
class Case:
    """A sequence of N frames, one each `frame_s`, and the share that must be judged right.

    `force_N` (N,) acts at `places` (N, 2), by default at FINGER; `gain` (N,) multiplies all
    readings since the opening; with `palm` a hand causes that gain.
    """

    force_N: np.ndarray
    frame_s: float = 0.05
    gain: np.ndarray | float = 1.0
    places: np.ndarray | tuple = FINGER
    palm: bool = False
    least_right_share: float = 0.0


def _ramp(rate: float) -> Case:
    pressing = np.linspace(0.0, HELD_N, FRAMES // 2)
    hold = np.full(FRAMES // 4, HELD_N)
    force = np.concatenate([pressing, hold, np.zeros(FRAMES // 4)])
    return Case(force, HELD_N / rate / len(pressing), least_right_share=0.6)


def _drift(force_N: float) -> Case:
    force = np.full(FRAMES, force_N)
    return Case(
        force, 1.0, 1.0 + 0.01 / 60.0 * np.arange(1.0, FRAMES + 1.0), least_right_share=0.85
    )


def _forces(force_N: float, least_right_share: float = 0.0) -> Case:
    places = skin.touches(FRAMES, np.random.default_rng(8))[:, :2]
    return Case(np.full(FRAMES, force_N), places=places, least_right_share=least_right_share)


CASES = {
    **{f"to 6 N at {rate:g} N/s, held, let go": _ramp(rate) for rate in (0.02, 0.1, 0.2, 1.0)},
    **{
        f"a palm: all readings less by {percent(share)}": Case(
            np.zeros(FRAMES // 6), gain=1.0 - share, palm=True
        )
        for share in (0.01, 0.05, 0.1)
    },
    "conductivity, 1 % a minute for 5 minutes": _drift(0.0),
    "the same during a touch of 6 N": _drift(HELD_N),
    **{f"{force:g} N, trained to 10 N": _forces(force, 0.7) for force in (5.0, 8.0)},
    **{f"{force:g} N, trained to 10 N": _forces(force) for force in (11.0, 12.0, 15.0, 20.0)},
}


def verdict_shares(predictor: Predictor, case: Case) -> dict[str, float]:
    """Shares of frames: right, cannot tell, wrong."""
    rng, judge = np.random.default_rng(4), Judge(predictor)
    for number, reading in enumerate(skin.readings(np.zeros((10, 3)), rng)):
        judge(reading, 0.05 * number)
    x, y = np.broadcast_to(case.places, (len(case.force_N), 2)).T
    voltage = skin.readings(np.column_stack([x, y, case.force_N]), rng)
    voltage = voltage * np.broadcast_to(case.gain, len(voltage))[:, None]
    n_right = n_unsure = 0
    for number, (reading, force) in enumerate(zip(voltage, case.force_N, strict=True)):
        verdict = judge(reading, 0.5 + case.frame_s * number)
        if verdict.kind == CANNOT_TELL:
            n_unsure += 1
        elif verdict.kind == NO_TOUCH:
            n_right += force == 0.0 and not case.palm
        elif verdict.kind == TOUCH and force > 0.0:
            n_right += abs(verdict.estimate.state[2] - force) <= verdict.estimate.half[2]
    count = len(voltage)
    n_wrong = count - n_right - n_unsure
    return {"right": n_right / count, CANNOT_TELL: n_unsure / count, "wrong": n_wrong / count}


def main() -> None:
    """Print the table as CSV."""
    predictor = Predictor(skin.exported())
    rows = {name: verdict_shares(predictor, case) for name, case in CASES.items()}
    pd.DataFrame(rows).T.to_csv(sys.stdout, float_format="%.2f")


if __name__ == "__main__":
    main()
