"""A predictor as one file that needs no torch."""

from eitskin.data import dataset, recording, splits
from eitskin.errors import reported
from eitskin.exported import file
from eitskin.learn import export, model_file

with reported(snakemake.log[0]):
    files, params = snakemake.input, snakemake.params
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    told = recording.read(files.recording).metadata if files.recording else params
    about = told["skin"], told["frame_s"], params.epochs
    model = model_file.read_seeds(files.models)
    file.write(export.export(model, data, part, *about), snakemake.output[0])
