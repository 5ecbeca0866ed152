"""Passages of pages that show rows of the repository, each between two comments of its page:

    <!-- rows: SUBJECT -->
    what `PASSAGES` makes of it
    <!-- end of rows -->

Numbers that were measured stand nowhere else. SUBJECT may be two words: a function and its
argument.
"""

import re
from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd

from eitskin.learn.metrics import interval
from eitskin.learn.models import PHYSICS_INFORMED
from eitskin.paper.table_1 import paper as printed_by_the_paper
from eitskin.quantities import MINUS
from manual.rows import DOCS, ROOT, bench, claim, page_table, paper, summary, summary_of, trials
from proof.dense import scores
from proof.intervals import share
from proof.markdown import is_share, number, table
from proof.queries import KINDS as QUERY_KINDS
from witness.owned import KINDS as OWNER_KINDS

PASSAGE = re.compile(
    r"(?P<begin><!-- rows: (?P<subject>[^>]+?) -->\n)(?P<rows>.*?)(?P<end><!-- end of rows -->)",
    re.DOTALL,
)
PRINTED = ROOT / "workflow" / "eitskin" / "paper" / "printed_table_1.csv"
AXES = (("x", "mae", 2), ("y", "mae", 2), ("F", "r2", 3), ("F", "mae", 3))  # and decimals
HEAD = ("MAE x, mm", "MAE y, mm", "R² F", "MAE F, N")
MLP, INFORMED, AUTOENCODER = "mlp", f"{PHYSICS_INFORMED}mlp", "autoencoder-mlp"


def filled(text: str) -> str:
    """A page with every passage as its rows have it. Raises KeyError for an unknown subject."""

    def passage(match: re.Match) -> str:
        word, _, argument = match["subject"].partition(" ")
        lines = PASSAGES[word](*([argument] if argument else []))
        return "\n".join([match["begin"], *lines, "", match["end"]])

    return PASSAGE.sub(passage, text)


def _measured(line: dict) -> str:
    """A line of a score: hits, value and interval."""
    if not line["n"]:
        return ""
    shares = is_share(line)
    value = number(line["value"], shares)
    if shares:
        value = f"{line['hits']:.0f} of {line['n']}, {value}"
    if line.get("met") is False:
        value = f"**{value}**"
    low, high = (number(line[end], shares) for end in ("low", "high"))
    return f"{value} ({low.removesuffix(' %')} to {high})" if low and high else value


def calibration(block: str) -> Iterable[str]:
    """All lines of a block's score that count any recording; kinds of a block below each other."""
    lines = summary(block)
    lines = lines[(lines["n"] > 0) & lines["value"].notna()]
    of_kind = lines["of"].isin({*QUERY_KINDS, *OWNER_KINDS})
    columns = ("of", "what", "value", "low", "high", "hits", "n", "wanted", "met")
    cells = [
        (line["of"], line["what"], _measured(line), line["wanted"], line["n"])
        for line in lines.loc[~of_kind | (lines["wanted"] != ""), columns].to_dict("records")
    ]
    yield from table(("recordings", "what", "measured", "wanted", "n"), cells)
    by_kind = lines[of_kind & (lines["wanted"] == "")]
    if len(by_kind):
        whats = list(dict.fromkeys(by_kind["what"]))
        yield ""
        yield from table(
            ("recordings", *whats),
            [
                (kind, *(_hits(by_kind, kind, what) for what in whats))
                for kind in dict.fromkeys(by_kind["of"])
            ],
        )


def beside(blocks: str) -> Iterable[str]:
    """All lines that count any recording of two blocks, of which the second has a part of the
    first's recordings: what either measured on that part."""
    whole_block, part_block = blocks.split()
    part = trials(part_block)
    keys = {(row["kind"], row["seed"]) for row in part}
    whole = [row for row in trials(whole_block) if (row["kind"], row["seed"]) in keys]
    lines = summary_of(whole_block, whole), summary(part_block)
    pairs = zip(*(table_lines.to_dict("records") for table_lines in lines), strict=True)
    cells = [
        (earlier["of"], earlier["what"], _measured(earlier), _measured(later), earlier["wanted"])
        for earlier, later in pairs
        if earlier["n"] or later["n"]
    ]
    yield from table(("recordings", "what", "earlier", "later", "wanted"), cells)


def dense(first_seed: str) -> Iterable[str]:
    """The scores of recordings that are a little wrong at every site, from a seed on."""
    rows = [row for row in trials("dense-report") if row["seed"] >= int(first_seed)]
    yield from table(("what", "measured", "n"), scores(rows))


def _hits(lines: pd.DataFrame, kind: str, what: str) -> str:
    for line in lines[(lines["of"] == kind) & (lines["what"] == what)].to_dict("records"):
        return (
            f"{line['hits']:.0f} of {line['n']}" if is_share(line) else number(line["value"], False)
        )
    return ""


NULL, SINGLE, FOREIGN = "nothing left out", "one effect", "outside the catalogue"
RIGHT = "right name or declared class"
OFTEN = (  # of the front page: lines of the score of `ordinary-report`, and what they are there
    (NULL, "an effect named", "nothing left out, a name"),
    (SINGLE, f"{RIGHT}, everything drawn", "one effect, of any gap, rightly named"),
    (SINGLE, f"{RIGHT}, gap ≥ 8", "these with a gap of 8 noise units or more"),
    (FOREIGN, "flagged, everything drawn", "physics that has no name, flagged"),
    (FOREIGN, "a name of the catalogue all the same", "a name given all the same"),
    (FOREIGN, "a certain name of the catalogue all the same", "a *certain* name given"),
    (FOREIGN, "called explained", "called *explained*"),
)
SEALED = (  # the same of the final block
    (SINGLE, f"{RIGHT}, gap ≥ 8", "sealed, gap of 8 or more"),
    ("a fault in a real recording", "found, at its site", "faults in real recordings, found"),
)


def often() -> Iterable[str]:
    """How often the diagnosis is right: of `ordinary-report`, queries, the final block."""
    lines = [(what, _measured(claim("ordinary-report", of, key))) for of, key, what in OFTEN]
    worse = claim("queries-report", "all queries", "the same, of those with a name")
    lines.append(("readings never seen, named: predicted worse", _measured(worse)))
    for of, key, what in SEALED:
        line = _final(of, key)
        low, _, high = line["95 %"].partition(" to ")
        interval_text = f"{low.removesuffix(' %')} to {high}"
        lines.append((what, f"{line['measured']} of {line['n']} ({interval_text})"))
    return table(("recordings", "measured (95 %)"), lines)


COMPARED = (  # lines of a score in which rigs with errors and without are set side by side
    (NULL, "an effect named"),
    (NULL, "something outside the catalogue flagged"),
    (SINGLE, f"{RIGHT}, everything drawn"),
    (SINGLE, f"{RIGHT}, gap ≥ 8"),
    (SINGLE, f"{RIGHT}, gap 5 to 8"),
    (SINGLE, f"{RIGHT}, gap 3 to 5"),
    (SINGLE, "right electrode, drive, measuring pair or channels, gap ≥ 8"),
    (SINGLE, "90 % intervals that hold the truth, gap ≥ 8"),
    ("two effects", "F1 of the set, all"),
    (FOREIGN, "flagged, everything drawn"),
    (FOREIGN, "a certain name of the catalogue all the same"),
    (FOREIGN, "falsely flagged: all without it"),
    ("hidden frames, an effect", "noise-free values within the 90 % bands, mean"),
)


def compared() -> Iterable[str]:
    """Scores of rigs with errors beside those without."""
    lines = []
    for of, what in COMPARED:
        ours = [claim(block, of, what) for block in ("ordinary-report", "plain-report")]
        lines.append((of, what, *map(_measured, ours), ours[0]["wanted"]))
    return table(("recordings", "what", "with errors of the rig", "without", "wanted"), lines)


def _final(of: str, what: str) -> dict[str, str]:
    lines = page_table("concealed/final.md", ("recordings", "what", "measured"))
    (line,) = [line for line in lines if (line["recordings"], line["what"]) == (of, what)]
    return line


def final() -> Iterable[str]:
    """The final block's lines that have a gate, and what every method reaches on it."""
    lines = page_table("concealed/final.md", ("recordings", "what", "measured"))
    cells = [
        (
            *(line[key] for key in ("recordings", "what", "measured", "95 %", "n")),
            line.get("gate", ""),
        )
        for line in lines
    ]
    yield from table(("recordings", "what", "measured", "95 %", "n", "gate"), cells)
    yield ""
    methods = page_table("concealed/final.md", ("method", "false alarms"))
    yield from table(tuple(methods[0]), [tuple(line.values()) for line in methods])


def objects() -> Iterable[str]:
    """What is found in real tanks, counted over the lines of the page of objects."""
    files = page_table("concealed/objects.md", ("file", "named"))
    phantoms = [line for line in files if " empty " not in line["file"]]
    empty = [line for line in files if " empty " in line["file"]]
    signs = [line for line in phantoms if line["sign right"]]
    counts = (
        ("with objects", "objects named", phantoms, lambda line: line["named"] == "yes"),
        (
            "their signs on record",
            "every sign right",
            signs,
            lambda line: line["sign right"] == "yes",
        ),
        ("two empty tanks", "something named", empty, lambda line: line["named"] != "nothing"),
    )
    lines = []
    for recordings, what, counted, condition in counts:
        measured = share(sum(map(condition, counted)), len(counted))
        lines.append((recordings, what, _measured(measured | {"met": None})))
    return table(("recordings", "what", "measured (95 %)"), lines)


def loop() -> Iterable[str]:
    """What the loop saves, by model and by what it is held against."""
    lines = page_table("loop/loop.md", ("model", "against"))
    return table(tuple(lines[0]), [tuple(line.values()) for line in lines])


def images() -> Iterable[str]:
    """How far pyEIT's images have the sample's presses from their places, by matrix."""
    rows = pd.read_csv(DOCS / "sample" / "images.csv")
    lines = [tuple(f"{value:.1f}" for value in row) for row in rows.to_numpy()]
    lines.append(("mean", "", "", *(f"{rows[key].mean():.2f}" for key in ("own_mm", "ours_mm"))))
    return table(("x, mm", "y, mm", "force, N", "own matrix: off by, mm", "ours, mm"), lines)


def _values(row: pd.Series) -> np.ndarray:
    return np.array([float(text) for text in row["each"].split(";")])


def _by_axis(rows: pd.DataFrame) -> dict[tuple[str, str], pd.Series]:
    return {(row["target"], row["metric"]): row for _, row in rows.iterrows()}


def _printed(model: str) -> dict[tuple[str, str], float]:
    rows = printed_by_the_paper(PRINTED)
    rows = rows[(rows["recording"] == "simulated") & (rows["model"] == model)]
    return rows.set_index(["target", "metric"])["value"].to_dict()


def _name(configuration: str, recording: str) -> str:
    return configuration or recording.removeprefix("simulated-")


def table_1(name: str) -> Iterable[str]:
    """Table I of a file of docs/paper: each model's mean over seeds ± half its interval, and the
    ensemble's value; the paper's number in brackets, where the row repeats its experiment."""
    rows = paper(name)
    lines = []
    for (configuration, recording, split, model), group in rows.groupby(
        ["configuration", "recording", "split", "model"], sort=False
    ):
        axes, subject = _by_axis(group), (_name(configuration, recording), split)
        repeats = (configuration, split) == ("authors", "random")
        printed = _printed(model) if repeats else {}
        seeds = group["seeds"].iloc[0]
        cells = [
            f"{axes[target, metric]['mean']:.{digits}f}"
            + _half(axes[target, metric], digits)
            + (f" ({printed[target, metric]:g})" if (target, metric) in printed else "")
            for target, metric, digits in AXES
        ]
        lines.append((*subject, model, seeds, *cells))
        if seeds > 1:
            together = [
                f"{axes[target, metric]['ensemble']:.{digits}f}" for target, metric, digits in AXES
            ]
            lines.append((*subject, f"{model}, mean of the seeds' estimates", seeds, *together))
    return table(("set", "split", "model", "seeds", *HEAD), lines)


def _half(row: pd.Series, digits: int) -> str:
    half = (row["high"] - row["low"]) / 2
    return f" ± {half:.{digits}f}" if np.isfinite(half) else ""


def front_table_1() -> Iterable[str]:
    """Table I's MLPs on the paper's own set and split, in three columns."""
    rows = paper("authors")
    rows = rows[(rows["configuration"] == "authors") & (rows["split"] == "random")]
    lines = []
    for model in (MLP, AUTOENCODER, INFORMED, "svr"):
        axes, printed = _by_axis(rows[rows["model"] == model]), _printed(model)

        def cell(column: str, *places: tuple[str, str, int]) -> str:
            return ", ".join(f"{axes[t, m][column]:.{digits}f}" for t, m, digits in places)  # noqa: B023

        def beside(*places: tuple[str, str, int]) -> str:
            return ", ".join(f"{printed[t, m]:g}" for t, m, _ in places)  # noqa: B023

        columns = (AXES[:2], AXES[2:3], AXES[3:])
        lines.append((model, *(f"{cell('mean', *c)} ({beside(*c)})" for c in columns)))
        if model == MLP:
            lines.append((f"mean of ten {MLP}", *(cell("ensemble", *c) for c in columns)))
    return table(("random split", "MAE x, y, mm", "R² of force", "MAE of force, N"), lines)


def latent_loss(name: str) -> Iterable[str]:
    """Physics-informed minus plain, paired by seed, of every set and split of a file of docs/paper,
    with 95 % over seeds; beside it the plain MLP."""
    rows, lines = paper(name), []
    for (configuration, recording, split), group in rows.groupby(
        ["configuration", "recording", "split"], sort=False
    ):
        plain, informed = (_by_axis(group[group["model"] == m]) for m in (MLP, INFORMED))
        if not informed:
            continue
        cells = []
        for target, metric, digits in AXES:
            difference = _values(informed[target, metric]) - _values(plain[target, metric])
            cells.append(_signed(difference.mean(), *interval(difference), digits + 1))
        beside = ", ".join(f"{plain[t, m]['mean']:.{digits}f}" for t, m, digits in AXES)
        lines.append((_name(configuration, recording), split, *cells, beside))
    return table(("set", "split", *HEAD, "plain"), lines)


def _signed(value: float, low: float, high: float, digits: int) -> str:
    return f"{value:+.{digits}f} ({low:.{digits}f} to {high:.{digits}f})".replace("-", MINUS)


def sizes() -> Iterable[str]:
    """Physics-informed minus plain, by size of both."""
    rows, lines = paper("latent_loss_all_samples"), []
    for widths, group in rows.groupby("widths", sort=False):
        axes = _by_axis(group)
        cells = [
            _signed(row["difference"], row["low"], row["high"], digits + 1)
            for row, digits in ((axes[target, metric], digits) for target, metric, digits in AXES)
        ]
        lines.append((str(widths).replace("x", ", "), *cells))
    return table(("hidden", *HEAD), lines)


def tuning() -> Iterable[str]:
    """The best point of the grid for each model and size, on all samples."""
    rows = paper("tuning")
    best = rows.loc[rows.groupby(["model", "widths"], sort=False)["score"].idxmin()]
    lines = [
        (
            *(row["model"], row["widths"].replace("x", ", ")),
            *(f"{row['learning_rate']:g}", f"{row['weight_decay']:g}"),
            *(f"{row[key]:.{digits}f}" for key, digits in (("mae_x", 2), ("mae_y", 2))),
            *(f"{row[key]:.3f}" for key in ("mae_F", "score")),
        )
        for _, row in best.iterrows()
    ]
    head = ("model", "hidden", "learning rate", "weight decay", "MAE x, mm", "MAE y, mm")
    return table((*head, "MAE F, N", "score"), lines)


def tuning_quarter() -> Iterable[str]:
    """The score of every model at every point of the grid, its larger size, a quarter of the
    samples."""
    rows = paper("tuning_quarter")
    rows = rows[rows["widths"] != "256x128x64"]
    points = (
        rows[["learning_rate", "weight_decay"]]
        .drop_duplicates()
        .sort_values(list(rows.columns[5:7]))
    )
    columns = [tuple(point) for point in points.to_numpy()]
    lines = []
    for model, group in rows.groupby("model", sort=False):
        score = group.set_index(["learning_rate", "weight_decay"])["score"]
        bold = {score.idxmin(): "**"}
        lines.append(
            (model, *(f"{bold.get(c, '')}{score[c]:.3f}{bold.get(c, '')}" for c in columns))
        )
    return table(("model", *(f"{rate:g}, {decay:g}" for rate, decay in columns)), lines)


def ablation() -> Iterable[str]:
    """Each choice varied alone: mean over seeds ± half its interval."""
    lines = []
    for (study, value), group in paper("ablation").groupby(["study", "value"], sort=False):
        axes = _by_axis(group)
        cells = [f"{axes[t, m]['mean']:.{d}f}{_half(axes[t, m], d)}" for t, m, d in AXES]
        lines.append((study, value, *cells))
    return table(("varied", "value", *HEAD), lines)


def _with_ends(row: pd.Series, key: str, form: str) -> str:
    """A value of a row with the ends of its interval."""
    return f"{row[key]:{form}} ({row['low']:{form}} to {row['high']:{form}})"


def limit() -> Iterable[str]:
    """The error of the posterior mean, by what it knows."""
    knows = {"limit_known": "the session's skin and gains", "limit": "their distributions alone"}
    lines = []
    for (configuration, estimate), group in paper("limit").groupby(
        ["configuration", "estimate"], sort=False
    ):
        axes = _by_axis(group)
        cells = [
            _with_ends(row, "value", ".3g")
            for row in (axes[t, m] for m in ("rmse", "mae") for t in ("x", "y", "F"))
        ]
        z2 = ", ".join(f"{axes[t, 'z2']['value']:.2f}" for t in ("x", "y", "F"))
        lines.append((configuration, knows[estimate], *cells, z2))
    errors = [f"{metric} {target}" for metric in ("RMSE", "MAE") for target in ("x", "y", "F")]
    return table(("set", "knows", *errors, "z² of x, y, F"), lines)


def limit_ratios() -> Iterable[str]:
    """Every model's errors over the limit's."""
    lines = []
    for (configuration, model), group in paper("limit_ratios").groupby(
        ["configuration", "model"], sort=False
    ):
        axes = _by_axis(group)
        cells = [
            _with_ends(row, "ratio", ".3f")
            for row in (
                axes[t, m] for t, m in (("F", "rmse"), ("F", "mae"), ("x", "mae"), ("y", "mae"))
            )
        ]
        lines.append((configuration.removesuffix("-continuous"), model, *cells))
    return table(("set", "model", "RMSE F", "MAE F", "MAE x", "MAE y"), lines)


def lost_electrodes() -> Iterable[str]:
    """Errors without an electrode or two, beside the limit's."""
    rows = paper("lost_electrodes")
    names = {"none": "none", "one": "one electrode, each in turn", "two": "two, thirty pairs"}
    lines = []
    for _, row in rows[rows["lost"].isin(names)].iterrows():
        held = ", ".join(f"{100 * row[f'held_{target}']:.0f}" for target in "xyF")
        cells = [
            cell
            for key, unit in (("rmse_F_N", "N"), ("median_place_mm", "mm"))
            for cell in (
                f"{row[key]:.2f} {unit}",
                f"{row[f'limit_{key}']:.2f} {unit}",
                "{:.2f} ({:.2f} to {:.2f})".format(
                    *(row[f"times_{key}{end}"] for end in ("", "_low", "_high"))
                ),
            )
        ]
        lines.append((names[row["lost"]], row["touches"], *cells, f"{held} %"))
    head = (
        "lost",
        "touches",
        "rms error of the force",
        "limit",
        "times",
        "median error of the place",
    )
    return table((*head, "limit", "times", "intervals of x, y, F hold"), lines)


def speed(name: str) -> Iterable[str]:
    """A bench's medians, beside what they are held against."""
    lines = [
        (
            row["name"],
            row["unit"],
            f"{row['ours']:.4g}",
            row["peer_name"],
            f"{row['peer']:.4g}",
            f"{row['ratio']:.3g}",
        )
        for row in bench(name).values()
    ]
    return table(("", "unit", "ours", "beside", "", "ratio"), lines)


def accuracy() -> Iterable[str]:
    """The forward model's errors of `benchmark.accuracy`."""
    rows = pd.read_csv(ROOT / "benchmarks" / "accuracy.csv")
    lines = [
        (
            row["skin"],
            row["accuracy"],
            *(_power(row[key]) for key in ("rms_error_of_median_v", "touch_error")),
        )
        for _, row in rows.iterrows()
    ]
    return table(
        ("skin", "accuracy", "RMS error / median \\|v\\|", "touch: ‖error of ΔV‖ / ‖ΔV‖"), lines
    )


def outline_accuracy() -> Iterable[str]:
    """The forward model beside finite elements on outlines, of `benchmark.outlines`."""
    rows = pd.read_csv(ROOT / "benchmarks" / "outlines.csv")
    keys = ("rms_error_of_median_v", "touch_error", "cut_touch_error", "witness_error")
    lines = [
        (row["outline"], f"refused: {row['refused']}", *("" for _ in keys), "")
        if isinstance(row["refused"], str) and not isinstance(row["accuracy"], str)
        else (
            row["outline"],
            row["accuracy"],
            *(_power(row[key]) for key in keys),
            f"{row['seconds']:.2f}",
        )
        for _, row in rows.iterrows()
    ]
    heads = ("outline", "accuracy", "RMS error / median \\|v\\|", "touch", "touch cut by the rim")
    return table((*heads, "finite elements' own error", "processor s, both accuracies"), lines)


def _power(value: float) -> str:
    return f"{value:.1e}" if value else "closed form"


def verdicts() -> Iterable[str]:
    """The shares of frames of each verdict of `streamed_verdicts`."""
    rows = pd.read_csv(ROOT / "benchmarks" / "verdicts.csv", index_col=0)
    lines = [(name, *(f"{share:.2f}" for share in row)) for name, row in rows.iterrows()]
    return table(("", *rows.columns), lines)


def sample() -> Iterable[str]:
    """The sentence of the front page on its picture."""
    rows = pd.read_csv(ROOT / "docs" / "sample" / "picture.csv")
    before, after = (float(np.median(rows[key])) for key in ("before", "after"))
    yield "`docs/sample`: one electrode sits two degrees from its place in the drawing. The tool"
    yield "wrote the sentence; the error on hidden frames, against the noise-free truth, falls from"
    yield f"{before:.0f} to {after:.2g} noise units."


def gallery() -> Iterable[str]:
    """Each recording of the gallery: what was hidden, the first sentence of its report, its
    picture."""
    rows = pd.read_csv(ROOT / "docs" / "gallery" / "gallery.csv")
    for name, hidden, found in rows.itertuples(index=False):
        yield f"## {name.replace('-', ' ').capitalize()}"
        yield f"\nHidden: {hidden}.\n"
        yield f"> {found}\n"
        yield f"![Error of every channel, {name}: before and after](gallery/{name}.png)\n"


PASSAGES: dict[str, Callable[..., Iterable[str]]] = {
    passage.__name__: passage
    for passage in (
        *(
            calibration,
            beside,
            dense,
            often,
            compared,
            final,
            objects,
            loop,
            images,
            table_1,
            front_table_1,
            latent_loss,
            sizes,
        ),
        *(tuning, tuning_quarter, ablation, limit, limit_ratios, lost_electrodes, speed, sample),
        gallery,
        *(accuracy, outline_accuracy, verdicts),
    )
}
