"""Collect what the choices in training are worth."""

import json
from pathlib import Path

import pandas as pd

from eitskin.errors import reported
from eitskin.paper import ablation

with reported(snakemake.log[0]):
    files, params, tables = snakemake.input, snakemake.params, snakemake.output
    varied, compared, budget = [], [], {"budget": params.budget}
    for about, errors in zip(params.varied, files.varied, strict=True):
        varied += ablation.varied_rows(pd.read_csv(errors), about | budget)
    errors = zip(files.plain, files.informed, strict=True)
    chosen = zip(files.plain_setting, files.informed_setting, strict=True)
    for about, pair, told in zip(params.compared, errors, chosen, strict=True):
        plain, informed = (json.loads(Path(file).read_text("utf-8"))["told"] for file in told)
        about = about | budget | {"plain_setting": plain, "informed_setting": informed}
        compared += ablation.compared_rows(*map(pd.read_csv, pair), about)
    ablation.write(varied, compared, tables.varied, tables.compared, tables.markdown)
