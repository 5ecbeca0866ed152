"""The example of the page on physics runs and gives what its comments say."""

import re
from pathlib import Path

import numpy as np

PAGE = Path(__file__).parents[3] / "docs" / "physics.md"


def test_the_example():
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    names: dict = {}
    exec(compile(code, str(PAGE), "exec"), names)
    assert names["channels"].shape == (208, 4)
    assert names["untouched"].shape == names["by_angle"].shape == (208,)
    assert names["change"].shape == (50, 208)
    assert np.abs(names["change"][0]).max() == 0 < np.abs(names["change"][1]).min()
