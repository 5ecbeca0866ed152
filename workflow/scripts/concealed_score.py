"""Score an opened block."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import page

with recorded(snakemake):
    block = snakemake.wildcards.block
    command = f"snakemake --cores 2 results/concealed/{block}/score/score.md"
    page.write(Path(snakemake.input.opened).parent, Path(snakemake.output.page).parent, command)
