"""The page holds every row as its file has it, and says what falls short and what was not run."""

import json

import pytest

from benchmark import page, rows, speed

STAMP = {
    "command": "env OMP_NUM_THREADS=1 python -m benchmark.speed",
    "commit": "0123abc",
    "machine": {"processor": "A Fast One", "cores": 2, "memory_GiB": 23.4},
    "others_cores": 1.04,
}


def written(folder, name, *lines):
    (folder / f"{name}.json").write_text(json.dumps([line | STAMP for line in lines]))


def test_the_committed_page_is_that_of_the_files_beside_it():
    assert (page.FOLDER / "README.md").read_text(encoding="utf-8") == page.page(page.FOLDER)


def test_every_bench_has_its_section():
    assert list(page.COMPARED) == list(speed.BENCHES)


def test_a_row_has_medians_ranges_and_where_it_was_measured(tmp_path):
    written(tmp_path, "clean", rows.row("clean", "samples/s", [89e3, 91234.0, 8e4], "peer", [2.0]))
    text = page.page(tmp_path)
    assert "| clean | samples/s | 89,000 (80,000 to 91,230) | peer | 2.000 | 44,500 | 3 |" in text
    assert (
        "`env OMP_NUM_THREADS=1 python -m benchmark.speed`, commit `0123abc`, on A Fast One, "
        "2 cores, 23 GiB of memory. Other work took 1.0 cores meanwhile." in text
    )
    assert "Nothing here falls short." in text


def test_a_bench_without_its_file_is_said_not_to_be_measured(tmp_path):
    written(tmp_path, "clean", rows.row("clean", "samples/s", [3.0], "peer", [2.0]))
    text = page.page(tmp_path)
    assert text.count("Not measured yet") == len(speed.BENCHES) - 1
    assert "Not measured yet: `python -m benchmark.speed diagnosed`." in text


@pytest.mark.parametrize(
    ("unit", "ours", "short"),
    [
        ("samples/s", 1.9, True),
        ("samples/s", 2.1, False),
        ("diagnoses/h", 1.9, True),
        ("s", 2.1, True),
        ("MiB", 1.9, False),
    ],
)
def test_rates_fall_short_below_and_times_above(unit, ours, short):
    assert page.falls_short(rows.row("a", unit, [ours], "limit", [2.0])) is short


def test_what_falls_short_has_its_reason(tmp_path):
    late = rows.row("streamed, mlp, 99 %", "ms", [13.0, 33.0, 20.0], "limit", [1.0])
    slow = rows.row("something else", "ms", [3.0], "limit", [1.0])
    fine = rows.row("streamed, mlp, median", "ms", [0.37], "limit", [1.0])
    written(tmp_path, "streamed", late, slow, fine)
    short = page.page(tmp_path).split("What falls short:\n\n")[1]
    assert short == (
        "- streamed, mlp, 99 %, 20.00 ms; limit, 1.000: by the clock, what else the machine does "
        "counts in.\n- something else, 3.000 ms; limit, 1.000: the reason is not known.\n"
    )


@pytest.mark.parametrize(
    ("value", "told"),
    [(123456.0, "123,500"), (999.96, "1,000"), (47.04, "47.04"), (0.03712, "0.03712"), (0.0, "0")],
)
def test_four_digits_are_told(value, told):
    assert page.digits(value) == told
