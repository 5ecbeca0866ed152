"""Ablation of the paper's choices: each varied alone, and physics-informed against plain training
at several sizes, both tuned in the same grid.

A setting holds the differences from a model's recipe and from the budget's `samples`.
"""

from collections.abc import Iterable
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.learn.metrics import interval_of_seeds, summary, unit

DEFAULT = "default"
PLAIN, INFORMED = PAIR = "mlp", "physics-informed-mlp"  # the compared models
WITH_OWN_TEACHERS = ("latent_dim", "samples")  # on which an autoencoder and a regressor depend
VARIED = (
    *("study", "value", "dataset", "split", "model", "target", "metric", "mean", "low", "high"),
    *("each", "unit", "seeds", "budget"),
)
COMPARED = (
    *("dataset", "split", "widths", "target", "metric", "unit", "plain", "informed"),
    *("difference", "low", "high", "seeds", "budget"),
    *("plain_setting", "informed_setting", "verdict"),
)
SHOWN = {"r2": "R²", "mae": "MAE"}


def settings(default: dict, varied: dict[str, list]) -> dict[str, dict]:
    """Settings by name: `default`, and `<key>-<value>` for every value of `varied` that differs
    from the default's."""
    return {DEFAULT: {}} | {
        _setting_name(key, value): {key: value}
        for key, values in varied.items()
        for value in values
        if value != default[key]
    }


def grid(axes: dict[str, list], widths: list[int]) -> dict[str, dict]:
    """Settings by name, one for each combination of the values of `axes`, for networks of these
    hidden widths."""
    points = [
        dict(zip(sorted(axes), point, strict=True))
        for point in product(*(axes[key] for key in sorted(axes)))
    ]
    return {
        "-".join(["grid", size(widths), *(f"{value:g}" for value in point.values())]): {
            **point,
            "widths": widths,
        }
        for point in points
    }


def size(widths: list[int]) -> str:
    """Hidden widths as a name."""
    return "x".join(map(str, widths))


def studies(default: dict, varied: dict[str, list]) -> list[tuple]:
    """Key, value and name of the setting of every value of `varied`, in order."""
    return [
        (key, value, DEFAULT if value == default[key] else _setting_name(key, value))
        for key, values in varied.items()
        for value in values
    ]


def has_own_teachers(setting: str) -> bool:
    """Whether a setting's autoencoder and regressor differ from the default's."""
    return setting.startswith(tuple(f"{key}-" for key in WITH_OWN_TEACHERS))


def _setting_name(key: str, value: float | None) -> str:
    return f"{key}-{_value_text(value)}"


def _value_text(value: float | None) -> str:
    return "all" if value is None else f"{value:g}"


def score(rows: pd.DataFrame) -> float:
    """The criterion of a setting, to be minimised: the geometric mean over targets of the mean
    absolute error, averaged over seeds, so that equal relative changes of any target's error count
    the same. rows: of `metrics.by_seed`."""
    errors = rows[rows["metric"] == "mae"].groupby("target")["value"].mean()
    return float(np.exp(np.log(errors).mean()))


def best(scores: dict[str, pd.DataFrame]) -> str:
    """The setting with the lowest `score`; the first of equal ones.

    `scores`: by setting, the rows of `metrics.by_seed` on the validation part.
    """
    return min(scores, key=lambda name: score(scores[name]))


def in_words(setting: dict, axes: Iterable[str]) -> str:
    """A setting in words: its values on the axes of a grid."""
    return ", ".join(f"{key.replace('_', ' ')} {setting[key]:g}" for key in axes)


def varied_rows(rows: pd.DataFrame, setting_columns: dict) -> list[dict]:
    """Rows (VARIED) from those of `metrics.by_seed` of one setting: `metrics.summary` of its seeds,
    with `setting_columns` study, value, dataset, split and budget."""
    table_rows = []
    for (target, metric), seed_rows in rows.groupby(["target", "metric"], sort=False):
        statistics = summary(seed_rows["value"].to_numpy(), metric)
        target_columns = {"target": target, "metric": metric, "unit": unit(metric, target)}
        table_rows.append(
            {
                **setting_columns,
                "model": INFORMED,
                "value": _value_text(setting_columns["value"]),
                **target_columns,
                **statistics,
            }
        )
    return table_rows


def compared_rows(plain: pd.DataFrame, informed: pd.DataFrame, setting_columns: dict) -> list[dict]:
    """Rows (COMPARED): informed minus plain, paired by seed, with a 95 % t interval of the mean.

    `plain`, `informed`: rows of `metrics.by_seed` on one test part, with the same seeds;
    `setting_columns`: dataset, split, budget, widths, plain_setting and informed_setting.
    """
    keys = ["target", "metric", "seed"]
    pairs = plain.merge(informed, on=keys, suffixes=("_plain", "_informed"), validate="1:1")
    if not len(pairs) == len(plain) == len(informed):
        raise ValueError("plain and informed differ in their seeds, targets or metrics")
    table_rows = []
    for (target, metric), pair_rows in pairs.groupby(["target", "metric"], sort=False):
        difference = (pair_rows["value_informed"] - pair_rows["value_plain"]).to_numpy()
        low, high = interval_of_seeds(difference)
        table_rows.append(
            {
                **setting_columns,
                "target": target,
                "metric": metric,
                "unit": unit(metric, target),
                "plain": pair_rows["value_plain"].mean(),
                "informed": pair_rows["value_informed"].mean(),
                "difference": difference.mean(),
                "low": low,
                "high": high,
                "seeds": len(pair_rows),
                "verdict": verdict(metric, low, high, len(pair_rows)),
            }
        )
    return table_rows


def verdict(metric: str, low: float, high: float, seeds: int) -> str:
    """The effect of the latent loss in words, from an interval of differences."""
    if not np.isfinite([low, high]).all():
        return f"cannot be told from {seeds} seed{'s' * (seeds > 1)}"
    if low <= 0 <= high:
        return f"no difference that {seeds} seeds can tell"
    return "helps" if (low > 0) == (metric == "r2") else "harms"


def write(
    varied: list[dict],
    compared: list[dict],
    varied_csv: str | Path,
    compared_csv: str | Path,
    markdown: str | Path,
) -> None:
    """Write the rows to CSV files (columns VARIED and COMPARED), and both to a `markdown` file for
    reading, all atomically."""
    tables = pd.DataFrame(varied, columns=VARIED), pd.DataFrame(compared, columns=COMPARED)
    for rows, path in zip(tables, (varied_csv, compared_csv), strict=True):
        with atomic_path(path) as temporary:
            rows.to_csv(temporary, index=False, float_format="%.6g")
    with atomic_path(markdown) as temporary:
        temporary.write_text(to_markdown(*tables), encoding="utf-8")


def to_markdown(varied: pd.DataFrame, compared: pd.DataFrame) -> str:
    """A section for each data set and split, with one line for each value or difference."""
    lines = [
        "# Ablation",
        "",
        "Test part, mean over seeds [95 % interval over seeds, where there are five or more].",
        "x, y and depth in mm, F in N.",
        "Seeds share samples and split: the intervals tell what chance in training does, not what",
        "another recording would.",
    ]
    shown = varied[varied["metric"].isin(SHOWN)]
    for (dataset, split, budget), group in shown.groupby(
        ["dataset", "split", "budget"], sort=False
    ):
        columns = list(group[["target", "metric"]].drop_duplicates().itertuples(False, None))
        lines += [
            "",
            f"## One choice varied: {dataset} · split by {split} · budget {budget}",
            "",
            _line("varied", "value", *(f"{SHOWN[metric]} {target}" for target, metric in columns)),
            _line(*["---"] * (len(columns) + 2)),
        ]
        for (study, value), value_rows in group.groupby(["study", "value"], sort=False):
            cell = value_rows.set_index(["target", "metric"])
            lines.append(_line(study, value, *(_cell(cell.loc[c], "mean", ".3f") for c in columns)))
    shown = compared[compared["metric"].isin(SHOWN)]
    if len(shown):
        lines += ["", "## Does the latent loss help?", "", *_summary(shown)]
    for (dataset, split, budget, widths), group in shown.groupby(
        ["dataset", "split", "budget", "widths"], sort=False
    ):
        setting_row = group.iloc[0]
        lines += [
            "",
            f"### {dataset} · split by {split} · hidden {widths} · budget {budget}",
            "",
            f"Tuned on the validation part: {PLAIN} {setting_row['plain_setting']}, "
            f"{INFORMED} {setting_row['informed_setting']}.",
            "",
            _line("", PLAIN, INFORMED, "difference", "the latent loss"),
            _line(*["---"] * 5),
        ]
        lines += [
            _line(
                f"{SHOWN[row['metric']]} {row['target']}",
                *(f"{row[name]:.3f}" for name in ("plain", "informed")),
                _cell(row, "difference", "+.4f"),
                row["verdict"],
            )
            for _, row in group.iterrows()
        ]
    return "\n".join(lines) + "\n"


def _summary(compared: pd.DataFrame) -> Iterable[str]:
    """The number of lines by verdict, and the number of intervals that exclude 0 by chance."""
    intervals = compared[compared["low"].notna()]
    count = len(intervals)
    helps, harms = ((intervals["verdict"] == word).sum() for word in ("helps", "harms"))
    yield (
        f"{PLAIN} and {INFORMED}, tuned in the same grid on the validation part and trained with "
        f"the same seeds. Of {count} differences with an interval, {helps} say that the latent "
        f"loss helps, {harms} that it harms, {count - helps - harms} nothing. If it did "
        f"nothing, about {0.05 * count:.1f} would still say something: each interval is one of "
        "95 %."
    )


def _cell(row: pd.Series, name: str, form: str) -> str:
    text = f"{row[name]:{form}}"
    if pd.notna(row["low"]):
        text += f" [{row['low']:{form}}, {row['high']:{form}}]"
    return text


def _line(*cells: str) -> str:
    return f"| {' | '.join(map(str, cells))} |"
