# One robot. Nothing needs what this makes: where the recording is there it is an input of the others
# and no rule makes it, where it is not they leave it out. In the workflow only this rule moves the
# arm: asked for by its name, or by a file of it.
from eitskin.capture.attachment import manifest_path
from eitskin.configuration import file_of

if "rig" in config:
    RIG = config["rig"]
    CAPTURED = [captured_path(RIG["name"]), manifest_path(RIG["name"])]

    if RIG["name"] in config["recordings"]:

        rule capture:
            """Recording captured by the attached rig: the robot moves."""
            input:
                CAPTURED,

    else:

        rule capture:
            """Recording captured by the attached rig: the robot moves."""
            output:
                recording=protected(CAPTURED[0]),
                manifest=protected(CAPTURED[1]),
            log:
                f"logs/capture/{RIG['name']}.log",
            benchmark:
                f"logs/benchmarks/capture/{RIG['name']}.tsv"
            retries: 0
            localrule: True
            conda:
                "../../envs/rig.yaml"
            threads: 1
            resources:
                rig=1,
                mem_mb=1000,
                runtime=2880,
            params:
                rig=RIG,
                file=file_of(["rig"], config, CONFIGFILES, REST),
                mounted_mm=lookup(dpath="mounted_mm", within=config, default=None),
                # No output: a capture that ends early goes on from it, and it survives `make clean`.
                journal=f"captures/{RIG['name']}.jsonl",
            message:
                "Capturing {params.rig[name]}: the robot moves"
            script:
                "../scripts/capture.py"
