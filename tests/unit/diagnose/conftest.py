"""Reports without their figures."""

import pytest

from eitskin.diagnose.report import figures


@pytest.fixture
def undrawn(monkeypatch):
    """Reports have their words alone: drawing takes longer than all else."""
    absent = dict.fromkeys(figures.FIGURES, "Not drawn.")
    monkeypatch.setattr(figures, "draw", lambda evidence: absent)
    monkeypatch.setattr(figures, "draw_changes", lambda shown: [None] * len(shown.effect_changes))
