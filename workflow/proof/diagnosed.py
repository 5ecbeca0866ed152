"""What the diagnosis says of recordings, a row each, beside what is left of readings put aside."""

import numpy as np

from eitskin.data.recording import Recording
from eitskin.diagnose.verdict.words import is_certain, last_scores


def row(diagnosis: dict, recorded: Recording) -> dict:
    """A row of a diagnosis.json and its recording: verdict, names, candidates among them with a
    question mark, what they cannot be told from, and the rms misfit before and after on readings
    that were put aside, over the rms reading."""
    size = float(np.sqrt(np.nanmean(recorded.readings**2)))
    last, effects = last_scores(diagnosis), diagnosis["effects"]
    return {
        "recording": diagnosis["recording"],
        "verdict": diagnosis["verdict"],
        "said": "; ".join(e["name"] + ("" if is_certain(e) else "?") for e in effects),
        "alternatives": "; ".join(", ".join(e["alternatives"]) or "none" for e in effects),
        "before": last["rms_before_V"] / size,
        "after": last["rms_after_V"] / size,
    }
