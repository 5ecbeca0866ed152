"""A recording with steps in time, diagnosed apart: between steps lies one state of skin and rig.

What is found of the longest part is the recording's diagnosis, what is found of the others stands
beside it. What a step changed is found as between two recordings, without a model of the skin.
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
from eitskin.diagnose.diagnosis import Diagnosis
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB
from eitskin.diagnose.verdict.result import OF_A_PART, result
from eitskin.diagnose.verdict.words import stretch
from eitskin.effects.effect import Setting
from eitskin.errors import InputError


def diagnose(
    recorded: Recording,
    seed: int = 1,
    progress: bool = False,
    memory_GiB: float = LIMIT_GIB,
    earlier: list[Setting] | None = None,
) -> Diagnosis:
    """`diagnosis.diagnose` of a recording without steps; else of the longest part that can be
    diagnosed, which is the `told` one of `parts`, with `parts` and `steps` as of Diagnosis.

    Raises InputError as it does; where no part can be diagnosed, the longest one's.
    """
    begins = [step.frame for step in steps(recorded)]
    if not begins:
        return diagnosis.diagnose(recorded, seed, progress, memory_GiB, earlier)
    rows = np.arange(len(recorded.frames))
    ends = pairwise([0, *begins, len(rows)])
    parts = [subset.of_frames(recorded, (first <= rows) & (rows < end)) for first, end in ends]
    longest, refusals = None, []
    entries: list[dict] = []
    for part in sorted(parts, key=lambda part: -len(part.frames)):
        frames = _frames(part)
        if progress:
            print(f"  of {stretch(frames)}", file=sys.stderr, flush=True)
        try:
            found = diagnosis.diagnose(part, seed, progress, memory_GiB, earlier)
        except InputError as refusal:
            refusals.append(refusal)
            entries.append({"frames": frames, "refused": str(refusal)})
            continue
        if longest is None:
            longest = found
            entries.append({"frames": frames, "told": True})
            continue
        said = result(found, stretch(frames))
        entries.append({"frames": frames, **{key: said[key] for key in OF_A_PART}})
    if longest is None:
        raise refusals[0]
    entries.sort(key=lambda entry: entry["frames"])
    changes = [_change(before, after) for before, after in pairwise(parts)]
    return replace(longest, parts=tuple(entries), steps=tuple(changes))


def _frames(part: Recording) -> list[int]:
    """The numbers of the first frame and of the last."""
    return [int(part.frames["frame"].iloc[end]) for end in (0, -1)]


def _change(before: Recording, after: Recording) -> dict:
    """What a step changed: its first frame, sentences, and `difference` as of comparison.json."""
    names = stretch(_frames(before)), stretch(_frames(after))
    found = comparison(before, after, names)
    return {"frame": _frames(after)[0], **{key: found[key] for key in ("sentences", "difference")}}
