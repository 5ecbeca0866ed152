"""Say in plain words what a recording holds and what it cannot tell."""

from pathlib import Path

from eitskin import check, recording
from eitskin.errors import reported

with reported(snakemake.log[0]):
    result = check.check(recording.read(snakemake.input[0]))
    Path(snakemake.output[0]).write_text(check.text(result), encoding="utf-8")
