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
    """force_N (N,) at `places` (N, 2) or a finger's; a frame each frame_s; gain (N,) of all
    readings since the opening; palm: what makes the gain touches the skin; least: the share that is
    judged right."""

    force_N: np.ndarray
    frame_s: float = 0.05
    gain: np.ndarray | float = 1.0
    places: np.ndarray | tuple = FINGER
    palm: bool = False
    least: float = 0.0


def _ramp(rate: float) -> Case:
    pressing = np.linspace(0.0, HELD_N, FRAMES // 2)
    held = np.full(FRAMES // 4, HELD_N)
    force = np.concatenate([pressing, held, np.zeros(FRAMES // 4)])
    return Case(force, HELD_N / rate / len(pressing), least=0.6)


def _drift(force_N: float) -> Case:
    force = np.full(FRAMES, force_N)
    return Case(force, 1.0, 1.0 + 0.01 / 60.0 * np.arange(1.0, FRAMES + 1.0), least=0.85)


def _forces(force_N: float, least: float = 0.0) -> Case:
    places = skin.touches(FRAMES, np.random.default_rng(8))[:, :2]
    return Case(np.full(FRAMES, force_N), places=places, least=least)


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


def told(predictor: Predictor, case: Case) -> dict[str, float]:
    """Shares of frames: right, cannot tell, wrong."""
    draw, judge = np.random.default_rng(4), Judge(predictor)
    for number, reading in enumerate(skin.readings(np.zeros((10, 3)), draw)):
        judge(reading, 0.05 * number)
    x, y = np.broadcast_to(case.places, (len(case.force_N), 2)).T
    voltage = skin.readings(np.column_stack([x, y, case.force_N]), draw)
    voltage = voltage * np.broadcast_to(case.gain, len(voltage))[:, None]
    right = unsure = 0
    for number, (reading, force) in enumerate(zip(voltage, case.force_N, strict=True)):
        verdict = judge(reading, 0.5 + case.frame_s * number)
        if verdict.kind == CANNOT_TELL:
            unsure += 1
        elif verdict.kind == NO_TOUCH:
            right += force == 0.0 and not case.palm
        elif verdict.kind == TOUCH and force > 0.0:
            right += abs(verdict.estimate.state[2] - force) <= verdict.estimate.half[2]
    count = len(voltage)
    wrong = count - right - unsure
    return {"right": right / count, CANNOT_TELL: unsure / count, "wrong": wrong / count}


def main() -> None:
    """Print the table as CSV."""
    predictor = Predictor(skin.exported())
    rows = {name: told(predictor, case) for name, case in CASES.items()}
    pd.DataFrame(rows).T.to_csv(sys.stdout, float_format="%.2f")


if __name__ == "__main__":
    main()
