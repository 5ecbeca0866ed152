rule diagnose:
    input:
        schema=workflow.source_path("../schemas/diagnosis.schema.yaml"),
        recording=rules.import_recording.output[0],
        query=branch(
            lookup(dpath="recordings/{recording}/query", within=config, default=None),
            then=lookup(dpath="recordings/{recording}/query", within=config, default=None),
        ),
    output:
        diagnosis="results/diagnosis/{recording}/diagnosis.json",
        effects="results/diagnosis/{recording}/effects.yaml",
        predicted=branch(
            lookup(dpath="recordings/{recording}/query", within=config, default=None),
            then="results/diagnosis/{recording}/predicted.parquet",
        ),
        evidence=expand(
            "results/diagnosis/{{recording}}/evidence/{file}",
            file=EVIDENCE,
        ),
    log:
        "logs/diagnose/{recording}.log",
    benchmark:
        "benchmarks/diagnose/{recording}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=10,
    params:
        seed=config["seed"],
        code=fingerprint("eitskin.diagnose.diagnose"),
    message:
        "Diagnosing {wildcards.recording}: where simulation and recording differ, and why"
    script:
        "../scripts/diagnose.py"
