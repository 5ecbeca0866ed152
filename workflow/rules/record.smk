from eitskin.configuration import captured_path

# Of the others, a rig has put the file where it is to be.
BROUGHT = [
    name for name, item in config["recordings"].items() if item["path"] != captured_path(name)
]
# The path of a recording, and its format where that is stated.
READ_FROM = {
    name: (item["path"], item.get("format")) for name, item in config["recordings"].items()
}


rule twin:
    """Recording of a simulated twin of a real skin."""
    output:
        "results/twin/simulated-twin.parquet",
    log:
        "logs/twin.log",
    benchmark:
        "logs/benchmarks/twin.tsv"
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        twin=lookup(dpath="twin", within=config),
        code=fingerprint("twin", modules(names_of(config["twin"]["effects"]))),
    message:
        "Simulating the twin of a real skin"
    script:
        "../scripts/twin.py"


rule import_recording:
    """Recording in the project's format, from any other."""
    input:
        lambda wildcards: list(map(str, importers.files(*READ_FROM[wildcards.recording]))),
    output:
        "results/recordings/{recording}.parquet",
    log:
        "logs/import_recording/{recording}.log",
    benchmark:
        "logs/benchmarks/import_recording/{recording}.tsv"
    wildcard_constraints:
        recording=any_of(BROUGHT),
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        read_as=lambda wildcards: {
            key: config["recordings"][wildcards.recording].get(key)
            for key in ("format", "order", "drive", "measure")
        },
        skin=of_recording("skin"),
        frames=of_recording("frames"),
        code=code_of_import,
    message:
        "Reading the recording {wildcards.recording}"
    script:
        "../scripts/import_recording.py"


rule check:
    """What a recording holds and what it cannot tell."""
    input:
        rules.import_recording.output,
    output:
        "results/recordings/{recording}.check.txt",
    log:
        "logs/check/{recording}.log",
    benchmark:
        "logs/benchmarks/check/{recording}.tsv"
    group:
        "data"
    conda:
        "../../envs/simulation.yaml"
    threads: 1
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        code=fingerprint("check"),
    message:
        "Checking what {wildcards.recording} holds and what it cannot tell"
    script:
        "../scripts/check.py"
