# A job runs where its provenance would be another, or a product is missing; no time of a file and
# nothing that Snakemake remembers is a reason. Snakemake is told so by one more input of every job,
# its planned provenance, which is newer than the products then; and by `ancient`, the flag of all
# inputs of a job that need not run.
from functools import cache

from snakemake.io import is_flagged
from snakemake.output_index import OutputIndex

OURS = {maker for maker in workflow.rules if maker.name not in OTHERS and maker.script}
# What has no fingerprint is made anew on request alone.
RECORDED = {maker for maker in OURS if not IN_STORAGE and "code" in maker.params.keys()}
EXPAND_INPUT = {maker: maker.expand_input for maker in OURS}
PATHS, INPUTS, PROVENANCES, STALE = {}, {}, {}, {}  # of jobs of this plan, by rule and wildcards


def key_of(maker, wildcards):
    """What tells a job from all others of this plan."""
    return maker.name, *sorted(wildcards.items())


def planned_path(maker, wildcards):
    """The path of the planned provenance of a job, which is named as its log."""
    job = key_of(maker, wildcards)
    if job not in PATHS:
        log = maker.log[0].apply_wildcards(wildcards)
        name = log.rpartition("logs/")[2].removesuffix(".log")
        PATHS[job] = provenance.planned_path(name)
    return PATHS[job]


def inputs_of(maker, wildcards):
    """The inputs of a job, as Snakemake expands them."""
    job = key_of(maker, wildcards)
    if job not in INPUTS:
        INPUTS[job] = EXPAND_INPUT[maker](wildcards)
    return INPUTS[job]


def provenance_of(maker, wildcards):
    """The provenance of what a job makes."""
    job = key_of(maker, wildcards)
    if job not in PROVENANCES:
        PROVENANCES[job] = ""  # a param itself, while all are listed
        files = inputs_of(maker, wildcards)[0]
        products = maker.expand_output(wildcards)[0]
        values = dict(maker.expand_params(wildcards, files, products, None)[0].items())
        code = values.pop("code", "")
        values.pop("provenance", None)
        if code:
            provenance.plan_code(code, fingerprinted(code))
        planned = planned_path(maker, wildcards)
        PROVENANCES[job] = provenance.text(
            maker.name,
            values,
            code,
            {str(file): digest_of(file) for file in files if file != planned},
            map(str, products),
        )
    return PROVENANCES[job]


def digest_of(file):
    """The digest of the provenance of a file, planned or, where no rule makes it any more, recorded;
    of a file that none has made, of its bytes. What another workflow makes has none."""
    for maker in makers_of(file) & OURS:
        return provenance.digest(provenance_of(maker, maker.get_wildcards(file)))
    if makers_of(file):
        return "made by another workflow"
    return provenance.recorded_digests().get(file) or provenance.digest_of_file(file)


@cache
def makers_of(file):
    return output_index().match_producers(file)


@cache
def output_index():
    return OutputIndex(workflow.rules)


def is_stale(maker, wildcards):
    """Whether what a job has made is of another provenance than planned, or anything that led to it:
    on a cluster a job may take code that was edited after those before it had begun."""
    job = key_of(maker, wildcards)
    if job not in STALE:
        led = inputs_of(maker, wildcards)[0]
        before = [(rule, rule.get_wildcards(f)) for f in led for rule in makers_of(f) & RECORDED]
        planned, text = planned_path(maker, wildcards), provenance_of(maker, wildcards)
        STALE[job] = provenance.is_other(planned, text) or any(is_stale(*each) for each in before)
    return STALE[job]


def is_made(maker, wildcards):
    """Whether the products of a job are there, of the provenance that is planned by this."""
    products = maker.expand_output(wildcards)[0]
    lasting = [str(file) for file in products if not is_flagged(file, "temp")]
    planned, text = planned_path(maker, wildcards), provenance_of(maker, wildcards)
    return provenance.plan(planned, text, lasting, is_stale(maker, wildcards))


def planned_by(maker):
    """An input function: the planned provenance of a job."""
    return lambda wildcards: planned_path(maker, dict(wildcards.items()))


def text_by(maker):
    """A param that Snakemake does not track, as it takes the input: the provenance of a job."""
    return lambda wildcards, input: provenance_of(maker, dict(wildcards.items()))


def expand_input_of(maker):
    """In place of Snakemake's: the inputs of a job that need not run are `ancient`, but for those
    that have no record."""

    def expand_input(wildcards, groupid=None):
        expanded = inputs_of(maker, wildcards)
        if workflow.is_main_process:
            made = is_made(maker, wildcards)
            # Snakemake may have listed the folder before.
            workflow.iocache.exists_local[planned_path(maker, wildcards)] = True
            for file in expanded[0]:
                file.flags["ancient"] = made and makers_of(file) <= RECORDED
        return expanded

    return expand_input


for maker in RECORDED:
    maker.set_input(provenance=planned_by(maker))
    maker.set_params(provenance=text_by(maker))
    maker.expand_input = expand_input_of(maker)

if workflow.is_main_process:
    keep(provenance.PARSED)
