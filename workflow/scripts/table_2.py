"""Compare untouched frames, simulated and recorded: Table II."""

import sys
from pathlib import Path

from eitskin.errors import reported
from eitskin.paper import table_2

with reported(snakemake.log[0]):
    files, tables = snakemake.input, snakemake.output
    left_out = table_2.write(
        dict(zip(snakemake.params.names, files.recordings, strict=True)),
        files.mesh,
        files.paper,
        tables.csv,
        tables.markdown,
        snakemake.params.skin,
        snakemake.params.configurations,
        snakemake.params.accuracy,
        snakemake.params.seed,
        **snakemake.params.size,
    )
    Path(snakemake.log[0]).write_text("\n".join(left_out), encoding="utf-8")
    for line in left_out:
        print(line, file=sys.stderr)
