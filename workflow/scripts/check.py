"""Say in plain words what a recording holds and what it cannot tell."""

from eitskin import check
from eitskin.errors import reported

with reported(snakemake.log[0]):
    check.write(snakemake.input[0], snakemake.output[0])
