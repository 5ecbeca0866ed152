include: "concealed_plan.smk"


# Of what `make` does these come first: what they end in is worth looking at while the rest goes on.


for block, number, cases in numbered(UNSEALED):

    rule:
        """Recordings with concealed effects, a batch."""
        name:
            f"conceal_{block}_{number}"
        output:
            recordings=update(expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases)),
            queries=update(expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases)),
            truths=update(expand(f"{TRUTHS}/{block}/{{case}}.sealed", case=cases)),
            commitments=f"{PUBLIC}/{block}/batches/{number:03d}.json",
        log:
            f"logs/conceal/{block}/{number:03d}.log",
        benchmark:
            f"logs/benchmarks/conceal/{block}/{number:03d}.tsv"
        priority: 1
        conda:
            "../../envs/proof.yaml"
        threads: 1
        resources:
            mem_mb=3000,
            runtime=60,
        params:
            **drawn(block),
            block=block,
            cases=cases,
            real=REAL_SETS,
            code=fingerprint("conceal", CATALOGUE + IMPORTERS),
        message:
            f"Concealing effects in recordings: {block}, batch {number}"
        script:
            "../scripts/conceal.py"

    rule:
        """Verdicts on concealed recordings, a batch."""
        name:
            f"verdicts_{block}_{number}"
        input:
            schema=ancient(local(SCHEMA)),
            commitments=f"{PUBLIC}/{block}/commitments.json",
            recordings=expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases),
            queries=expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases),
        output:
            verdicts=update(directory(expand(f"{PUBLIC}/{block}/verdicts/{{case}}", case=cases))),
            seconds=update(expand(f"{PUBLIC}/{block}/seconds/{{case}}.json", case=cases)),
        log:
            f"logs/verdicts/{block}/{number:03d}.log",
        benchmark:
            f"logs/benchmarks/verdicts/{block}/{number:03d}.tsv"
        priority: 1
        conda:
            "../../envs/proof.yaml"
        threads: 1
        resources:
            mem_mb=3000,
            runtime=120,
        params:
            cases=cases,
            seed=config["seed"],
            code=fingerprint("verdicts", CATALOGUE, [SCHEMA]),
        message:
            f"Diagnosing concealed recordings: {block}, batch {number}"
        script:
            "../scripts/verdicts.py"

    rule:
        """What other methods make of concealed recordings, a batch."""
        name:
            f"baselines_{block}_{number}"
        input:
            commitments=f"{PUBLIC}/{block}/commitments.json",
            recordings=expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases),
            queries=expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases),
        output:
            update(expand(f"{PUBLIC}/{block}/baselines/{{case}}.json", case=cases)),
            update(expand(f"{PUBLIC}/{block}/baselines/{{case}}.npz", case=cases)),
        log:
            f"logs/baselines/{block}/{number:03d}.log",
        benchmark:
            f"logs/benchmarks/baselines/{block}/{number:03d}.tsv"
        priority: 1
        conda:
            "../../envs/proof.yaml"
        threads: 1
        resources:
            mem_mb=3000,
            runtime=60,
        params:
            cases=cases,
            seed=config["seed"],
            code=fingerprint("baselines", CATALOGUE),
        message:
            f"What others make of concealed recordings: {block}, batch {number}"
        script:
            "../scripts/baselines.py"


for block, number, cases in numbered(UNFITTED):

    rule:
        """Fits of what was concealed, a batch."""
        name:
            f"oracle_{block}_{number}"
        input:
            opened=f"{PUBLIC}/{block}/opened",
            recordings=expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases),
            queries=expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases),
            verdicts=expand(f"{PUBLIC}/{block}/verdicts/{{case}}", case=cases),
        output:
            update(expand(f"{PUBLIC}/{block}/oracle/{{case}}.json", case=cases)),
        log:
            f"logs/oracle/{block}/{number:03d}.log",
        benchmark:
            f"logs/benchmarks/oracle/{block}/{number:03d}.tsv"
        priority: 1
        conda:
            "../../envs/proof.yaml"
        threads: 1
        resources:
            mem_mb=3000,
            runtime=60,
        params:
            cases=cases,
            seed=config["seed"],
            code=fingerprint("oracle", CATALOGUE + IMPORTERS),
        message:
            f"Fitting what was concealed: {block}, batch {number}"
        script:
            "../scripts/oracle.py"


rule commit_truths:
    """Commitments to the recordings and truths of a block."""
    input:
        batches=lambda wildcards: expand(
            "results/concealed/{block}/batches/{number:03d}.json",
            block=wildcards.block,
            number=range(len(case_batches(BLOCKS[wildcards.block]["cases"], CONCEALED["batch"]))),
        ),
    output:
        commitments=update("results/concealed/{block}/commitments.json"),
        key=update("results/truths/{block}/key.json"),
    log:
        "logs/commit_truths/{block}.log",
    benchmark:
        "logs/benchmarks/commit_truths/{block}.tsv"
    wildcard_constraints:
        block=any_of(UNSEALED),
    priority: 1
    localrule: True
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        seed=lambda wildcards: BLOCKS[wildcards.block]["seed"],
        code=fingerprint("commit_truths"),
    message:
        "Committing to recordings and truths: {wildcards.block}"
    script:
        "../scripts/commit_truths.py"


rule seal_verdicts:
    """Seal over the verdicts of a block."""
    input:
        of_every_case(*COMMITTED, *SEALED),
        commitments="results/concealed/{block}/commitments.json",
    output:
        "results/concealed/{block}/seal.json",
    log:
        "logs/seal_verdicts/{block}.log",
    benchmark:
        "logs/benchmarks/seal_verdicts/{block}.tsv"
    wildcard_constraints:
        block=any_of(UNSEALED),
    priority: 1
    localrule: True
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        code=fingerprint("seal_verdicts"),
    message:
        "Sealing the verdicts: {wildcards.block}"
    script:
        "../scripts/seal_verdicts.py"


rule open_truths:
    """Truths of a block, opened against the seal."""
    input:
        of_every_case(*COMMITTED, *SEALED),
        seal="results/concealed/{block}/seal.json",
        commitments="results/concealed/{block}/commitments.json",
        key="results/truths/{block}/key.json",
        truths=of_every_case("results/truths/{block}/{case}.sealed"),
    output:
        directory("results/concealed/{block}/opened"),
    log:
        "logs/open_truths/{block}.log",
    benchmark:
        "logs/benchmarks/open_truths/{block}.tsv"
    wildcard_constraints:
        block=any_of(UNOPENED),
    priority: 1
    localrule: True
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("open_truths"),
    message:
        "Opening the truths against the seal: {wildcards.block}"
    script:
        "../scripts/open_truths.py"


SCORE_FIGURES = {
    "accuracy": "right names against the gap",
    "misfit_closed": "misfit closed, by method",
    "confusion": "concealed and called",
    "reliability": "probability of something else",
    "p_values": "p-values where nothing is concealed",
}


rule concealed_score:
    """Score of an opened block."""
    input:
        of_every_case(*JUDGED),
        opened="results/concealed/{block}/opened",
        seconds=seconds_of,
    output:
        tables=expand(
            "results/concealed/{{block}}/score/{name}.csv",
            name=["score", "cases", "baselines", *SCORE_FIGURES],
        ),
        page=report(
            "results/concealed/{block}/score/score.md",
            caption="../report/concealed_score.rst",
            category="2 Concealed effects",
            labels={"block": "{block}", "shows": "score, by the table"},
        ),
    log:
        "logs/concealed_score/{block}.log",
    benchmark:
        "logs/benchmarks/concealed_score/{block}.tsv"
    wildcard_constraints:
        block=any_of(IN_USE),
    priority: 1
    group:
        "score"
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=15,
    params:
        code=fingerprint("concealed_score", CATALOGUE),
    message:
        "Scoring the opened block {wildcards.block}"
    script:
        "../scripts/concealed_score.py"


rule concealed_figures:
    """Figures of a block's score."""
    input:
        tables=expand("results/concealed/{{block}}/score/{name}.csv", name=SCORE_FIGURES),
    output:
        [
            report(
                f"results/concealed/{{block}}/score/{name}.svg",
                caption=f"../report/concealed_{name}.rst",
                category="2 Concealed effects",
                labels={"block": "{block}", "shows": shows},
            )
            for name, shows in SCORE_FIGURES.items()
        ],
        images=expand("results/concealed/{{block}}/score/{name}.png", name=SCORE_FIGURES),
    log:
        "logs/concealed_figures/{block}.log",
    benchmark:
        "logs/benchmarks/concealed_figures/{block}.tsv"
    priority: 1
    group:
        "score"
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("block_figures"),
    message:
        "Drawing the score of the block {wildcards.block}"
    script:
        "../scripts/block_figures.py"


rule concealed_case:
    """Page of one concealed case, its truth beside the verdict."""
    input:
        schema=ancient(local(SCHEMA)),
        score=f"results/concealed/{DEMO}/score/score.csv",
        opened=f"results/concealed/{DEMO}/opened",
        judged=expand(JUDGED, block=DEMO, case=case_names(BLOCKS[DEMO]["cases"])),
    output:
        svg=report(
            f"results/concealed/{DEMO}/score/concealed_case.svg",
            caption="../report/concealed_case.rst",
            category="2 Concealed effects",
            labels={"block": DEMO, "shows": "one case"},
        ),
        png=f"results/concealed/{DEMO}/score/concealed_case.png",
        csv=f"results/concealed/{DEMO}/score/concealed_case.csv",
    log:
        "logs/concealed_case.log",
    benchmark:
        "logs/benchmarks/concealed_case.tsv"
    priority: 1
    group:
        "score"
    conda:
        "../../envs/proof.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("concealed_case", CATALOGUE, [SCHEMA]),
    message:
        "Drawing one concealed case"
    script:
        "../scripts/concealed_case.py"


SCORED = [
    "results/concealed/{block}/score/score.md",
    *(
        f"results/concealed/{{block}}/score/{name}.{kind}"
        for name in SCORE_FIGURES
        for kind in ("svg", "png")
    ),
]


rule concealed:
    """Scores and figures of all blocks of concealed cases in use."""
    input:
        expand(SCORED, block=CONCEALED["block"]),


rule concealed_demo:
    """Score and one case of the block that demonstrates."""
    input:
        expand(SCORED, block=DEMO),
        rules.concealed_case.output,
