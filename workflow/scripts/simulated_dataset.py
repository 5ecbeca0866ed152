"""Add noise to the last stage of a chain and subtract the untouched frames."""

from eitskin.provenance import recorded
from eitskin.simulate import sets

with recorded(snakemake):
    sets.write_dataset(
        snakemake.input[0],
        snakemake.output[0],
        configuration=snakemake.wildcards.configuration,
        **{block: snakemake.params[block] for block in ("seed", "noise", "baseline")},
    )
