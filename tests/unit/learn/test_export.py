"""What an exported predictor is not made of."""

from dataclasses import replace

import numpy as np
import pytest

import streamed_skin as skin
from eitskin.errors import InputError
from eitskin.exported.channels import STRENGTHS
from eitskin.learn import export

pytestmark = pytest.mark.xdist_group("streamed")  # one predictor, trained in seconds


def test_a_budget_that_validates_on_nothing_is_refused():
    trained = skin.trained()
    budget = trained.header["budget"] | {"validated": False}
    model = replace(trained, header=trained.header | {"budget": budget})
    with pytest.raises(InputError, match="streamed: budget, validated: found false, expected true"):
        export.export(model, skin.dataset(), skin.part(), skin.SKIN, 1)


def test_a_class_of_strength_without_touches_is_refused():
    strong = np.repeat(np.arange(STRENGTHS - 1), 50)
    with pytest.raises(InputError, match="found 0 in a class of strength, expected 20 touches"):
        export._by_strength(np.zeros((len(strong), 3)), strong)
