SHOWN_BLOCK = "demo"
JUDGED = {
    name: fingerprint(f"concealed.{name}")
    for name in ("baselines", "oracle", "page", "case_figure")
}


for block, part in BLOCKS.items():
    for number, cases in enumerate(case_batches(part["cases"], CONCEALED["batch"])):

        rule:
            name:
                f"baselines_{block}_{number}"
            input:
                commitments=f"{PUBLIC}/{block}/commitments.json",
                recordings=expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases),
                queries=expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases),
            output:
                update(expand(f"{PUBLIC}/{block}/baselines/{{case}}.json", case=cases)),
            log:
                f"logs/baselines/{block}/{number:03d}.log",
            benchmark:
                f"benchmarks/baselines/{block}/{number:03d}.tsv"
            conda:
                "../../envs/concealed.yaml"
            threads: 1
            resources:
                mem_mb=3000,
                runtime=60,
            params:
                cases=cases,
                seed=config["seed"],
                code=JUDGED["baselines"],
            message:
                f"What others make of concealed recordings: {block}, batch {number}"
            script:
                "../scripts/baselines.py"

        rule:
            name:
                f"oracle_{block}_{number}"
            input:
                opened=f"{PUBLIC}/{block}/opened/opened.json",
                recordings=expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases),
                queries=expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases),
                verdicts=expand(f"{PUBLIC}/{block}/verdicts/{{case}}/diagnosis.json", case=cases),
            output:
                update(expand(f"{PUBLIC}/{block}/oracle/{{case}}.json", case=cases)),
            log:
                f"logs/oracle/{block}/{number:03d}.log",
            benchmark:
                f"benchmarks/oracle/{block}/{number:03d}.tsv"
            conda:
                "../../envs/concealed.yaml"
            threads: 1
            resources:
                mem_mb=3000,
                runtime=60,
            params:
                cases=cases,
                seed=config["seed"],
                code=JUDGED["oracle"],
            message:
                f"Fitting what was concealed: {block}, batch {number}"
            script:
                "../scripts/oracle.py"


rule concealed_score:
    input:
        opened="results/concealed/{block}/opened/opened.json",
        verdicts=of_every_case("results/concealed/{block}/verdicts/{case}/diagnosis.json"),
        baselines=of_every_case("results/concealed/{block}/baselines/{case}.json"),
        oracle=of_every_case("results/concealed/{block}/oracle/{case}.json"),
    output:
        tables=multiext(
            "results/concealed/{block}/score/",
            "score.csv",
            "cases.csv",
            "baselines.csv",
        ),
        page=report(
            "results/concealed/{block}/score/score.md",
            caption="../report/concealed_score.rst",
            category="Concealed effects",
            labels={"block": "{block}", "shows": "score, by the table"},
        ),
        figures=[
            report(
                f"results/concealed/{{block}}/score/{name}.{suffix}",
                caption=f"../report/concealed_{name}.rst",
                category="Concealed effects",
                labels={"block": "{block}", "shows": f"{shows}, {suffix.upper()}"},
            )
            for name, shows in {
                "accuracy": "right names against the gap",
                "misfit_closed": "misfit closed, by method",
                "confusion": "concealed and called",
                "reliability": "probability of something else",
                "p_values": "p-values where nothing is concealed",
            }.items()
            for suffix in ("svg", "png", "csv")
        ],
    log:
        "logs/concealed_score/{block}.log",
    benchmark:
        "benchmarks/concealed_score/{block}.tsv"
    wildcard_constraints:
        block="|".join(BLOCKS),
    conda:
        "../../envs/concealed.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=15,
    params:
        code=JUDGED["page"],
    message:
        "Scoring the opened block {wildcards.block}"
    script:
        "../scripts/concealed_score.py"


rule concealed_case:
    input:
        schema="workflow/schemas/diagnosis.schema.yaml",
        score=f"results/concealed/{SHOWN_BLOCK}/score/score.csv",
    output:
        **{
            suffix: report(
                f"results/concealed/{SHOWN_BLOCK}/score/concealed_case.{suffix}",
                caption="../report/concealed_case.rst",
                category="Concealed effects",
                labels={"block": SHOWN_BLOCK, "shows": f"one case, {suffix.upper()}"},
            )
            for suffix in ("svg", "png", "csv")
        },
    log:
        "logs/concealed_case.log",
    benchmark:
        "benchmarks/concealed_case.tsv"
    conda:
        "../../envs/concealed.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=JUDGED["case_figure"],
    message:
        "Drawing one concealed case"
    script:
        "../scripts/concealed_case.py"
