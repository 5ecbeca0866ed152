from pathlib import Path

from snakemake.logging import logger

from proof.blocks import case_batches, case_names
from proof.changed import since_sealed
from proof.real_sets import listed

CONCEALED = config["concealed"]
BLOCKS = CONCEALED["blocks"]
PUBLIC, TRUTHS = "results/concealed", "results/truths"
DEMO = "demo"  # a part of `all`
IN_USE = sorted({DEMO, CONCEALED["block"]})  # rules are made for these alone


def before(file):
    """The blocks in use that lack a file, or one of every case where its name holds {case}: what leads
    to it is not planned again once it is there, for who has seen the truths draws, diagnoses and fits
    nothing anew."""

    def there(block):
        names = case_names(BLOCKS[block]["cases"])
        return all(Path(PUBLIC, block, file.format(case=case)).exists() for case in names)

    return [block for block in IN_USE if not there(block)]


UNSEALED = before("seal.json")
UNOPENED = before("opened/opened.json")
UNFITTED = before("oracle/{case}.json")  # by the oracle
# What some cases are made of.
REAL_SETS = [str(path) for path in listed().values() if path.exists()]


def drawn(block):
    """What the cases of a block are drawn by."""
    own = BLOCKS[block]
    sizes = {key: CONCEALED[key] for key in ("frames", "query_frames")}
    return {
        "seed": own["seed"],
        "sizes": {"cases": own["cases"], **sizes, "rig": own.get("rig", False)},
    }


# Who edits what a sealed block was made of is told that it stays.
for block in set(IN_USE) - set(UNSEALED) if workflow.is_main_process else ():
    if changed := since_sealed(Path(PUBLIC, block), drawn(block)):
        logger.warning(
            f"The concealed cases {block} are sealed and stay as they are; changed since: "
            f"{', '.join(changed[:5])}{', …' if changed[5:] else ''}. "
            f"To begin anew: rm -r {PUBLIC}/{block} {TRUTHS}/{block}"
        )


CASE = f"{PUBLIC}/{{block}}/{{part}}/{{case}}"
# Of every case: what the commitments are of, and what the seal is over.
COMMITTED = expand(f"{CASE}.parquet", part=["recordings", "queries"], allow_missing=True)
SEALED = [
    *expand(CASE, part="verdicts", allow_missing=True),
    *expand(f"{CASE}.{{kind}}", part="baselines", kind=["json", "npz"], allow_missing=True),
]
# What a score is made of, besides what was opened.
JUDGED = [
    *COMMITTED,
    *SEALED,
    *expand(f"{CASE}.json", part="oracle", allow_missing=True),
    f"{PUBLIC}/{{block}}/commitments.json",
    f"{PUBLIC}/{{block}}/seal.json",
]


def of_every_case(*templates):
    """An input function: files of every case of a block."""

    def files(wildcards):
        names = case_names(BLOCKS[wildcards.block]["cases"])
        return expand(templates, block=wildcards.block, case=names)

    return files


def seconds_of(wildcards):
    """What the diagnoses of a block took; of one that is sealed what is left of it, as no seal is over
    that."""
    files = of_every_case(f"{PUBLIC}/{{block}}/seconds/{{case}}.json")(wildcards)
    return [file for file in files if wildcards.block in UNSEALED or Path(file).exists()]


def numbered(blocks):
    """(block, number of the batch, its cases) of blocks."""
    return [
        (block, number, cases)
        for block in blocks
        for number, cases in enumerate(case_batches(BLOCKS[block]["cases"], CONCEALED["batch"]))
    ]
