"""What an owner keeps to himself of a recording of `witness.owned`, and what the check says of the
rest.
"""

from zlib import crc32

import numpy as np

from calibration.asked import Asked, without_channels
from eitskin.data.check import WARNING, Check, clipping, measures, steps
from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.held_out import units
from witness.owned import Owned


def asked_of(owner: Owned) -> Asked:
    """A recording and a query of readings that it does not hold: of presses after it, or where
    nobody touches, of channels kept out of all its frames."""
    if owner.query is not None:
        there = owner.query.readings
        query = Recording(owner.query.frames, None, None, None, owner.query.metadata)
        said, recorded = "later presses", owner.recorded
    else:
        rng = np.random.default_rng([crc32(f"{owner.kind}, kept out".encode()), owner.seed])
        said, recorded, query, there = without_channels(owner.recorded, rng)
    drawn = f"{owner.drawn}; {said}"
    return Asked(owner.kind, owner.seed, drawn, recorded, query, there, units(query))


def said_by_check(recorded: Recording, checked: Check) -> dict:
    """The first frames after steps and the ceilings, V, that the check's sentences hold, and its
    warnings, (topic, sentence)."""
    warned = checked.of_severity(WARNING)
    topics = {one.topic for one in warned}
    ceilings = []
    if "clipped" in topics:
        stop = measures.clipped_channels(recorded)
        assert stop is not None  # else there is no warning
        ceilings = [one.ceiling for one in clipping.ceilings(recorded)]
        ceilings = [stop.ceiling] if len(stop.channels) else ceilings
    return {
        "steps": [step.frame for step in steps.steps(recorded)] if "step" in topics else [],
        "ceilings": ceilings,
        "warnings": [(one.topic, one.sentence) for one in warned],
    }
