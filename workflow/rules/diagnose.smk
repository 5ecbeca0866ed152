# What a diagnosis rests on, for its report.
EVIDENCE = [
    "residuals.npz",
    "atlas_before.csv",
    "atlas_after.csv",
    "rivals.csv",
    "identifiability.csv",
    "search.csv",
    "experiment.json",
]
WITH_QUERY = [name for name, item in config["recordings"].items() if "query" in item]
WITHOUT_QUERY = [name for name, item in config["recordings"].items() if "query" not in item]


rule diagnose:
    input:
        schema="workflow/schemas/diagnosis.schema.yaml",
        recording=rules.import_recording.output[0],
    output:
        diagnosis="results/diagnosis/{recording}/diagnosis.json",
        effects="results/diagnosis/{recording}/effects.yaml",
        evidence=expand(
            "results/diagnosis/{{recording}}/evidence/{file}",
            file=EVIDENCE,
        ),
    log:
        "logs/diagnose/{recording}.log",
    benchmark:
        "benchmarks/diagnose/{recording}.tsv"
    wildcard_constraints:
        recording="|".join(WITHOUT_QUERY) or NO_NAME,
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=10,
    params:
        name="{recording}",
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("eitskin.diagnose.diagnosis"),
    message:
        "Diagnosing {wildcards.recording}: where simulation and recording differ, and why"
    script:
        "../scripts/diagnose.py"


use rule diagnose as diagnose_with_query with:
    input:
        schema="workflow/schemas/diagnosis.schema.yaml",
        recording=rules.import_recording.output[0],
        query=lookup(dpath="recordings/{recording}/query", within=config),
    output:
        diagnosis="results/diagnosis/{recording}/diagnosis.json",
        effects="results/diagnosis/{recording}/effects.yaml",
        predicted="results/diagnosis/{recording}/predicted.parquet",
        evidence=expand(
            "results/diagnosis/{{recording}}/evidence/{file}",
            file=EVIDENCE,
        ),
    wildcard_constraints:
        recording="|".join(WITH_QUERY) or NO_NAME,
