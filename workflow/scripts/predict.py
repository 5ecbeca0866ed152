"""Apply a trained model to every frame of a recording."""

from eitskin.data import recording
from eitskin.learn import model_file, predict
from eitskin.provenance import recorded

with recorded(snakemake):
    model = model_file.read_seeds(snakemake.input.models)
    source = recording.read(snakemake.input.recording)
    predictions = predict.predict_recording(model, source, snakemake.wildcards.recording)
    predict.write(predictions, snakemake.output[0])
