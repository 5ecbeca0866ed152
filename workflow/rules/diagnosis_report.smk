rule diagnosis_report:
    input:
        schema="workflow/schemas/diagnosis.schema.yaml",
        recording=rules.import_recording.output[0],
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
    output:
        html=report(
            "results/diagnosis/{recording}/report.html",
            caption="../report/diagnosis.rst",
            category="Diagnosis",
            labels={"recording": "{recording}", "shows": "the whole report"},
        ),
        figures=[
            report(
                f"results/diagnosis/{{recording}}/figures/{figure}.{suffix}",
                caption=f"../report/{figure}.rst",
                category="Diagnosis",
                labels={"recording": "{recording}", "shows": f"{shows}, {suffix.upper()}"},
            )
            for figure, shows in {
                "electrodes": "ring of electrodes",
                "residual_matrix": "residual of every channel",
                "misfit_force": "misfit against force",
                "misfit_time": "misfit against time",
                "misfit_place": "misfit over the skin",
                "held_out": "held-out misfit",
                "rivals": "knock-out and rivals",
                "next_experiment": "next experiment",
            }.items()
            for suffix in ("svg", "png")
        ],
    log:
        "logs/diagnosis_report/{recording}.log",
    benchmark:
        "benchmarks/diagnosis_report/{recording}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("eitskin.diagnose.report.page"),
    message:
        "Reporting the diagnosis of {wildcards.recording}"
    script:
        "../scripts/diagnosis_report.py"
