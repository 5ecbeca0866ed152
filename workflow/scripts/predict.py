"""Apply a trained model to every frame of a recording."""

from eitskin.data import recording
from eitskin.errors import reported
from eitskin.learn import predict

with reported(snakemake.log[0]):
    source = recording.read(snakemake.input.recording)
    found = predict.predict_recording(snakemake.input.model, source, snakemake.wildcards.recording)
    predict.write(found, snakemake.output[0])
