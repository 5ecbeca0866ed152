"""Describe a recording and its shortcomings in plain words; stop where it is unusable."""

from eitskin.data import check, recording
from eitskin.provenance import recorded

with recorded(snakemake):
    result = check.check(recording.read(snakemake.input[0]))
    check.write(result, snakemake.output[0], snakemake.input[0])
