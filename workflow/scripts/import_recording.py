"""Import a recording from any source into the recording format."""

from eitskin.data import importers, recording, stated, subset
from eitskin.provenance import recorded

with recorded(snakemake):
    imported = importers.load(snakemake.input[0], **snakemake.params.read_as)
    described = stated.apply(snakemake.params.skin or {}, imported, "recordings, skin")
    if snakemake.params.frames is not None:
        described = subset.stretch(described, *snakemake.params.frames, snakemake.input[0])
    recording.write(described, snakemake.output[0])
