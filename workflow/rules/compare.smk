rule compare:
    input:
        a="results/recordings/{a}.parquet",
        b="results/recordings/{b}.parquet",
    output:
        json="results/diagnosis/compare/{a}-vs-{b}/comparison.json",
        page=report(
            "results/diagnosis/compare/{a}-vs-{b}/comparison.html",
            caption="../report/comparison.rst",
            category="Diagnosis",
            labels={"recording": "{a}, {b}", "shows": "what changed between them"},
        ),
    log:
        "logs/compare/{a}-vs-{b}.log",
    benchmark:
        "benchmarks/compare/{a}-vs-{b}.tsv"
    wildcard_constraints:
        a="|".join(config["recordings"]),
        b="|".join(config["recordings"]),
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=20,
    params:
        seed=config["seed"],
        code=fingerprint("eitskin.diagnose.compare"),
    message:
        "Comparing {wildcards.a} and {wildcards.b}: what is shared and what changed"
    script:
        "../scripts/compare.py"


rule compare_sessions:
    input:
        "results/recordings/{recording}.parquet",
    output:
        json="results/diagnosis/{recording}/sessions.json",
        page=report(
            "results/diagnosis/{recording}/sessions.html",
            caption="../report/sessions.rst",
            category="Diagnosis",
            labels={"recording": "{recording}", "shows": "what changed between sessions"},
        ),
    log:
        "logs/compare_sessions/{recording}.log",
    benchmark:
        "benchmarks/compare_sessions/{recording}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        seed=config["seed"],
        code=fingerprint("eitskin.diagnose.compare"),
    message:
        "Comparing the sessions of {wildcards.recording}: what is shared and what changed"
    script:
        "../scripts/compare_sessions.py"
