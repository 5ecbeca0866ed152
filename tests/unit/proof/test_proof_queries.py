"""Whether what is found predicts states that no diagnosis saw worse than its owner's beliefs do."""

import pytest

from proof import blocks, prediction_score
from proof.trial import query_trial

# Frames out of order, of which a faint tone was named with calibrations that predict ten times
# worse (docs/calibration/queries.md).
# A contact that is lost now and then, of which an impedance that grows with the force was named.
# Electrodes twice as wide as stated, of which a contact that widens with the force was named.
HARMED = [("query:shuffled", 200_012), ("query:foreign", 600_030), ("query:belief", 700_016)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "seed"), [*blocks.trials("queries-development", "quick"), *HARMED]
)
def test_what_is_found_does_no_harm(kind, seed):
    row = query_trial(kind, seed)
    if "absent" in row:
        pytest.skip(row["absent"])
    if "refused" in row:
        return  # it predicts nothing
    assert prediction_score.rmse_ratio(row["hidden"]) <= prediction_score.MOST_RATIO
    assert not row["hidden"]["standard_errors"] > prediction_score.WORSE
