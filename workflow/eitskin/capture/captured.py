"""A capture in front of a person, and what becomes of its journal."""

import contextlib
from pathlib import Path

from eitskin.capture import record, session
from eitskin.capture.view import View


def capture_recording(
    config: dict,
    file: str | Path,
    journal: str | Path,
    resume: bool,
    mounted_mm: float | None,
    out: tuple[str | Path, str | Path],
) -> session.Stopped | None:
    """Capture as `session.capture` does, seen on stderr, and write the recording and its manifest,
    the two of `out`. Where the capture ended early neither is written, and why it did is returned.

    Raises InputError as `session.capture` and `record.write` do.
    """
    try:
        with contextlib.closing(View()) as view:
            session.capture(config, file, journal, resume, mounted_mm, view)
    except session.Stopped as stopped:
        return stopped
    record.write(journal, *out)
    return None
