# A chain of stages for each configuration: 0-skin, then one file an effect of the instrument.


def effects_of(wildcards):
    return config["configurations"][wildcards.configuration]["effects"]


def stage(wildcards, k):
    folder = f"results/simulated/{wildcards.configuration}"
    return f"{folder}/{links(effects_of(wildcards))[k]}.parquet"


rule skin_effects:
    input:
        mesh=rules.mesh.output.mesh,
        touch_grid=rules.mesh.output.touch_grid,
    output:
        "results/simulated/{configuration}/0-skin.parquet",
    log:
        "logs/skin_effects/{configuration}.log",
    benchmark:
        "benchmarks/skin_effects/{configuration}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        seed=lookup(dpath="seed", within=config),
        skin=lookup(dpath="skin", within=config),
        protocol=lookup(dpath="protocol", within=config),
        accuracy=lookup(dpath="accuracy", within=config),
        effects=lambda wildcards: skin_effects(effects_of(wildcards)),
        session_frames=lookup(dpath="configurations/{configuration}/session_frames", within=config),
        crossed=lookup(dpath="configurations/{configuration}/crossed", within=config),
        code=fingerprint("eitskin.simulate"),
    message:
        "Simulating the sessions of {wildcards.configuration}, a new skin for each"
    script:
        "../scripts/skin_effects.py"


rule perturb:
    input:
        lambda wildcards: stage(wildcards, int(wildcards.k) - 1),
    output:
        "results/simulated/{configuration}/{k}-{effect}.parquet",
    log:
        "logs/perturb/{configuration}/{k}-{effect}.log",
    benchmark:
        "benchmarks/perturb/{configuration}/{k}-{effect}.tsv"
    wildcard_constraints:
        k="[1-9][0-9]*",
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        effect=lambda wildcards: instrument_effects(effects_of(wildcards))[int(wildcards.k) - 1],
        position=lambda wildcards: int(wildcards.k),
        code=fingerprint("eitskin.simulate"),
    message:
        "Applying {wildcards.effect} to {wildcards.configuration}"
    script:
        "../scripts/perturb.py"


rule simulated_dataset:
    input:
        lambda wildcards: stage(wildcards, -1),
    output:
        "results/datasets/simulated-{configuration}.parquet",
    log:
        "logs/simulated_dataset/{configuration}.log",
    benchmark:
        "benchmarks/simulated_dataset/{configuration}.tsv"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        noise=lookup(dpath="configurations/{configuration}/noise", within=config),
        baseline=lookup(dpath="configurations/{configuration}/baseline", within=config),
        code=fingerprint("eitskin.simulate"),
    message:
        "Adding noise to {wildcards.configuration} and subtracting the untouched frames"
    script:
        "../scripts/simulated_dataset.py"
