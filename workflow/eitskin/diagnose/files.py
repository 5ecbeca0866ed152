"""The files of a diagnosis: diagnosis.json, effects.yaml, predicted.parquet, evidence."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from eitskin.atomic import atomic_path
from eitskin.data import parquet
from eitskin.diagnose.verdict import validation
from eitskin.diagnose.verdict.record import Record

SCHEMA = Path(__file__).with_name("diagnosis.schema.yaml")


def write(
    record: Record, folder: str | Path, schema: str | Path, query: str | Path | None = None
) -> None:
    """Write the record of a diagnosis into its folder, diagnosis.json last.

    schema: the file that says what diagnosis.json is; query: the file whose prediction the record
    has. Raises InputError where the document is no diagnosis by the schema.
    """
    folder = Path(folder)
    validation.validate(record.document, schema, folder / "diagnosis.json")
    (folder / "evidence").mkdir(parents=True, exist_ok=True)
    if query is not None and record.prediction is not None:
        _write_predicted(query, *record.prediction, folder / "predicted.parquet")
    _write_evidence(record, folder / "evidence")
    with atomic_path(folder / "effects.yaml") as path:
        path.write_text(record.simulator, "utf-8")
    with atomic_path(folder / "diagnosis.json") as path:
        text = json.dumps(record.document, indent=2, ensure_ascii=False, allow_nan=False)
        path.write_text(text + "\n", "utf-8")


def _write_predicted(query: str | Path, voltage: np.ndarray, sd: np.ndarray, target: Path) -> None:
    table = parquet.read(query)
    for key, values in (("voltage_V", voltage), ("std_V", sd)):
        if key in table.column_names:
            table = table.drop_columns(key)
        table = table.append_column(key, parquet.lists(values))
    with atomic_path(target) as path:
        pq.write_table(table, path)


def _write_evidence(record: Record, folder: Path) -> None:
    with atomic_path(folder / "residuals.npz") as path, path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **record.arrays)
    for key, table in record.tables.items():
        with atomic_path(folder / f"{key}.csv") as path:
            table.to_csv(path, index=False)
    with atomic_path(folder / "experiment.json") as path:
        path.write_text(json.dumps(record.experiment, ensure_ascii=False) + "\n", "utf-8")
