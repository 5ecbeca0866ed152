SCHEMA = own("workflow/eitskin/diagnose/diagnosis.schema.yaml")
# What a diagnosis rests on, for its report.
EVIDENCE = [
    "residuals.npz",
    "atlas_before.csv",
    "atlas_after.csv",
    "rivals.csv",
    "identifiability.csv",
    "search.csv",
    "decisions.csv",
    "experiment.json",
]
DIAGNOSIS_FIGURES = {
    "electrodes": "ring of electrodes",
    "hidden": "error on readings that decided nothing",
    "residual_matrix": "residual of every channel",
    "misfit_force": "misfit against force",
    "misfit_time": "misfit against time",
    "misfit_place": "misfit over the skin",
    "last": "misfit of what decided nothing",
    "rivals": "knock-out and rivals",
    "next_experiment": "next experiment",
}
WITH_QUERY = [name for name, item in config["recordings"].items() if "query" in item]
WITHOUT_QUERY = [name for name, item in config["recordings"].items() if "query" not in item]


rule diagnose:
    """Diagnosis of a recording: where simulation and recording differ, and why."""
    input:
        schema=ancient(local(SCHEMA)),
        recording=rules.import_recording.output[0],
        usable=rules.check.output[0],
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
        "logs/benchmarks/diagnose/{recording}.tsv"
    wildcard_constraints:
        recording=any_of(WITHOUT_QUERY),
    group:
        "diagnosis"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=4096,  # as many frames as fit in it are diagnosed; more by --set-resources
        runtime=10,
    params:
        name="{recording}",
        seed=lookup(dpath="seed", within=config),
        code=fingerprint("diagnose", CATALOGUE, [SCHEMA]),
    message:
        "Diagnosing {wildcards.recording}: where simulation and recording differ, and why"
    script:
        "../scripts/diagnose.py"


use rule diagnose as diagnose_with_query with:
    input:
        schema=ancient(local(SCHEMA)),
        recording=rules.import_recording.output[0],
        usable=rules.check.output[0],
        query=of_recording("query"),
    output:
        diagnosis="results/diagnosis/{recording}/diagnosis.json",
        effects="results/diagnosis/{recording}/effects.yaml",
        predicted="results/diagnosis/{recording}/predicted.parquet",
        evidence=expand(
            "results/diagnosis/{{recording}}/evidence/{file}",
            file=EVIDENCE,
        ),
    wildcard_constraints:
        recording=any_of(WITH_QUERY),


rule diagnosis_report:
    """Report of a diagnosis, one page."""
    input:
        schema=ancient(local(SCHEMA)),
        recording=rules.import_recording.output[0],
        diagnosis="results/diagnosis/{recording}/diagnosis.json",
        effects="results/diagnosis/{recording}/effects.yaml",
        predicted=branch(
            of_recording("query"),
            then="results/diagnosis/{recording}/predicted.parquet",
        ),
        evidence=expand(
            "results/diagnosis/{{recording}}/evidence/{file}",
            file=EVIDENCE,
        ),
    output:
        html=report(
            "results/diagnosis/{recording}/report.html",
            caption="../report/diagnosis.rst",
            category="3 Diagnosis",
            labels={"recording": "{recording}", "shows": "the whole report"},
        ),
        figures=[
            report(
                f"results/diagnosis/{{recording}}/figures/{figure}.svg",
                caption=f"../report/{figure}.rst",
                category="3 Diagnosis",
                labels={"recording": "{recording}", "shows": shows},
            )
            for figure, shows in DIAGNOSIS_FIGURES.items()
        ],
        images=expand(
            "results/diagnosis/{{recording}}/figures/{figure}.png", figure=DIAGNOSIS_FIGURES
        ),
    log:
        "logs/diagnosis_report/{recording}.log",
    benchmark:
        "logs/benchmarks/diagnosis_report/{recording}.tsv"
    group:
        "diagnosis"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("diagnosis_report", CATALOGUE, [SCHEMA]),
    message:
        "Reporting the diagnosis of {wildcards.recording}"
    script:
        "../scripts/diagnosis_report.py"


rule compare:
    """Comparison of two recordings: what changed."""
    input:
        a="results/recordings/{a}.parquet",
        b="results/recordings/{b}.parquet",
    output:
        "results/diagnosis/compare/{a}-vs-{b}/comparison.json",
    log:
        "logs/compare/{a}-vs-{b}.log",
    benchmark:
        "logs/benchmarks/compare/{a}-vs-{b}.tsv"
    wildcard_constraints:
        a=any_of(config["recordings"]),
        b=any_of(config["recordings"]),
    group:
        "comparison"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        code=fingerprint("compare", CATALOGUE),
    message:
        "Comparing {wildcards.a} and {wildcards.b}: what changed"
    script:
        "../scripts/compare.py"


rule comparison_page:
    """Report of a comparison, one page."""
    input:
        rules.compare.output[0],
    output:
        report(
            "results/diagnosis/compare/{a}-vs-{b}/comparison.html",
            caption="../report/comparison.rst",
            category="3 Diagnosis",
            labels={"recording": "{a}, {b}", "shows": "what changed between them"},
        ),
    log:
        "logs/comparison_page/{a}-vs-{b}.log",
    benchmark:
        "logs/benchmarks/comparison_page/{a}-vs-{b}.tsv"
    group:
        "comparison"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=500,
        runtime=5,
    params:
        code=fingerprint("comparison_page"),
    message:
        "Reporting what changed between {wildcards.a} and {wildcards.b}"
    script:
        "../scripts/comparison_page.py"
