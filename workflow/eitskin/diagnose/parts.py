"""A recording with steps in time, diagnosed in parts: between steps lies one state of skin and rig.

The diagnosis of the longest part is the recording's; those of the other parts stand beside it. What
a step changed is judged as between two recordings, without a model of the skin. A part of few
frames, which nothing could contradict, is left out: what changed is judged from the part before it
to the part after it.
"""

import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np

from eitskin.data import subset
from eitskin.data.check.steps import steps
from eitskin.data.check.usable import usable
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.compare.result import comparison
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB
from eitskin.diagnose.verdict.conclusion import PART_KEYS, document
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.words import frame_range
from eitskin.effects.effect import Setting
from eitskin.errors import InputError

FEWEST_FRAMES = 8  # of a part, beside the longest one
TOO_SHORT = "{} frames are fewer than the {} that a part needs to be diagnosed; they are left out."


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
    recording, unlabelled = usable(recording)
    first_rows = [step.frame for step in steps(recording)]
    if not first_rows:
        result = diagnosis.diagnose(recording, seed, progress, memory_GiB, earlier)
        return _with_unlabelled(result, unlabelled)
    rows = np.arange(len(recording.frames))
    bounds = pairwise([0, *first_rows, len(rows)])
    parts = [subset.of_frames(recording, (start <= rows) & (rows < end)) for start, end in bounds]
    longest, refusals = None, []
    entries: list[dict] = []
    for part in sorted(parts, key=lambda part: -len(part.frames)):
        frames = _frame_numbers(part)
        if _is_short(part, parts):
            reason = TOO_SHORT.format(len(part.frames), FEWEST_FRAMES)
            entries.append({"frames": frames, "refused": reason})
            continue
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
    changes = _changes(parts)
    stepped = replace(longest, parts=tuple(entries), steps=tuple(changes))
    return _with_unlabelled(stepped, unlabelled)


def _with_unlabelled(result: Diagnosis, unlabelled: list[tuple[int, int]]) -> Diagnosis:
    """A diagnosis with stretches of frames that were left out before it."""
    if not unlabelled:
        return result
    return replace(result, unlabelled=tuple(sorted({*unlabelled, *result.unlabelled})))


def _is_short(part: Recording, parts: list[Recording]) -> bool:
    """Whether a part has too few frames to be diagnosed: never the longest."""
    count = len(part.frames)
    return count < FEWEST_FRAMES and count < max(len(other.frames) for other in parts)


def _changes(parts: list[Recording]) -> list[dict]:
    """What each step changed, since the last part before it that is not left out; that nothing is
    told, of a step into a part that is, or without such a part before it."""
    changes: list[dict] = []
    control = None
    for k, part in enumerate(parts):
        is_short = _is_short(part, parts)
        if k and (is_short or control is None):
            short_part = part if is_short else parts[k - 1]
            frames_text = frame_range(_frame_numbers(short_part)).capitalize()
            text = f"{frames_text} are too few to tell a change."
            entry = {"frame": _frame_numbers(part)[0], "sentences": [text], "difference": {}}
            changes.append(entry)
        elif control is not None:
            changes.append(_change(control, part))
        control = control if is_short else part
    return changes


def _frame_numbers(part: Recording) -> list[int]:
    """The numbers of the first frame and of the last."""
    return [int(part.frames["frame"].iloc[row]) for row in (0, -1)]


def _change(control: Recording, later: Recording) -> dict:
    """What a step changed: its first frame, `sentences` and `difference` of comparison.json."""
    numbers = _frame_numbers(control), _frame_numbers(later)
    content = comparison(control, later, (frame_range(numbers[0]), frame_range(numbers[1])))
    return {"frame": numbers[1][0]} | {key: content[key] for key in ("sentences", "difference")}
