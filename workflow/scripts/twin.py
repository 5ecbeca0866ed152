"""Simulate the twin of a real skin."""

from eitskin.provenance import recorded
from eitskin.simulate import twin

with recorded(snakemake):
    twin.write(snakemake.output[0], twin.Twin(**snakemake.params.twin))
