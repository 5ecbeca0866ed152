"""What skins of more electrodes cost, and that their derivatives and errors are measured."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmark import costs


class Here:
    """A pool of this process."""

    def __init__(self, workers):
        self.of = workers

    def __enter__(self):
        return self

    def __exit__(self, *_): ...

    def submit(self, *arguments):
        value = self.of(*arguments)
        return SimpleNamespace(result=lambda: value)


def called(work, *arguments):
    return work(*arguments)


def test_a_row_of_each_kind_for_every_number_of_electrodes(monkeypatch):
    monkeypatch.setattr(costs, "ELECTRODES", (8, 16))
    monkeypatch.setattr(costs, "PLACES_MM", costs.PLACES_MM[:3])
    rows_by_name = {row["name"]: row for row in costs.electrodes(2)}
    eight, sixteen = (rows_by_name[f"new skin of {n} electrodes, 192 places"] for n in (8, 16))
    assert sixteen["peer_runs"] == eight["ours_runs"]
    assert rows_by_name["derivatives, 16 electrodes, train"]["ours"] > 0.0
    errors = [
        rows_by_name[f"error, 16 electrodes, {accuracy}"]["ours"] for accuracy in costs.ACCURACIES
    ]
    assert max(errors) < costs.ERROR
    assert len(set(errors)) == len(errors)


def test_every_run_has_a_skin_of_its_own():
    skins = [costs.skin(16, number) for number in (0, 0, 1)]
    assert skins[0].key() == skins[1].key() != skins[2].key()


@pytest.mark.parametrize("count", [16, 32])
def test_electrodes_are_spread_over_the_rim(count):
    assert costs.skin(count, 0).electrode_deg[1] == pytest.approx(360.0 / count, abs=1.0)


def test_names_are_left_out_of_the_catalogue_but_the_true_ones(monkeypatch):
    catalogues = []
    monkeypatch.setattr(costs.effects, "EFFECTS", dict(costs.effects.EFFECTS))
    monkeypatch.setattr(costs.os, "environ", dict(costs.os.environ))
    monkeypatch.setattr(
        costs.diagnoses,
        "diagnosis",
        lambda path: catalogues.append(costs.effects.catalogue_names()) or (1.0, 1.0),
    )
    assert costs.drawn_seconds(1, 20, 5) == 1.0
    assert len(catalogues[0]) == 5
    assert "contact-impedance" in catalogues[0]


def test_a_recording_that_grew_is_diagnosed_anew_and_with_what_was_found(monkeypatch):
    calls = []

    def diagnosis(path, *options):
        frames = len(costs.recording.read(path).frames)
        calls.append((frames, options and Path(options[1]).read_text(encoding="utf-8")))
        path.with_name("out").mkdir(exist_ok=True)
        (path.with_name("out") / "effects.yaml").write_text(f"of {frames}", encoding="utf-8")
        return (1.0 if options else 4.0), 1.0

    monkeypatch.setattr(costs.diagnoses, "diagnosis", diagnosis)
    monkeypatch.setattr(costs, "ProcessPoolExecutor", lambda *_, **__: Here(called))
    monkeypatch.setattr(costs.diagnoses, "FRAMES", 60)
    monkeypatch.setattr(costs.os, "environ", dict(costs.os.environ))
    (row,) = costs.grown(2)
    assert (row["ours"], row["ratio"], row["runs"]) == (1.0, 0.25, 2)
    assert calls == 2 * [(60, ()), (110, ()), (110, "of 60")]


def test_costs_stand_beside_those_of_their_group(monkeypatch):
    def done(work, run, *arguments):
        return float(arguments[0]) or 1.0

    monkeypatch.setattr(costs, "ProcessPoolExecutor", lambda *_, **__: Here(done))
    rows_by_name = {row["name"]: row for row in costs.scaled(2)}
    assert rows_by_name["diagnosis, 1000 frames"]["ratio"] == 2.0
    assert rows_by_name["diagnosis, six presses, 32 electrodes"]["ratio"] == 2.0
    assert rows_by_name["diagnosis, 500 frames"]["runs"] == 2
