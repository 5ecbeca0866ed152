"""Score an opened block."""

from pathlib import Path

from eitskin.errors import reported
from proof import page

with reported(snakemake.log[0]):
    block = snakemake.wildcards.block
    command = f"snakemake --cores 2 results/concealed/{block}/score/score.md"
    page.write(Path(snakemake.input.opened).parent, Path(snakemake.output.page).parent, command)
