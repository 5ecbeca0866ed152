"""A capture shown to a person, whose journal becomes a recording and its manifest."""

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
    output_paths: tuple[str | Path, str | Path],
) -> session.Stopped | None:
    """Capture with progress on stderr, then write recording and manifest to `output_paths`.

    Returns the reason where the capture ended early; then nothing is written. Raises InputError as
    `session.capture` and `record.write` do.
    """
    try:
        with contextlib.closing(View()) as view:
            session.capture(config, file, journal, resume, mounted_mm, view)
    except session.Stopped as stopped:
        return stopped
    record.write(journal, *output_paths)
    return None
