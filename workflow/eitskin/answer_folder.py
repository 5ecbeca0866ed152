"""The folder of an answer: the recording, the files of its diagnosis and the report."""

from pathlib import Path

from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.diagnose import files
from eitskin.diagnose.report import evidence, page
from eitskin.diagnose.verdict.record import Record


def forget(folder: Path) -> None:
    """Remove the answer of an earlier run: a refused or interrupted run has none."""
    for path in (report(folder), folder / "diagnosis.json", folder / "predicted.parquet"):
        path.unlink(missing_ok=True)


def begin(folder: Path, recorded: Recording) -> None:
    """Write the recording, and remove what an earlier run wrote: beside a new recording lies
    nothing of another one."""
    forget(folder)
    for path in (*evidence.file_paths(folder), *page.figure_paths(report(folder))):
        path.unlink(missing_ok=True)
    recording.write(recorded, folder / "recording.parquet")


def finish(folder: Path, record: Record, query: str | Path | None = None) -> Path:
    """Write the diagnosis of the recording in a folder and the report, whose path is returned;
    query: the file of the states that the record predicts."""
    files.write(record, folder, files.SCHEMA, query)
    source = folder / "recording.parquet"
    predicted = None if query is None else folder / "predicted.parquet"
    page.write(folder, source, files.SCHEMA, report(folder), predicted)
    return report(folder)


def report(folder: Path) -> Path:
    """The path of the report."""
    return folder / "report.html"
