from pathlib import Path

PRINTED_2 = own("workflow/eitskin/paper/printed_table_2.csv")


rule table_2:
    """Table II of the paper: untouched frames, simulated and recorded."""
    input:
        paper=ancient(local(PRINTED_2)),
        mesh=rules.mesh.output.mesh,
        recordings=expand("results/recordings/{recording}.parquet", recording=config["recordings"]),
    output:
        csv=report(
            "results/tables/table_2.csv",
            caption="../report/table_2.rst",
            category="1 Paper",
            labels={"shows": "Table II, CSV"},
        ),
        markdown=report(
            "results/tables/table_2.md",
            caption="../report/table_2.rst",
            category="1 Paper",
            labels={"shows": "Table II with its reading"},
        ),
    log:
        "logs/table_2.log",
    benchmark:
        "logs/benchmarks/table_2.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=30,
    params:
        names=list(config["recordings"]),
        skin=lookup(dpath="skin", within=config),
        configurations={
            name: {key: config["configurations"][name][key] for key in ("effects", "noise")}
            for name in config["table_2"]["configurations"]
        },
        accuracy=lookup(dpath="accuracy", within=config),
        seed=lookup(dpath="seed", within=config),
        size={key: config["table_2"][key] for key in ("sessions", "frames", "permutations")},
        code=fingerprint(
            "table_2",
            modules(names_of(sum(map(effects_of, config["table_2"]["configurations"]), []))),
            [PRINTED_2],
        ),
    message:
        "Comparing untouched frames, simulated and recorded"
    script:
        "../scripts/table_2.py"


SHOWN_SET = f"simulated-{config['figures']['configuration']}"
SHOWN_TEST = f"{SHOWN_SET}/{config['figures']['split']}/{config['budget']}"
SHOWN_MODELS = [
    model
    for dataset, split, model in rows(config)
    if (dataset, split) == (SHOWN_SET, config["figures"]["split"])
] or config["models"]


rule figure_1:
    """Figure 1 of the paper: a frame and the images of a press."""
    input:
        f"results/recordings/{config['figures']['recording']}.parquet",
    output:
        svg=report(
            "results/figures/figure_1.svg",
            caption="../report/figure_1.rst",
            category="1 Paper",
            labels={"shows": "Figure 1"},
        ),
        png="results/figures/figure_1.png",
        csv="results/figures/figure_1.csv",
    log:
        "logs/figure_1.log",
    benchmark:
        "logs/benchmarks/figure_1.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        recording=lookup(dpath="figures/recording", within=config),
        code=fingerprint("figure_1"),
    message:
        "Drawing a frame and the images of a press of {params.recording}: figure 1"
    script:
        "../scripts/figure_1.py"


rule figure_2:
    """Figure 2 of the paper: the method."""
    output:
        svg=report(
            "results/figures/figure_2.svg",
            caption="../report/figure_2.rst",
            category="1 Paper",
            labels={"shows": "Figure 2"},
        ),
        png="results/figures/figure_2.png",
        csv="results/figures/figure_2.csv",
    log:
        "logs/figure_2.log",
    benchmark:
        "logs/benchmarks/figure_2.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("figure_2"),
    message:
        "Drawing the method: figure 2"
    script:
        "../scripts/figure_2.py"


rule figure_3:
    """Figure 3 of the paper: correlations of voltages and states."""
    input:
        recorded=f"results/datasets/{config['figures']['recording']}.parquet",
        simulated=f"results/datasets/{SHOWN_SET}.parquet",
    output:
        svg=report(
            "results/figures/figure_3.svg",
            caption="../report/figure_3.rst",
            category="1 Paper",
            labels={"shows": "Figure 3"},
        ),
        png="results/figures/figure_3.png",
        csv="results/figures/figure_3.csv",
    log:
        "logs/figure_3.log",
    benchmark:
        "logs/benchmarks/figure_3.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        code=fingerprint("figure_3"),
    message:
        "Drawing the correlations of voltages and states: figure 3"
    script:
        "../scripts/figure_3.py"


rule figure_4:
    """Figure 4 of the paper: predicted forces of the worst model and of the one shown."""
    input:
        dataset=f"results/datasets/{SHOWN_SET}.parquet",
        metrics=expand(f"results/metrics/{SHOWN_TEST}/{{model}}.csv", model=SHOWN_MODELS),
        predictions=expand(
            f"results/predictions/{SHOWN_TEST}/{{model}}.parquet", model=SHOWN_MODELS
        ),
    output:
        svg=report(
            "results/figures/figure_4.svg",
            caption="../report/figure_4.rst",
            category="1 Paper",
            labels={"shows": "Figure 4"},
        ),
        png="results/figures/figure_4.png",
        csv="results/figures/figure_4.csv",
    log:
        "logs/figure_4.log",
    benchmark:
        "logs/benchmarks/figure_4.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=5,
    params:
        models=SHOWN_MODELS,
        shown=lookup(dpath="figures/model", within=config),
        skin=lookup(dpath="skin", within=config),
        code=fingerprint("figure_4"),
    message:
        "Drawing the predicted force of the worst model and of {params.shown}: figure 4"
    script:
        "../scripts/figure_4.py"
