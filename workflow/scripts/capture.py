"""Capture with the rig that is attached, or go on where an earlier capture ended."""

import contextlib
import sys
from pathlib import Path

from eitskin.capture import record, session
from eitskin.capture.view import View
from eitskin.errors import reported

with reported(snakemake.log[0]):
    rig, journal = snakemake.params.rig, Path(snakemake.params.journal)
    mounted_mm = snakemake.params.mounted_mm
    try:
        with contextlib.closing(View()) as view:
            session.capture(rig, snakemake.params.file, journal, journal.exists(), mounted_mm, view)
    except session.Stopped as stopped:
        Path(snakemake.log[0]).write_text(f"{stopped}\n", encoding="utf-8")
        print(stopped, file=sys.stderr)
        sys.exit(stopped.code)
    record.write(journal, snakemake.output.recording, snakemake.output.manifest)
