"""What skins of more electrodes cost, and that their derivatives and errors are measured."""

import pytest

from benchmark import costs


def test_a_row_of_each_kind_for_every_number_of_electrodes(monkeypatch):
    monkeypatch.setattr(costs, "ELECTRODES", (8, 16))
    monkeypatch.setattr(costs, "PLACES_MM", costs.PLACES_MM[:3])
    told = {row["name"]: row for row in costs.electrodes(2)}
    assert told["new skin of 8 electrodes, 192 places"]["ratio"] == 1.0
    assert told["derivatives, 16 electrodes, train"]["ours"] > 0.0
    errors = [told[f"error, 16 electrodes, {accuracy}"]["ours"] for accuracy in costs.ACCURACIES]
    assert max(errors) < costs.ERROR
    assert len(set(errors)) == len(errors)


def test_every_run_has_a_skin_of_its_own():
    skins = [costs.skin(16, number) for number in (0, 0, 1)]
    assert skins[0].key() == skins[1].key() != skins[2].key()


@pytest.mark.parametrize("count", [16, 32])
def test_electrodes_are_spread_over_the_rim(count):
    assert costs.skin(count, 0).electrode_deg[1] == pytest.approx(360.0 / count, abs=1.0)
