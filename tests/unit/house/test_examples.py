"""A property is tested on the same examples whatever was imported before it."""

import importlib

from hypothesis import given, settings
from hypothesis import strategies as st


def drawn():
    """What a property is given by default."""
    seen = []

    @settings(settings.get_profile("same"))
    @given(st.integers(), st.floats(0.0, 1.0))
    def keep(whole, part):
        seen.append((whole, part))

    keep()
    return seen


def test_constants_of_a_module_are_no_examples(tmp_path, monkeypatch):
    before = drawn()
    (tmp_path / "odd_numbers.py").write_text(f"ODD = {list(range(1001, 1101, 2))}\n")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("odd_numbers")
    assert drawn() == before
