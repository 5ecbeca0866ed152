"""What the paper's choices are worth: each varied alone, and training physics-informed against
plain, at several sizes, with both tuned alike.

A setting is what differs from a model's own recipe and from the budget's `samples`.
"""

from collections.abc import Iterable
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.learn.metrics import interval_of_seeds, summary, unit

DEFAULT = "default"
PLAIN, INFORMED = PAIR = "mlp", "physics-informed-mlp"  # the two that are compared
WITH_OWN_TEACHERS = ("latent_dim", "samples")  # what an autoencoder and a regressor depend on
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
    """Settings by name: `default`, and `<key>-<value>` for every other value of `varied` than the
    default's own."""
    return {DEFAULT: {}} | {
        _named(key, value): {key: value}
        for key, values in varied.items()
        for value in values
        if value != default[key]
    }


def grid(axes: dict[str, list], widths: list[int]) -> dict[str, dict]:
    """Settings by name, one for each combination of the values of `axes` (key to values), of
    networks of these hidden widths."""
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
        (key, value, DEFAULT if value == default[key] else _named(key, value))
        for key, values in varied.items()
        for value in values
    ]


def has_own_teachers(setting: str) -> bool:
    """Whether a setting's autoencoder and regressor differ from the default's."""
    return setting.startswith(tuple(f"{key}-" for key in WITH_OWN_TEACHERS))


def _named(key: str, value: float | None) -> str:
    return f"{key}-{_told(value)}"


def _told(value: float | None) -> str:
    return "all" if value is None else f"{value:g}"


def score(rows: pd.DataFrame) -> float:
    """What settings are chosen by, less is better: the geometric mean over targets of the mean
    absolute error over seeds, so that a tenth less of any target's error counts alike. rows: of
    `metrics.by_seed`."""
    errors = rows[rows["metric"] == "mae"].groupby("target")["value"].mean()
    return float(np.exp(np.log(errors).mean()))


def best(scores: dict[str, pd.DataFrame]) -> str:
    """The setting with the best `score`; of equal ones the first.

    `scores`: by setting, the rows of `metrics.by_seed` on the validation part.
    """
    return min(scores, key=lambda name: score(scores[name]))


def in_words(setting: dict, axes: Iterable[str]) -> str:
    """A setting in words: its values on the axes of a grid."""
    return ", ".join(f"{key.replace('_', ' ')} {setting[key]:g}" for key in axes)


def varied_rows(rows: pd.DataFrame, about: dict) -> list[dict]:
    """Rows (VARIED) from those of `metrics.by_seed` of one setting: `metrics.summary` of its seeds;
    `about` gives study, value, dataset, split and budget."""
    found = []
    for (target, metric), one in rows.groupby(["target", "metric"], sort=False):
        statistics = summary(one["value"].to_numpy(), metric)
        kind = {"target": target, "metric": metric, "unit": unit(metric, target)}
        found.append(
            {**about, "model": INFORMED, "value": _told(about["value"]), **kind, **statistics}
        )
    return found


def compared_rows(plain: pd.DataFrame, informed: pd.DataFrame, about: dict) -> list[dict]:
    """Rows (COMPARED): informed minus plain, paired by seed, with a 95 % t interval of the mean.

    `plain`, `informed`: rows of `metrics.by_seed` on one test part, with the same seeds; `about`
    gives dataset, split, budget, widths, plain_setting and informed_setting.
    """
    keys = ["target", "metric", "seed"]
    pairs = plain.merge(informed, on=keys, suffixes=("_plain", "_informed"), validate="1:1")
    if not len(pairs) == len(plain) == len(informed):
        raise ValueError("plain and informed differ in their seeds, targets or metrics")
    found = []
    for (target, metric), one in pairs.groupby(["target", "metric"], sort=False):
        difference = (one["value_informed"] - one["value_plain"]).to_numpy()
        low, high = interval_of_seeds(difference)
        found.append(
            {
                **about,
                "target": target,
                "metric": metric,
                "unit": unit(metric, target),
                "plain": one["value_plain"].mean(),
                "informed": one["value_informed"].mean(),
                "difference": difference.mean(),
                "low": low,
                "high": high,
                "seeds": len(one),
                "verdict": verdict(metric, low, high, len(one)),
            }
        )
    return found


def verdict(metric: str, low: float, high: float, seeds: int) -> str:
    """What an interval of differences says of the latent loss, in plain words."""
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
    """A section for each data set and split; a line a value, and a line a difference."""
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
        for (study, value), one in group.groupby(["study", "value"], sort=False):
            cell = one.set_index(["target", "metric"])
            lines.append(_line(study, value, *(_cell(cell.loc[c], "mean", ".3f") for c in columns)))
    shown = compared[compared["metric"].isin(SHOWN)]
    if len(shown):
        lines += ["", "## Does the latent loss help?", "", *_summary(shown)]
    for (dataset, split, budget, widths), group in shown.groupby(
        ["dataset", "split", "budget", "widths"], sort=False
    ):
        first = group.iloc[0]
        lines += [
            "",
            f"### {dataset} · split by {split} · hidden {widths} · budget {budget}",
            "",
            f"Tuned on the validation part: {PLAIN} {first['plain_setting']}, "
            f"{INFORMED} {first['informed_setting']}.",
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
    """How many lines say what, and how many intervals miss 0 by chance."""
    told = compared[compared["low"].notna()]
    helps, harms = ((told["verdict"] == word).sum() for word in ("helps", "harms"))
    yield (
        f"{PLAIN} and {INFORMED}, tuned in the same grid on the validation part and trained with "
        f"the same seeds. Of {len(told)} differences with an interval, {helps} say that the latent "
        f"loss helps, {harms} that it harms, {len(told) - helps - harms} nothing. If it did "
        f"nothing, about {0.05 * len(told):.1f} would still say something: each interval is one of "
        "95 %."
    )


def _cell(row: pd.Series, name: str, form: str) -> str:
    text = f"{row[name]:{form}}"
    if pd.notna(row["low"]):
        text += f" [{row['low']:{form}}, {row['high']:{form}}]"
    return text


def _line(*cells: str) -> str:
    return f"| {' | '.join(map(str, cells))} |"
