from eitskin.simulate.chain import instrument_effects, last_link, link_before, skin_effects


rule skin_effects:
    """Simulated sessions, a new skin for each."""
    input:
        mesh=rules.mesh.output.mesh,
        touch_grid=rules.mesh.output.touch_grid,
    output:
        "results/simulated/{configuration}/0-skin.parquet",
    log:
        "logs/skin_effects/{configuration}.log",
    benchmark:
        "logs/benchmarks/skin_effects/{configuration}.tsv"
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 2
    resources:
        mem_mb=memory_MB,
        runtime=30,
    params:
        seed=lookup(dpath="seed", within=config),
        skin=lookup(dpath="skin", within=config),
        accuracy=lookup(dpath="accuracy", within=config),
        effects=lambda wildcards: skin_effects(effects_of(wildcards.configuration)),
        session_frames=of_configuration("session_frames"),
        crossed=of_configuration("crossed"),
        continuous=of_configuration("continuous"),
        code=lambda wildcards: fingerprint(
            "skin_effects", modules(names_of(skin_effects(effects_of(wildcards.configuration))))
        ),
    message:
        "Simulating the sessions of {wildcards.configuration}, a new skin for each"
    script:
        "../scripts/skin_effects.py"


rule perturb:
    """Simulated readings after one more effect of the instrument."""
    input:
        lambda wildcards: "results/simulated/{configuration}/{link}.parquet".format(
            configuration=wildcards.configuration,
            link=link_before(effects_of(wildcards.configuration), wildcards.link),
        ),
    output:
        "results/simulated/{configuration}/{link}.parquet",
    log:
        "logs/perturb/{configuration}/{link}.log",
    benchmark:
        "logs/benchmarks/perturb/{configuration}/{link}.tsv"
    wildcard_constraints:
        link="[1-9][0-9]*-[a-z-]+",
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=memory_MB,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        effect=lambda wildcards: instrument_effects(effects_of(wildcards.configuration))[
            wildcards.link
        ],
        position=lambda wildcards: int(wildcards.link.partition("-")[0]),
        code=lambda wildcards: fingerprint("perturb", modules([wildcards.link.partition("-")[2]])),
    message:
        "Applying {wildcards.link} to {wildcards.configuration}"
    script:
        "../scripts/perturb.py"


rule simulated_dataset:
    """Data set of a configuration: noise added, untouched frames subtracted."""
    input:
        lambda wildcards: "results/simulated/{configuration}/{link}.parquet".format(
            configuration=wildcards.configuration,
            link=last_link(effects_of(wildcards.configuration)),
        ),
    output:
        "results/datasets/simulated-{configuration}.parquet",
    log:
        "logs/simulated_dataset/{configuration}.log",
    benchmark:
        "logs/benchmarks/simulated_dataset/{configuration}.tsv"
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=memory_MB,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        noise=of_configuration("noise"),
        baseline=of_configuration("baseline"),
        code=fingerprint("simulated_dataset", []),
    message:
        "Adding noise to {wildcards.configuration} and subtracting the untouched frames"
    script:
        "../scripts/simulated_dataset.py"
