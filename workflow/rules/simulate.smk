rule mesh:
    """Electrodes, places and forces of the simulated skin."""
    output:
        mesh="results/mesh/mesh.npz",
        touch_grid="results/mesh/touch_grid.csv",
    log:
        "logs/mesh.log",
    benchmark:
        "logs/benchmarks/mesh.tsv"
    group:
        "skin"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seed=lookup(dpath="seed", within=config),
        skin=lookup(dpath="skin", within=config),
        protocol=lookup(dpath="protocol", within=config),
        touch_grid=lookup(dpath="touch_grid", within=config),
        forces=lookup(dpath="forces", within=config),
        accuracy=lookup(dpath="accuracy", within=config),
        code=fingerprint("mesh"),
    message:
        "Laying out the electrodes, the places and the forces"
    script:
        "../scripts/mesh.py"


rule clean:
    """Readings of every place and force on the ideal skin."""
    input:
        mesh=rules.mesh.output.mesh,
        touch_grid=rules.mesh.output.touch_grid,
    output:
        "results/simulated/clean.parquet",
    log:
        "logs/clean.log",
    benchmark:
        "logs/benchmarks/clean.tsv"
    group:
        "skin"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        skin=lookup(dpath="skin", within=config),
        accuracy=lookup(dpath="accuracy", within=config),
        code=fingerprint("clean", []),
    message:
        "Simulating every place and force on the ideal skin"
    script:
        "../scripts/clean.py"
