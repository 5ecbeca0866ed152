rule record_dataset:
    """Data set of a recording: touches less untouched frames."""
    input:
        recording=rules.import_recording.output[0],
        check=rules.check.output[0],
    output:
        "results/datasets/{recording}.parquet",
    log:
        "logs/record_dataset/{recording}.log",
    benchmark:
        "logs/benchmarks/record_dataset/{recording}.tsv"
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        code=fingerprint("record_dataset"),
    message:
        "Subtracting the untouched frames of {wildcards.recording} from its touches"
    script:
        "../scripts/record_dataset.py"


rule split:
    """Parts of a data set to train, validate and test."""
    input:
        "results/datasets/{dataset}.parquet",
    output:
        "results/splits/{dataset}/{split}.parquet",
    log:
        "logs/split/{dataset}/{split}.log",
    benchmark:
        "logs/benchmarks/split/{dataset}/{split}.tsv"
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("split"),
    message:
        "Splitting {wildcards.dataset} by {wildcards.split}"
    script:
        "../scripts/split.py"
