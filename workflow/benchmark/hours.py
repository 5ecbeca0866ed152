"""The processor time of a workflow's results, from Snakemake's benchmark files, as a Markdown
table: `python -m benchmark.hours [logs/benchmarks]`."""

import sys
from pathlib import Path

import pandas as pd

from eitskin.errors import InputError

FOLDER = Path("logs", "benchmarks")
TEACHERS = ("train_autoencoder", "train_regressor")
TEST_RULE = "evaluate"
MODEL_RULES = ("train_predictor", TEST_RULE, *TEACHERS)
COLUMNS = ["set", "split", "budget", "what", "jobs", "minutes"]


def costs(folder: Path) -> pd.DataFrame:
    """Rows (COLUMNS): processor minutes of the jobs with benchmark files in a folder, the latest
    run of each, 0 for one too short to be measured. One row for each model, set, split and budget
    and for their teachers, then one for every other rule. Raises InputError without files and for
    files of another form."""
    jobs = []
    for file in sorted(folder.rglob("*.tsv")):
        try:
            table = pd.read_csv(file, sep="\t", na_values=["NA", "-"])
        except (ValueError, pd.errors.ParserError) as error:
            raise InputError(
                file, "file", str(error), "what Snakemake's `benchmark` writes"
            ) from error
        if "cpu_time" not in table:
            raise InputError(file, "columns", list(table.columns), "cpu_time among them")
        rule, *names = file.relative_to(folder).with_suffix("").parts
        minutes = table["cpu_time"].sum() / 60.0
        if rule in MODEL_RULES and len(names) >= 4:
            dataset, split, budget, model = names[:4]
            model_or_rule = "teachers" if rule in TEACHERS else model
            jobs.append((dataset, split, budget, model_or_rule, int(rule != TEST_RULE), minutes))
        else:
            jobs.append(("", "", "", rule, 1, minutes))
    if not jobs:
        raise InputError(folder, "benchmark files", "none", "what a run of the workflow left")
    table = pd.DataFrame(jobs, columns=COLUMNS).groupby(COLUMNS[:4], as_index=False).sum()
    is_rule = table["set"] == ""
    return pd.concat([table[~is_rule], table[is_rule]], ignore_index=True)


def to_markdown(table: pd.DataFrame) -> str:
    """The rows of `costs`, and their sum in hours."""
    lines = [
        "| set | split | budget | what | trained or run | processor minutes |",
        "|---|---|---|---|---|---|",
    ]
    for row in table.itertuples(index=False):
        lines.append("| " + " | ".join(map(str, row[:5])) + f" | {row.minutes:.1f} |")
    lines += ["", f"Together {table['minutes'].sum() / 60.0:.2f} processor hours."]
    return "\n".join(lines)


def run(arguments: list[str]) -> int:
    """Run the command; returns its exit code."""
    if len(arguments) > 1 or arguments[:1] in (["-h"], ["--help"]):
        print("usage: python -m benchmark.hours [FOLDER]", file=sys.stderr)
        return 2
    try:
        print(to_markdown(costs(Path(arguments[0]) if arguments else FOLDER)))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
