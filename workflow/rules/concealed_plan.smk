from pathlib import Path

from concealed.naming import batches as case_batches
from concealed.naming import names as case_names

CONCEALED = config["concealed"]
BLOCKS = CONCEALED["blocks"]
PUBLIC, TRUTHS = "results/concealed", "results/truths"
DEMO = "demo"  # a part of `all`
IN_USE = sorted({DEMO, CONCEALED["block"]})  # rules are made for these alone


def before(file):
    """The blocks in use that lack a file: what leads to it is not planned again once it is there,
    for who has seen the truths draws, diagnoses and fits nothing anew."""
    return [block for block in IN_USE if not Path(PUBLIC, block, file).exists()]


UNSEALED, UNOPENED, UNSCORED = map(before, ("seal.json", "opened", "score/score.md"))


def of_every_case(template):
    """An input function: one file of every case of a block."""

    def files(wildcards):
        names = case_names(BLOCKS[wildcards.block]["cases"])
        return expand(template, block=wildcards.block, case=names)

    return files


def numbered(blocks):
    """(block, number of the batch, its cases) of blocks."""
    return [
        (block, number, cases)
        for block in blocks
        for number, cases in enumerate(case_batches(BLOCKS[block]["cases"], CONCEALED["batch"]))
    ]
