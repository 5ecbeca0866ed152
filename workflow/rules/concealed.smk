CODE = {name: fingerprint(f"concealed.{name}") for name in ("conceal", "verdicts")}


for block, part in BLOCKS.items():
    for number, cases in enumerate(case_batches(part["cases"], CONCEALED["batch"])):

        rule:
            name:
                f"conceal_{block}_{number}"
            output:
                recordings=update(
                    expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases)
                ),
                queries=update(expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases)),
                truths=update(expand(f"{TRUTHS}/{block}/{{case}}.sealed", case=cases)),
                commitments=f"{PUBLIC}/{block}/batches/{number:03d}.json",
            log:
                f"logs/conceal/{block}/{number:03d}.log",
            benchmark:
                f"benchmarks/conceal/{block}/{number:03d}.tsv"
            conda:
                "../../envs/concealed.yaml"
            threads: 1
            resources:
                mem_mb=3000,
                runtime=60,
            params:
                block=block,
                cases=cases,
                seed=part["seed"],
                sizes={
                    "cases": part["cases"],
                    "frames": CONCEALED["frames"],
                    "query_frames": CONCEALED["query_frames"],
                },
                code=CODE["conceal"],
            message:
                f"Concealing effects in recordings: {block}, batch {number}"
            script:
                "../scripts/conceal.py"

        rule:
            name:
                f"verdicts_{block}_{number}"
            input:
                schema="workflow/schemas/diagnosis.schema.yaml",
                commitments=f"{PUBLIC}/{block}/commitments.json",
                recordings=expand(f"{PUBLIC}/{block}/recordings/{{case}}.parquet", case=cases),
                queries=expand(f"{PUBLIC}/{block}/queries/{{case}}.parquet", case=cases),
            output:
                update(expand(f"{PUBLIC}/{block}/verdicts/{{case}}/diagnosis.json", case=cases)),
            log:
                f"logs/verdicts/{block}/{number:03d}.log",
            benchmark:
                f"benchmarks/verdicts/{block}/{number:03d}.tsv"
            conda:
                "../../envs/concealed.yaml"
            threads: 1
            resources:
                mem_mb=3000,
                runtime=120,
            params:
                cases=cases,
                seed=config["seed"],
                code=CODE["verdicts"],
            message:
                f"Diagnosing concealed recordings: {block}, batch {number}"
            script:
                "../scripts/verdicts.py"


rule commit_truths:
    input:
        lambda wildcards: expand(
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
        "benchmarks/commit_truths/{block}.tsv"
    wildcard_constraints:
        block="|".join(BLOCKS),
    conda:
        "../../envs/concealed.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        seed=lambda wildcards: BLOCKS[wildcards.block]["seed"],
        code=fingerprint("concealed.sealing"),
    message:
        "Committing to recordings and truths: {wildcards.block}"
    script:
        "../scripts/commit_truths.py"


rule seal_verdicts:
    input:
        of_every_case("results/concealed/{block}/verdicts/{case}/diagnosis.json"),
        of_every_case("results/concealed/{block}/baselines/{case}.json"),
        commitments="results/concealed/{block}/commitments.json",
    output:
        "results/concealed/{block}/seal.json",
    log:
        "logs/seal_verdicts/{block}.log",
    benchmark:
        "benchmarks/seal_verdicts/{block}.tsv"
    wildcard_constraints:
        block="|".join(BLOCKS),
    conda:
        "../../envs/concealed.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        code=fingerprint("concealed.sealing"),
    message:
        "Sealing the verdicts: {wildcards.block}"
    script:
        "../scripts/seal_verdicts.py"


rule open_truths:
    input:
        seal="results/concealed/{block}/seal.json",
        commitments="results/concealed/{block}/commitments.json",
        key="results/truths/{block}/key.json",
        truths=of_every_case("results/truths/{block}/{case}.sealed"),
    output:
        "results/concealed/{block}/opened/opened.json",
    log:
        "logs/open_truths/{block}.log",
    benchmark:
        "benchmarks/open_truths/{block}.tsv"
    wildcard_constraints:
        block="|".join(BLOCKS),
    conda:
        "../../envs/concealed.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("concealed.sealing"),
    message:
        "Opening the truths against the seal: {wildcards.block}"
    script:
        "../scripts/open_truths.py"


rule concealed:
    input:
        f"{PUBLIC}/{CONCEALED['block']}/score/score.md",


rule concealed_final:
    input:
        f"{PUBLIC}/final/score/score.md",
