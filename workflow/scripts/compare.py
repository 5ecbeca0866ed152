"""Compare two recordings of one skin: what changed between them."""

from eitskin.data import recording
from eitskin.diagnose.compare import result
from eitskin.errors import InputError
from eitskin.provenance import recorded

with recorded(snakemake):
    names = snakemake.wildcards.a, snakemake.wildcards.b
    if names[0] == names[1]:
        raise InputError("comparison", "recordings", f"{names[0]} twice", "two recordings")
    control, later = (recording.read(path) for path in (snakemake.input.a, snakemake.input.b))
    result.write(result.comparison(control, later, names), snakemake.output[0])
