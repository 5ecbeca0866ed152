"""Simulate the twin of a real skin."""

from eitskin import twin
from eitskin.errors import reported

with reported(snakemake.log[0]):
    twin.write(snakemake.output[0], **snakemake.params.twin)
