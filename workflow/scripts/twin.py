"""Simulate the twin of a real skin."""

from eitskin.errors import reported
from eitskin.simulate import twin

with reported(snakemake.log[0]):
    twin.write(snakemake.output[0], twin.Twin(**snakemake.params.twin))
