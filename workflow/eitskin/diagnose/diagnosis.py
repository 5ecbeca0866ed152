"""A recording diagnosed, from noise and calibration to search and remainder."""

import sys
from collections.abc import Callable
from dataclasses import replace

from threadpoolctl import threadpool_limits

from eitskin.data.averages import averages
from eitskin.data.check.unlabelled import stretch_text
from eitskin.data.check.usable import usable
from eitskin.data.recording import Recording, voltages
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB, excerpt
from eitskin.diagnose.fitting.held_out import error_units
from eitskin.diagnose.fitting.memory import frame_limit
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.pruning import pruned
from eitskin.diagnose.search.staging import FewerFrames, prepared, searched
from eitskin.diagnose.verdict.diagnosis import Data, Diagnosis, assess
from eitskin.effects.effect import Setting
from eitskin.physics import outline


def diagnose(
    recording: Recording,
    seed: int = 1,
    progress: bool = False,
    memory_GiB: float = LIMIT_GIB,
    earlier: list[Setting] | None = None,
    opened: frozenset[tuple[str, str]] = frozenset(),
) -> Diagnosis:
    """Diagnose a recording: locate, name and model what its simulation leaves out.

    What the check leaves out is left out (`usable`): frames in which somebody touched though no
    label tells, copies, frames whose load cell lost its signal, numbers that are no readings. Of a
    long recording, an excerpt, as long as memory_GiB are expected to allow, or families of what is
    a little wrong at every site; for these, averages of frames where nobody touches. A search on a
    few frames is where that on all begins, or the effects of an earlier diagnosis where these
    explain it: each has to be borne out. opened: pairs
    of a gate's and an effect's name, for which the gate lets everything pass. Equal arguments give
    equal results, bit for bit. Raises InputError where nothing can be simulated, and where it
    would take more memory.
    """
    # Shared out among cores, small products take longer, and their sums are of other bytes.
    with threadpool_limits(1, user_api="blas"):
        return _diagnosed(recording, seed, progress, memory_GiB, earlier, Journal(opened))


def _diagnosed(
    recording: Recording,
    seed: int,
    progress: bool,
    memory_GiB: float,
    earlier: list[Setting] | None,
    journal: Journal,
) -> Diagnosis:
    voltages(recording, "recording")
    outline.refuse(recording.skin, "recording")

    def report(line: str) -> None:
        if progress:
            print(f"  {line}", file=sys.stderr, flush=True)

    recording, unlabelled = usable(recording)
    for frames in unlabelled:
        report(f"a touch without a label in {stretch_text(frames)}, left out")
    part = _excerpt(recording, frame_limit(recording, memory_GiB), report)
    try:
        diagnosis = _searched(part, seed, report, earlier, journal)
    except FewerFrames as fewer:
        frames_each = len(part.frames) / fewer.frames if fewer.are_averages else 1.0
        if fewer.are_averages:
            report(f"averages of the frames, {fewer.frames}")
            part = averages(part, fewer.frames)
        else:
            part = _excerpt(part, fewer.frames, report)
        diagnosis = _searched(part, seed, report, earlier, Journal(journal.opened))
        diagnosis = replace(diagnosis, frames_each=frames_each)
    return replace(diagnosis, unlabelled=tuple(unlabelled))


def _excerpt(recording: Recording, limit: int, report: Callable[[str], None]) -> Recording:
    """A recording, or where it has more frames than the limit an excerpt of no more."""
    part, wanted = recording, limit
    while len(part.frames) > limit:
        part = excerpt(recording, wanted)
        wanted -= 1
    if part is not recording:
        report(f"an excerpt: {len(part.frames)} of {len(recording.frames)} frames")
    return part


def _searched(
    recording: Recording,
    seed: int,
    report: Callable[[str], None],
    earlier: list[Setting] | None,
    journal: Journal,
) -> Diagnosis:
    """The diagnosis of all frames of a recording. Raises FewerFrames where an excerpt or averages
    are to be diagnosed in its place."""
    noise, search, reserve_mask = prepared(recording, seed, report, journal)
    outcome, was_cut_short = searched(recording, search, seed, earlier)
    outcome = pruned(outcome, error_units(recording), noise.dof)
    problem = replace(search.problem, model=outcome[0].problem.model)
    return assess(Data(recording, noise, reserve_mask, problem), outcome, was_cut_short)
