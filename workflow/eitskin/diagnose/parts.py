"""A recording with steps in time, diagnosed in parts: between steps lies one state of skin and rig.

The diagnosis of the longest part is the recording's; those of the other parts stand beside it. What
a step changed is judged as between two recordings, without a model of the skin.
"""

import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np

from eitskin.data import subset
from eitskin.data.check.steps import steps
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.compare.result import comparison
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB
from eitskin.diagnose.verdict.conclusion import PART_KEYS, document
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.words import frame_range
from eitskin.effects.effect import Setting
from eitskin.errors import InputError


def diagnose(
    recording: Recording,
    seed: int = 1,
    progress: bool = False,
    memory_GiB: float = LIMIT_GIB,
    earlier: list[Setting] | None = None,
) -> Diagnosis:
    """`diagnosis.diagnose` of a recording without steps; else of the longest part that can be
    diagnosed, which has the key `told` in `parts`, with `parts` and `steps` of Diagnosis.

    Raises InputError as `diagnosis.diagnose` does; where no part can be diagnosed, that of the
    longest.
    """
    first_rows = [step.frame for step in steps(recording)]
    if not first_rows:
        return diagnosis.diagnose(recording, seed, progress, memory_GiB, earlier)
    rows = np.arange(len(recording.frames))
    bounds = pairwise([0, *first_rows, len(rows)])
    parts = [subset.of_frames(recording, (start <= rows) & (rows < end)) for start, end in bounds]
    longest, refusals = None, []
    entries: list[dict] = []
    for part in sorted(parts, key=lambda part: -len(part.frames)):
        frames = _frame_numbers(part)
        if progress:
            print(f"  of {frame_range(frames)}", file=sys.stderr, flush=True)
        try:
            part_diagnosis = diagnosis.diagnose(part, seed, progress, memory_GiB, earlier)
        except InputError as refusal:
            refusals.append(refusal)
            entries.append({"frames": frames, "refused": str(refusal)})
            continue
        if longest is None:
            longest = part_diagnosis
            entries.append({"frames": frames, "told": True})
            continue
        content = document(part_diagnosis, frame_range(frames))
        entries.append({"frames": frames, **{key: content[key] for key in PART_KEYS}})
    if longest is None:
        raise refusals[0]
    entries.sort(key=lambda entry: entry["frames"])
    changes = [_change(*pair) for pair in pairwise(parts)]
    return replace(longest, parts=tuple(entries), steps=tuple(changes))


def _frame_numbers(part: Recording) -> list[int]:
    """The numbers of the first frame and of the last."""
    return [int(part.frames["frame"].iloc[row]) for row in (0, -1)]


def _change(control: Recording, later: Recording) -> dict:
    """What a step changed: its first frame, `sentences` and `difference` of comparison.json."""
    numbers = _frame_numbers(control), _frame_numbers(later)
    content = comparison(control, later, (frame_range(numbers[0]), frame_range(numbers[1])))
    return {"frame": numbers[1][0]} | {key: content[key] for key in ("sentences", "difference")}
