"""Describe a recording and its shortcomings in plain words; stop where it is unusable."""

from eitskin.data import check, recording
from eitskin.errors import reported

with reported(snakemake.log[0]):
    result = check.check(recording.read(snakemake.input[0]))
    check.write(result, snakemake.output[0], snakemake.input[0])
