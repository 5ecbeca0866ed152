"""`python -m rigsim CONFIG.yaml`: the emulated rig, until its standard input ends.

It prints one line of JSON, its endpoints, once everything listens. On standard input it takes
faults, one JSON object a line. Exit code 0; 1 for a configuration that cannot be used, one line on
stderr; 3 where the driver broke a rule.
"""

import argparse
import asyncio
import sys

from eitskin.errors import InputError
from rigsim.config import read_config
from rigsim.rig import Rig


def main() -> int:
    """Run; the exit code."""
    parser = argparse.ArgumentParser(prog="rigsim", description="An emulated rig.")
    parser.add_argument("config", help="its YAML file")
    try:
        return asyncio.run(Rig(read_config(parser.parse_args().config)).run())
    except InputError as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
