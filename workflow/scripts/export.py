"""A predictor as one file that needs no torch."""

from eitskin.data import baseline, dataset, recording, splits
from eitskin.errors import reported
from eitskin.exported import file
from eitskin.learn import export, model_file

with reported(snakemake.log[0]):
    files, params = snakemake.input, snakemake.params
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    recorded = recording.read(files.recording) if files.recording else None
    told = recorded.metadata if recorded else params
    level = baseline.level(recorded, data.metadata["lost_channels"]) if recorded else None
    about = told["skin"], told["frame_s"], params.epochs, level
    model = model_file.read_seeds(files.models)
    file.write(export.export(model, data, part, *about), snakemake.output[0])
