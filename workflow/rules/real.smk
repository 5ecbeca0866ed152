rule held_out_pairs:
    """Geometries of a tank judged on reciprocal pairs left out."""
    input:
        rules.import_recording.output[0],
    output:
        table="results/diagnosis/{recording}/held_out_pairs.csv",
        sentence="results/diagnosis/{recording}/held_out_pairs.txt",
    log:
        "logs/held_out_pairs/{recording}.log",
    benchmark:
        "logs/benchmarks/held_out_pairs/{recording}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        seed=config["seed"],
        code=fingerprint("held_out_pairs"),
    message:
        "Judging geometries of {wildcards.recording} on reciprocal pairs left out"
    script:
        "../scripts/held_out_pairs.py"


rule tanks:
    """Table of what geometry explains of tanks."""
    input:
        tables=expand("results/diagnosis/{recording}/held_out_pairs.csv", recording=config["tanks"]),
    output:
        "results/diagnosis/tanks.csv",
    log:
        "logs/tanks.log",
    benchmark:
        "logs/benchmarks/tanks.tsv"
    localrule: True
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        code=fingerprint("tanks"),
    message:
        "Collecting what geometry explains of the tanks"
    script:
        "../scripts/tanks.py"


rule diagnosed:
    """Table of what the diagnosis says of recordings."""
    input:
        diagnoses=expand(
            "results/diagnosis/{recording}/diagnosis.json", recording=config["diagnoses"]
        ),
        recordings=expand("results/recordings/{recording}.parquet", recording=config["diagnoses"]),
    output:
        "results/diagnosis/diagnosed.csv",
    log:
        "logs/diagnosed.log",
    benchmark:
        "logs/benchmarks/diagnosed.tsv"
    localrule: True
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("diagnosed", CATALOGUE),
    message:
        "Collecting what the diagnosis says of recordings"
    script:
        "../scripts/diagnosed.py"
