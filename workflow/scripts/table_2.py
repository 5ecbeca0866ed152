"""Compare untouched frames, simulated and recorded: Table II."""

import sys
from pathlib import Path

import numpy as np

from eitskin.paper import table_2
from eitskin.provenance import recorded
from eitskin.simulate.untouched_frames import Plan

with recorded(snakemake):
    files, tables, params = snakemake.input, snakemake.output, snakemake.params
    with np.load(files.mesh) as mesh:
        force_N = mesh["force_N"]
    size = params.size
    plan = Plan(size["sessions"], size["frames"], force_N, params.accuracy, params.seed)
    design = table_2.Design(params.skin, plan, size["permutations"])
    left_out = table_2.write(
        dict(zip(params.names, files.recordings, strict=True)),
        params.configurations,
        design,
        files.paper,
        tables.csv,
        tables.markdown,
    )
    Path(snakemake.log[0]).write_text("\n".join(left_out), encoding="utf-8")
    for line in left_out:
        print(line, file=sys.stderr)
