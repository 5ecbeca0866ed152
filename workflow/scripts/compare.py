"""Compare two recordings of one skin: what they share and what changed between them."""

from eitskin.data import recording
from eitskin.diagnose.comparison import compare, result
from eitskin.diagnose.diagnosis import diagnose
from eitskin.errors import InputError, named, reported

with reported(snakemake.log[0]):
    files = {snakemake.wildcards[key]: snakemake.input[key] for key in ("a", "b")}
    if len(files) < 2:
        raise InputError("comparison", "recordings", f"{files} with itself", "two recordings")
    recordings = {name: recording.read(path) for name, path in files.items()}
    founds = {}
    for name, recorded in recordings.items():
        with named(files[name]):
            founds[name] = diagnose(recorded, snakemake.params.seed, progress=True)
    said = result.result(compare.compare(founds))
    result.write(result.with_difference(said, recordings), snakemake.output[0])
