"""Draw a batch of a block's cases: recordings and queries in the open, truths under lock."""

import json
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.provenance import recorded
from proof import conceal

with recorded(snakemake):
    block = conceal.Block(
        snakemake.params.block,
        conceal.Sizes(**snakemake.params.sizes),
        snakemake.params.seed,
        Path(snakemake.output.recordings[0]).parents[1],
        Path(snakemake.output.truths[0]).parent,
        snakemake.params.code,
    )
    commitments = conceal.conceal(block, snakemake.params.cases)
    with atomic_path(snakemake.output.commitments) as path:
        path.write_text(json.dumps(commitments, indent=1, sort_keys=True) + "\n", "utf-8")
