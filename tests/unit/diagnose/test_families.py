"""What is a little wrong at every site: sizes, members, culprits and objects beside them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from diagnosed_skin import SCHEMA
from eitskin.data.subset import of_frames
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.family_sizes import LARGEST_LOG_SD, FamilySizes
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.query import predict
from eitskin.diagnose.fitting.simulator import UNKNOWN
from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.noise.single_frame import beside_gains
from eitskin.diagnose.search import families, staging
from eitskin.diagnose.verdict import corrected
from eitskin.diagnose.verdict.conclusion import document
from eitskin.diagnose.verdict.validation import validate
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.physics.solver import forward_model
from proof.dense import near_and_stray, objects_of, truth_of
from small_skin import small_recording
from witness.dense import draw


def sizes_of(rng, families, noise=0.1):
    """Sizes of members with random columns, a reading a row, and the covariance of a size."""
    columns = rng.standard_normal((sum(families.values()), 40)) / noise
    label = np.repeat(np.arange(len(families)), list(families.values()))
    truth = np.array([0.5, 2.0])[label] * rng.standard_normal(len(label))
    readings = truth @ columns + rng.standard_normal(40)
    sizes = FamilySizes(
        list(families),
        np.ones(len(families)),
        label,
        np.ones(len(label)),
        columns @ columns.T,
        columns @ readings,
    )
    return sizes, columns, label, readings


SKIN = {
    "radius_mm": 60.0,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_width_mm": 8.0,
    "contact_impedivity_ohm_m2": 2e-3,
    "current_A": 1e-3,
    "contrast_per_N": 0.5,
}
FAMILIES = {"drive-gain": 8, "electrode-position": 12}


def test_the_likelihood_of_sizes_is_that_of_a_linear_mixed_model():
    sizes, columns, label, readings = sizes_of(np.random.default_rng(1), FAMILIES)

    def direct(sds):
        weighted = np.array(sds)[label, None] * columns
        density = multivariate_normal(np.zeros(40), np.eye(40) + weighted.T @ weighted)
        return density.logpdf(readings) - 0.5 * sum(sd**2 for sd in sds)

    first, second = [0.4, 1.7], [1.1, 0.6]
    expected = direct(first) - direct(second)
    (at_first, slopes), (at_second, _) = (
        sizes.log_likelihood(np.array(sds)) for sds in (first, second)
    )
    assert at_first - at_second == pytest.approx(expected, rel=1e-9)
    steps = 1e-5 * np.eye(2)
    central = [
        (direct(first * np.exp(step)) - direct(first * np.exp(-step))) / 2e-5 for step in steps
    ]
    np.testing.assert_allclose(slopes, central, rtol=1e-5)


@pytest.mark.parametrize("likeness", [0.0, 0.95])
def test_intervals_of_sizes_hold_them_also_where_a_family_does_what_another_does(likeness):
    """likeness: of what the members of one family and of the other do."""
    hits, widths = [], []
    for seed in range(80):
        rng = np.random.default_rng([seed, 7])
        shared, other = rng.standard_normal((2, 16, 60)) / 0.3
        columns = np.r_[shared, likeness * shared + np.sqrt(1.0 - likeness**2) * other]
        label = np.repeat([0, 1], 16)
        readings = 0.5 * rng.standard_normal(32) @ columns + rng.standard_normal(60)
        sizes = FamilySizes(
            ["drive-gain", "electrode-position"],
            np.ones(2),
            label,
            np.ones(32),
            columns @ columns.T,
            columns @ readings,
        )
        greatest, _ = sizes.greatest()
        log_sds = np.minimum(sizes.log_size_sds(greatest), LARGEST_LOG_SD)
        present = greatest > 0.0
        hits.append((np.abs(np.log(greatest[present] / 0.5)) < NORMAL_90 * log_sds[present]).all())
        widths.append(log_sds[0])
    assert 0.68 < np.mean(hits) < 0.95  # of two at 90 % each
    assert np.median(widths) < (0.3 if likeness == 0.0 else 0.6)


def test_sizes_are_those_that_were_drawn_and_0_where_nothing_was():
    drawn = []
    for seed in range(20):
        sizes, *_ = sizes_of(np.random.default_rng(seed), FAMILIES)
        drawn.append(sizes.greatest()[0])
    # With its prior of 1, a size of 2 shrinks a little; 20 draws of 8 and 12 members.
    np.testing.assert_allclose(np.median(drawn, axis=0), [0.5, 2.0], rtol=0.2)
    sizes, columns, label, _ = sizes_of(np.random.default_rng(3), FAMILIES)
    noise = np.random.default_rng(4).standard_normal(40)
    silent = FamilySizes(sizes.names, sizes.sds, label, sizes.variance, sizes.gram, columns @ noise)
    assert silent.greatest()[0].max() < 0.1


@pytest.mark.parametrize("count", [8, 16])
def test_noise_of_one_frame_is_told_beside_gains(count):
    channels = channel_table(count)
    rng = np.random.default_rng(5)
    skin = Skin.from_metadata(SKIN | {"electrode_deg": [360.0 / count * k for k in range(count)]})
    reading = forward_model(Geometry.from_skin(skin), "train").voltages(channels)
    noise = 1e-4 * np.median(np.abs(reading))
    gains = 1.0 + 0.1 * rng.standard_normal((2, count))
    board = reading * gains[0, channels[:, 0]] * gains[1, channels[:, 2]]
    frame = board + noise * rng.standard_normal(len(board))
    beside = beside_gains(frame, channels)
    assert beside is not None
    assert np.sqrt((beside[0] ** 2).mean()) == pytest.approx(noise, rel=0.4)
    quiet = reading + noise * rng.standard_normal(len(reading))
    assert beside_gains(quiet, channels) is None


@pytest.fixture(scope="module")
def dense():
    drawn = draw("dense:16 adjacent", 1)
    return drawn, diagnosis.diagnose(drawn.recorded)


@pytest.mark.long
def test_families_of_a_witness_are_learned_and_predict_what_was_put_aside(dense):
    drawn, diagnosed = dense
    content = document(diagnosed, "dense")
    assert not [e for e in content["effects"] if e["certain"] and e["name"] != "multiplexer-memory"]
    families = {family["name"]: family for family in content["families"]}
    gains = drawn.families["measurement-gain"]  # the currents differ by less than the frame's noise
    assert families["measurement-gain"]["sd"]["value"] == pytest.approx(
        np.sqrt(np.mean(gains**2)), rel=0.5
    )
    assert np.corrcoef(families["measurement-gain"]["values"], gains)[0, 1] > 0.98
    last = content["fit"]["last"]
    assert last["rms_after_V"] < 0.2 * last["rms_before_V"]
    fitted = diagnosed.explanation.fit
    predicted_V, sd_V = predict(fitted, drawn.recorded, drawn.recorded)
    np.testing.assert_allclose(predicted_V, fitted.voltage(), rtol=1e-9)
    assert (sd_V > 0.0).all()
    items = corrected.effect_items(fitted)
    assert "measurement-gain" in {item["name"] for item in items}


@pytest.mark.long
def test_families_are_learned_again_beside_an_effect():
    drawn = draw("dense:16 skip-3", 910_010)
    content = document(diagnosis.diagnose(drawn.recorded), "dense")
    assert [effect["name"] for effect in content["effects"]] == ["multiplexer-memory"]
    sizes = {family["name"]: family["sd"]["value"] for family in content["families"]}
    contacts = np.sqrt(np.mean(drawn.families["contact-impedance"] ** 2))
    assert sizes["contact-impedance"] == pytest.approx(contacts, rel=0.5)


@pytest.mark.long
def test_where_there_is_no_object_other_names_are_tried():
    """Trials of objects come first, and are not taken for those of every name."""
    content = document(diagnosis.diagnose(draw("dense:16 adjacent", 910_004).recorded), "dense")
    assert [e["name"] for e in content["effects"] if e["certain"]] == ["multiplexer-memory"]
    assert "scale" not in content


@pytest.mark.long
def test_an_object_is_found_in_a_dense_world_without_a_reference():
    drawn = draw("dense:16 adjacent object", 1)
    content = document(diagnosis.diagnose(drawn.recorded), "dense")
    assert content["noise"]["frames_each"] == len(drawn.recorded.frames) / staging.AVERAGES
    (patch,) = [e for e in content["effects"] if e["name"] == "conductivity-patch"]
    truth = drawn.objects[0]["parameters"]
    distance = np.hypot(
        *(patch["parameters"][key]["value"] - truth[key] for key in ("x_mm", "y_mm"))
    )
    assert distance < 0.02 * drawn.true.radius_mm and patch["certain"]


@pytest.mark.long
def test_several_objects_are_found_in_a_skin_of_unknown_size_without_a_reference():
    drawn = draw("dense:16 opposite objects", 930_002)
    content = document(diagnosis.diagnose(drawn.recorded), "dense")
    validate(content, SCHEMA, "diagnosis.json")
    assert content["noise"]["frames_each"] == len(drawn.recorded.frames) / staging.AVERAGES
    assert content["scale"] == {"radius_mm": UNKNOWN["radius_mm"][0]}
    near, stray = objects_of(content | {"truth": truth_of(drawn)})
    assert near == [True] * 4 and stray == [False] * 4


def test_the_witness_of_dense_recordings_is_the_same_bit_for_bit():
    first, again = draw("dense:8 adjacent members", 4), draw("dense:8 adjacent members", 4)
    np.testing.assert_array_equal(first.recorded.voltage, again.recorded.voltage)
    assert len(first.culprits) == 2
    for culprit in first.culprits:
        assert first.families[culprit["name"]][culprit["site"]] == culprit["value"]


def test_a_fit_begins_elsewhere_where_electrodes_would_overlap():
    """Members that made room for others may be gone: no skin is at such a start."""
    recorded = small_recording(places=1)
    still = of_frames(recorded, ~recorded.frames["touch"].to_numpy(bool))
    _, search, _ = staging.prepared(still, 1)
    places = search.problem.families["electrode-position"]
    model = search.problem.model.with_families([(member, 1.0) for member in places])
    problem = replace(search.problem, model=model)
    begin = np.zeros(len(model.calibrations))
    shift_deg = np.array([20.0, -20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # of a pitch of 45
    overlapping = begin.copy()
    overlapping[-model.member_count :] = places[0].coordinates({"shift_deg": shift_deg})
    with pytest.raises(InputError, match="overlap"):
        fit(problem, [], overlapping, polish=True)
    fitted = families._polished(problem, [], overlapping)
    assert np.array_equal(fitted.theta, fit(problem, [], begin, polish=True).theta)


def test_an_object_counts_as_near_by_place_and_sign():
    truth = [(0.5 + 0.0j, True), (-0.5j, False)]
    named = [(0.5 + 0.1j, True), (-0.45j, True), (-0.5 + 0.0j, False)]
    assert near_and_stray(named, truth) == ([True, False], [False, False, True])
    assert near_and_stray([], truth) == ([False, False], [])
