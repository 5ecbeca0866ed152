"""Capture with the attached rig, or continue an earlier capture."""

import sys
from pathlib import Path

from eitskin.capture.run import capture_recording
from eitskin.provenance import recorded

with recorded(snakemake):
    journal = Path(snakemake.params.journal)
    stopped = capture_recording(
        snakemake.params.rig,
        snakemake.params.file,
        journal,
        journal.exists(),
        snakemake.params.mounted_mm,
        (snakemake.output.recording, snakemake.output.manifest),
    )
    if stopped is not None:
        Path(snakemake.log[0]).write_text(f"{stopped}\n", encoding="utf-8")
        print(stopped, file=sys.stderr)
        sys.exit(stopped.code)
