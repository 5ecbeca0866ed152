rule compare:
    input:
        a="results/recordings/{a}.parquet",
        b="results/recordings/{b}.parquet",
    output:
        "results/diagnosis/compare/{a}-vs-{b}/comparison.json",
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
        code=fingerprint("eitskin.diagnose.comparison.compare"),
    message:
        "Comparing {wildcards.a} and {wildcards.b}: what is shared and what changed"
    script:
        "../scripts/compare.py"


rule compare_sessions:
    input:
        "results/recordings/{recording}.parquet",
    output:
        "results/diagnosis/{recording}/sessions.json",
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
        code=fingerprint("eitskin.diagnose.comparison.compare"),
    message:
        "Comparing the sessions of {wildcards.recording}: what is shared and what changed"
    script:
        "../scripts/compare_sessions.py"


rule comparison_page:
    input:
        rules.compare.output[0],
    output:
        report(
            "results/diagnosis/compare/{a}-vs-{b}/comparison.html",
            caption="../report/comparison.rst",
            category="Diagnosis",
            labels={"recording": "{a}, {b}", "shows": "what changed between them"},
        ),
    log:
        "logs/comparison_page/{a}-vs-{b}.log",
    benchmark:
        "benchmarks/comparison_page/{a}-vs-{b}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        code=fingerprint("eitskin.diagnose.report.comparison_page"),
    message:
        "Reporting what changed between {wildcards.a} and {wildcards.b}"
    script:
        "../scripts/comparison_page.py"


use rule comparison_page as sessions_page with:
    input:
        rules.compare_sessions.output[0],
    output:
        report(
            "results/diagnosis/{recording}/sessions.html",
            caption="../report/sessions.rst",
            category="Diagnosis",
            labels={"recording": "{recording}", "shows": "what changed between sessions"},
        ),
    log:
        "logs/sessions_page/{recording}.log",
    benchmark:
        "benchmarks/sessions_page/{recording}.tsv"
    message:
        "Reporting what changed between sessions of {wildcards.recording}"
