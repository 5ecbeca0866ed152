"""Simulate the sessions of a configuration, a new skin for each."""

from eitskin.provenance import recorded
from eitskin.simulate import sets

with recorded(snakemake):
    blocks = ("seed", "skin", "accuracy", "effects", "session_frames", "crossed", "continuous")
    sets.write_skin_stage(
        snakemake.input.mesh,
        snakemake.input.touch_grid,
        snakemake.output[0],
        sets.SkinStage(**{block: snakemake.params[block] for block in blocks}),
    )
