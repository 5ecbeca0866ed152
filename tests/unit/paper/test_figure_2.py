from itertools import combinations

import pandas as pd

from eitskin import plotting
from eitskin.paper import figure_2
from eitskin.paper.figure_2 import ARROWS, BLOCKS, HEIGHT_MM, NETWORK, USE


def test_no_blocks_overlap_and_all_lie_on_the_sheet():
    for a, b in combinations(BLOCKS.values(), 2):
        apart = abs(a.x - b.x) >= 0.5 * (a.width + b.width)
        assert apart or abs(a.y - b.y) >= 0.5 * (a.height + b.height)
    for block in BLOCKS.values():
        assert block.x - 0.5 * block.width >= 0 and block.x + 0.5 * block.width <= plotting.FULL_MM
        assert block.y - 0.5 * block.height >= 0 and block.y + 0.5 * block.height <= HEIGHT_MM


def test_arrows_are_straight_and_pass_no_block():
    for first, second, _ in ARROWS:
        a, b = BLOCKS[first], BLOCKS[second]
        assert a.x == b.x or a.y == b.y, (first, second)
        for name, block in BLOCKS.items():
            if name in (first, second):
                continue
            between_x = min(a.x, b.x) <= block.x <= max(a.x, b.x)
            between_y = min(a.y, b.y) <= block.y <= max(a.y, b.y)
            on_row = a.y == b.y and abs(block.y - a.y) < 0.5 * block.height and between_x
            on_column = a.x == b.x and abs(block.x - a.x) < 0.5 * block.width and between_y
            assert not on_row and not on_column, (first, second, name)


def test_what_estimates_a_touch_goes_from_the_skin_through_the_predictor_alone():
    used = {second: first for first, second, when in ARROWS if when == USE}
    way = ["touch"]
    while way[-1] in used:
        way.append(used[way[-1]])
    assert way == ["touch", "predictor", "voltages", "skin"] and len(used) == 3
    assert [name for name in way if BLOCKS[name].kind == NETWORK] == ["predictor"]


def test_files_are_written_with_every_block_and_arrow(tmp_path):
    files = [tmp_path / f"figure.{kind}" for kind in ("svg", "png", "csv")]
    figure_2.write(*files)
    assert len(pd.read_csv(files[2])) == len(ARROWS)
    texts = {text.get_text() for text in figure_2.draw().axes[0].texts}
    assert {block.text for block in BLOCKS.values()} <= texts
