"""Add noise to the last stage of a chain and subtract the untouched frames."""

from eitskin import simulate
from eitskin.errors import reported

with reported(snakemake.log[0]):
    simulate.write_dataset(
        snakemake.input[0],
        snakemake.output[0],
        configuration=snakemake.wildcards.configuration,
        **{block: snakemake.params[block] for block in ("seed", "noise", "baseline")},
    )
