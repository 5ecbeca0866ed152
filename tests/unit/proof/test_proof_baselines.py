"""Other methods find what they can find, and nothing where there is nothing."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.data.recording import Recording
from eitskin.effects import EFFECTS
from proof import baselines, oracle
from proof.baselines import everything, lasso, matched_filter, named
from proof.intervals import rms
from proof.refit import Refit
from proof.tangent_basis import TangentBasis
from witness import cases

KNOWN, READINGS, ASKED = 12, 400, 50
GREEDY = (matched_filter, lasso)


def candidate(name, site=None, scope="sparse", **start):
    kind = None if site is None else "electrodes"
    sites = None if site is None else (site,)
    told = {"name": name, "effect": EFFECTS[name], "start": start, "looks": KNOWN}
    return SimpleNamespace(kind=kind, sites=sites, scope=scope, **told)


def made(strengths, seed=1):
    """KNOWN columns, those given of `strengths` (index: in noise units) in the residual."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((KNOWN, READINGS))
    columns /= np.linalg.norm(columns, axis=1)[:, None]
    asked = rng.standard_normal((KNOWN, ASKED))
    residual = rng.standard_normal(READINGS)
    for k, strength in strengths.items():
        residual = residual + strength * columns[k]
    kinds = [candidate("contact-impedance", k) for k in range(KNOWN - 3)]
    kinds += [candidate("domain-shape", scope="", harmonic=k) for k in (2, 3)]
    kinds += [candidate("crosstalk", scope="")]
    truth = sum((s * asked[k] for k, s in strengths.items()), np.zeros(ASKED))
    return truth, TangentBasis(
        columns=[(c, 0) for c in kinds],
        gram=columns @ columns.T,
        slope=columns @ residual,
        length=np.full(KNOWN, 30.0),
        query_change=asked,
        groups=[(c, np.array([k])) for k, c in enumerate(kinds)],
        chi2=float(residual @ residual),
        dof=READINGS,
    )


@pytest.mark.parametrize("method", GREEDY)
def test_what_is_strong_is_found_and_predicted(method):
    truth, tangents = made({4: 25.0, 11: -20.0})
    chosen, values = method(tangents)
    assert sorted(chosen) == [4, 11]
    assert values @ tangents.query_change[chosen] == pytest.approx(truth, abs=6.0)
    assert rms(truth) > 20


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_found_in_noise(seed):
    truth, tangents = made({}, seed)
    for method in GREEDY:
        chosen, values = method(tangents)
        assert len(chosen) == 0
        assert (values @ tangents.query_change[chosen] == truth).all()
    assert len(everything(tangents)[2]) == 0


def test_the_lasso_bears_products_that_were_summed_in_single_precision():
    _, tangents = made({4: 25.0})
    gram = tangents.gram.copy()
    gram[:2, :2] = 1.0  # columns that are one but for rounding
    gram[0, 1] = gram[1, 0] = 1.0 + 1e-4
    chosen, _ = lasso(replace(tangents, gram=gram))
    assert 4 in chosen


def test_least_squares_on_everything_names_what_stands_out():
    truth, tangents = made({4: 25.0, 11: -20.0})
    chosen, values, shown = everything(tangents)
    assert len(chosen) == KNOWN
    assert sorted(shown) == [4, 11]
    assert rms(values @ tangents.query_change[chosen] - truth) < 0.3 * rms(truth)


def test_columns_of_one_name_are_one_effect_harmonics_several():
    _, tangents = made({})
    told = named(tangents, np.array([3, 1, 9, 10, 11]))
    assert [entry["name"] for entry in told] == [
        *("contact-impedance", "domain-shape", "domain-shape", "crosstalk")
    ]
    assert told[0]["electrodes"] == [1, 3]
    assert told[3]["electrodes"] == []


@pytest.fixture(scope="module")
def small():
    case = cases.draw("single:contact-impedance", 3, 40)
    recorded = Recording(case.states, case.voltage, None, None, dict(case.metadata))
    return case, recorded, Recording(case.query, None, None, None, dict(case.metadata))


def test_a_case_whose_predictions_were_lost_is_compared_again(monkeypatch, tmp_path):
    for part in ("recordings", "queries"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "case-1.parquet").write_bytes(b"")
    asked = []

    def one(*files):
        asked.append(files)
        raise ValueError("broken off")

    monkeypatch.setattr(baselines, "_compared", one)
    for _ in range(2):
        baselines.run(["case-1"], tmp_path, 1, "a")
    assert len(asked) == 1
    (tmp_path / "baselines/case-1.npz").unlink()  # as by a kill before it was written
    baselines.run(["case-1"], tmp_path, 1, "a")
    assert len(asked) == 2 and (tmp_path / "baselines/case-1.npz").is_file()


@pytest.mark.long
def test_every_method_says_and_predicts_something_of_a_witness_recording(small):
    case, recorded, query = small
    said, predicted = baselines.compare(recorded, query, 1)
    assert set(said) == set(predicted) == set(baselines.METHODS)
    assert {name for name, told in said.items() if told is not None} == set(baselines.NAMING)
    left = {name: rms(voltage - case.query_clean) for name, voltage in predicted.items()}
    assert np.isfinite(list(left.values())).all()
    assert left["matched-filter"] < 0.5 * left["none"]
    assert left["lasso"] < 0.5 * left["none"]
    truth = {
        "effects": case.effects,
        "scopes": case.scopes,
        "outside": None,
    }
    refit = Refit.of(recorded, 1)
    best = oracle.oracle(refit, query, truth, case.query_clean)
    assert best["rmse_V"] < 0.5 * left["none"]
    assert [told["name"] for told in best["effects"]] == ["contact-impedance"]
    unknown = oracle.oracle(refit, query, {**truth, "outside": {"law": "palm"}}, None)
    assert unknown == {"rmse_V": None, "effects": None, "log_evidence": None}
    right = [{**told, "scope": "sparse"} for told in best["effects"]]
    nothing, all_said = (oracle.named_refitted(refit, said, case.clean) for said in ([], right))
    assert all_said["said_log_evidence"] == pytest.approx(best["log_evidence"], abs=0.1)
    assert nothing["said_log_evidence"] < best["log_evidence"] - 3.0
    assert all_said["snr_left"] < 5.0 < nothing["snr_left"]


@pytest.mark.long
@pytest.mark.filterwarnings("error::scipy.linalg.LinAlgWarning")
def test_calibrations_that_do_the_same_hinder_no_method(small):
    """In arbitrary units conductivity, thickness and the unit's factor are one."""
    _, recorded, query = small
    unknown = dict.fromkeys(("conductivity_S_per_m", "thickness_mm", "contact_impedivity_ohm_m2"))
    about = recorded.metadata | {"unit": "arbitrary", "skin": recorded.metadata["skin"] | unknown}
    said, predicted = baselines.compare(
        replace(recorded, metadata=about), replace(query, metadata=about), 1
    )
    assert set(said) == set(baselines.METHODS)
    assert np.isfinite(list(predicted.values())).all()
